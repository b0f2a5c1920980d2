"""Identified models: their values, uncertainties, range and file."""
