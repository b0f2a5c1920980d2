"""Effects of the structure: what gives way besides the joints about their axes."""
