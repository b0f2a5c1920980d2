"""Readings and recordings as a model predicts them."""
