"""From what was accepted to findings in words."""
