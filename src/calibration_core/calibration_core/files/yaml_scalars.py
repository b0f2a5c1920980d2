"""What a plain YAML scalar means: nothing, truth, a number of bounded size, or text.

Wider than YAML 1.1 in one place: `1e5` and `1.4e6` are numbers, as everybody means them.  Narrower where 1.1 surprises:
numbers to base 8 and 60 and dates are text, and so are integers with leading zeros, which belong to serial numbers.
"""

from __future__ import annotations

import math
import re

NULLS = {"", "~", "null", "Null", "NULL"}
TRUTHS = {
    **{word: True for text in ("yes", "true", "on") for word in (text, text.capitalize(), text.upper())},
    **{word: False for text in ("no", "false", "off") for word in (text, text.capitalize(), text.upper())},
}
SPECIAL = {
    **{sign + word: math.inf for sign in ("", "+") for word in (".inf", ".Inf", ".INF")},
    **{"-" + word: -math.inf for word in (".inf", ".Inf", ".INF")},
    **dict.fromkeys((".nan", ".NaN", ".NAN"), math.nan),
}
INTEGER = re.compile(r"[-+]?(?:0|[1-9][0-9_]*)")
HEXADECIMAL = re.compile(r"[-+]?0x[0-9a-fA-F_]+")
FLOAT = re.compile(r"[-+]?(?:(?:[0-9][0-9_]*)?\.[0-9][0-9_]*|[0-9][0-9_]*\.?)(?:[eE][-+]?[0-9]+)?")
MAX_DIGITS = 100
MAX_INTEGER = 1 << 64  # times in metadata are ns, unsigned


def resolve(text: str) -> object:
    """Return the value of a plain scalar.

    Raises:
        ValueError: A number that is too long or too large; the text says so.
    """
    if text in NULLS:
        return None
    if text in TRUTHS:
        return TRUTHS[text]
    if text in SPECIAL:
        return SPECIAL[text]
    if text[0] not in "+-.0123456789":
        return text
    if INTEGER.fullmatch(text):
        return _integer(text, 10)
    if HEXADECIMAL.fullmatch(text):
        return _integer(text, 16)
    if FLOAT.fullmatch(text) and text.lstrip("+-0123456789_") != "":
        return _float(text)
    return text


def _integer(text: str, base: int) -> int:
    _bounded(text)
    value = int(text.replace("_", ""), base)
    if abs(value) > MAX_INTEGER:
        msg = f"an integer beyond {MAX_INTEGER:.3g}"
        raise ValueError(msg)
    return value


def _float(text: str) -> float:
    _bounded(text)
    value = float(text.replace("_", ""))
    if math.isinf(value):
        msg = f"{text}, too large for a number"
        raise ValueError(msg)
    return value


def _bounded(text: str) -> None:
    if len(text) > MAX_DIGITS:
        msg = f"a number of {len(text)} characters"
        raise ValueError(msg)
