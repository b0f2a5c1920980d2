"""Files as they come from anywhere: regular, of bounded size, plain YAML; every value knows its line and column."""
