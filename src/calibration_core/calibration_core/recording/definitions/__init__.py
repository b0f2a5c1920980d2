"""Definitions of message types as text: parsed to fields, never evaluated."""
