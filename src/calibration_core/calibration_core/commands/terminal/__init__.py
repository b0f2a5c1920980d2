"""The program at the terminal: how a command ends, how far it is, and what a shell completes."""
