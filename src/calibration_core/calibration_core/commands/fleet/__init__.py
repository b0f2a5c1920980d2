"""`calibration fleet`: every recording of a plant, and what they say together."""
