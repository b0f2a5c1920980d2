"""Numbers as files hold them, the same in every table, document and result: a zero has no sign.

Arithmetic makes -0.0 of small causes (a product with 0, an angle of a transposed matrix); it means nothing to a reader,
and makes files differ that say the same.  Texts for people round by `format`: `z` in its specification does this there.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Sequence
from typing import Any

from calibration_core.files.csv_cells import inert


def number(value: float) -> str:
    """Return a number to all its digits, so that reading it gives the same number; of zeros, `0.0`."""
    return repr(float(value) + 0.0)


def numbers(values: Iterable[float]) -> str:
    """Return numbers as `number` writes them, with spaces between, as XML has vectors."""
    return " ".join(map(number, values))


def unsigned_zeros(data: Any) -> Any:
    """Return plain data (dictionaries, lists, tuples, values) with 0.0 for every -0.0."""
    if isinstance(data, float):
        return data + 0.0
    if isinstance(data, dict):
        return {key: unsigned_zeros(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [unsigned_zeros(value) for value in data]
    return data


def json_bytes(data: dict[str, Any]) -> bytes:
    """Return plain data as indented JSON, the same bytes for the same content.

    Raises:
        ValueError: A number is not finite, which JSON cannot say.
    """
    return (json.dumps(unsigned_zeros(data), indent=2, allow_nan=False) + "\n").encode()


def csv_bytes(head: Sequence[str], rows: Iterable[Iterable[object]]) -> bytes:
    """Return a table: numbers as `number` writes them, empty where not known (NaN), texts that compute nothing."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([_cell(cell) for cell in row] for row in rows)
    return text.getvalue().encode("utf-8", "replace")


def _cell(value: object) -> object:
    if isinstance(value, float):
        return "" if math.isnan(value) else number(value)
    return inert(value) if isinstance(value, str) else value
