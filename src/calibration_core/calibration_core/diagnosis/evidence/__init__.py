"""Loaded steps as rows without offsets, what is selected of them, and the model extended by it."""
