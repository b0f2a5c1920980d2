"""Measurement tables."""
