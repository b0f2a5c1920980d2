"""Recordings of absolute positions: staged selection of geometry and elasticity, and what remains."""
