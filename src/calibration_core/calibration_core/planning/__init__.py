"""What to measure: postures and loads chosen for what they tell, the way through them, and what may be expected."""
