"""What to measure next, and what a measurement could reveal."""
