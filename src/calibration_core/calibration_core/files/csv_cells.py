"""Cells of CSV tables that a spreadsheet would take for formulas."""

from __future__ import annotations

import re

FORMULA = ("=", "+", "-", "@", "\t", "\r")
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
QUOTE = "'"


def inert(cell: str) -> str:
    """Return a cell with an apostrophe before what a spreadsheet would compute; numbers stay numbers."""
    return f"{QUOTE}{cell}" if cell.startswith(FORMULA) and not NUMBER.fullmatch(cell) else cell


def meant(cell: str) -> str:
    """Return what `inert` was given."""
    return cell[1:] if cell.startswith(tuple(QUOTE + mark for mark in FORMULA)) else cell
