"""What was seen, without an opinion: plateaus, averages, covariances, clocks."""
