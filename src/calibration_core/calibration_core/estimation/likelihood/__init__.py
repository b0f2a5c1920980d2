"""How probable a recording is: the restricted likelihood of sizes, gains of one more block, small effects beside it."""
