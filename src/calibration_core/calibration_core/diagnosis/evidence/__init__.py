"""Bayes factors of the hypotheses about loaded steps, their selection, and the model extended by them."""
