"""The run as a state machine: events in, commands out, readings held against the plan, a session on disk."""
