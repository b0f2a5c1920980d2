"""Frames, points and geometry as parameters of a least-squares problem: terms, fit, identifiability, prior, table."""
