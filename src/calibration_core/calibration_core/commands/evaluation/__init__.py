"""Recordings: simulated, identified, diagnosed and predicted."""
