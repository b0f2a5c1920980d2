"""A recording beside a simulation of the same measurement."""
