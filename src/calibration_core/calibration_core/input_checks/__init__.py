"""What is wrong with the data as they were handed in: signs, units, axes, order.  Looked for before any physics."""
