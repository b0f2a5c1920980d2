"""Whether a measurement meets the demands on it: conditions, preconditions, sensor, operating space, noise."""
