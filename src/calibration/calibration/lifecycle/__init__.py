"""Managed nodes: states and transitions, who may do what in which, signs of life, and the manager's order."""
