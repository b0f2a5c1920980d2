"""Empirical laws for what no physics of the catalogue explains."""
