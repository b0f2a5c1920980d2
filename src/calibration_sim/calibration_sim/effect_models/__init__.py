"""Physics that a model may leave out, with laws of its own: what the diagnosis is tried on, never what it believes."""
