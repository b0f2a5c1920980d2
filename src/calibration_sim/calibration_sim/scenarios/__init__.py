"""Cells with effects in them: which, how large, played step by step, and measured."""
