"""The nodes: messages in, core called, messages out."""
