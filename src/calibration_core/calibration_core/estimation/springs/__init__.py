"""Springs beside joints: the shape of one, and where one is asked about."""
