"""What the robots of a type tell of the next one: their population as a file, as a prior, and in a plan."""
