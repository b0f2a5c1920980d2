"""Answers as files: HTML, PDF, tables, and all of them together or none."""
