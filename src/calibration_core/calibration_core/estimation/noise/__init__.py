"""Noise: what readings share, and what is always a little wrong."""
