"""Distributions, least squares with free offsets, solutions that are not negative."""
