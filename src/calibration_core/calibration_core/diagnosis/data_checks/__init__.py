"""What is wrong with the data and no physics: noise, moved targets, outliers, what remains."""
