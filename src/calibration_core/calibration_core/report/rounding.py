"""Numbers as a certificate prints them: rounded by their uncertainty, aligned on the decimal point."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from calibration_core.timeseries import Float1D, Float2D

DASH = "–"
COVERAGE = 1.96  # standard deviations on either side of a value that hold 95 % (GUM, 6.2)
_SUBSCRIPT = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_FIGURE_SPACE = "\u2007"
_POINT_SPACE = "\u2008"


@dataclasses.dataclass(frozen=True)
class Unit:
    """A unit for display.

    Attributes:
        factor: What an SI value is multiplied by.
        name: As printed.
    """

    factor: float
    name: str


MICROMETRE = Unit(1e6, "µm")
MILLIMETRE = Unit(1e3, "mm")
STIFFNESS = Unit(1e-5, "10⁵ N·m/rad")

_READABLE = {
    "rad": Unit(1e6, "µrad"),
    "m": MICROMETRE,
    "rad/(N*m)": Unit(1e9, "10⁻⁹ rad/(N·m)"),
    "m/N": Unit(1e9, "10⁻⁹ m/N"),
}


def readable_unit(unit: str) -> Unit:
    """Return the unit in which small quantities of an SI unit, or of one per year, are read: `rad` in µrad."""
    base = unit.removesuffix("/year")
    known = _READABLE.get(base, Unit(1.0, base.replace("*", "·")))
    return Unit(known.factor, known.name + unit[len(base) :])


def length_unit(typical: float) -> Unit:
    """Return the unit in which lengths of the size `typical` (m) are read best: µm below 0.5 mm, else mm."""
    return MILLIMETRE if math.isfinite(typical) and typical >= 5e-4 else MICROMETRE


def decimals(uncertainty: float, digits: int = 2) -> int:
    """Return the decimals that leave `digits` significant digits of an uncertainty (negative: tens, hundreds, ...)."""
    if not math.isfinite(uncertainty) or uncertainty <= 0:
        return 3
    places = digits - 1 - math.floor(math.log10(uncertainty))
    # 0.0996 rounds up to 0.10: one decimal less carries the same two digits.
    return places - 1 if round(uncertainty * 10.0**places) >= 10**digits else places


def fixed(value: float, places: int) -> str:
    """Return a number with the given decimals and a true minus sign; a dash if it is not finite."""
    if not math.isfinite(value):
        return DASH
    text = f"{round(value, places) + 0.0:.{max(places, 0)}f}"
    return text.replace("-", "−")


def significant(value: float, digits: int = 2) -> str:
    """Return a number with the given count of significant digits, never in exponent form."""
    if not math.isfinite(value):
        return DASH
    return fixed(value, decimals(abs(value), digits) if value else 0)


def length_in_words(value: float) -> str:
    """Return a length (m) in the unit that suits it: mm, µm, or m in exponent form where it is next to nothing."""
    return f"{1e3 * value:.3f} mm" if value >= 1e-4 else f"{1e6 * value:.3g} µm" if value >= 1e-8 else f"{value:.1g} m"


def spread(value: float) -> str:
    """Return the size of a deviation or uncertainty: two significant digits, whole numbers in full from 100 on."""
    return fixed(value, 0) if abs(value) >= 99.5 else significant(value)


def interval_end(value: float, places: int) -> str:
    """Return an end of an interval with the given decimals, or as many more as two significant digits need."""
    return fixed(value, max(places, decimals(abs(value))) if value and math.isfinite(value) else places)


def counted(number: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun, thousands grouped: `1 reading`, `11,911 readings`."""
    return f"{number:,} {noun if number == 1 else plural or noun + 's'}"


def listed(names: Sequence[str], limit: int = 6) -> str:
    """Return names as a phrase: `a, b and c`, cut to `limit` with the number of those left out."""
    names = [shortened(name) for name in names]
    if len(names) > limit:
        return f"{', '.join(names[:limit])} and {len(names) - limit} more"
    return phrase(names)


def phrase(parts: Sequence[str]) -> str:
    """Return parts of a sentence, none of them cut, as one: `a, b and c`."""
    return " and ".join((", ".join(parts[:-1]), parts[-1])) if len(parts) > 1 else "".join(parts)


def shortened(name: str, limit: int = 40) -> str:
    """Return a name cut to `limit` characters, so that a table keeps its shape."""
    return name if len(name) <= limit else name[: limit - 1] + "…"


def subscript(number: int) -> str:
    """Return a number in small digits below the line."""
    return str(number).translate(_SUBSCRIPT)


def aligned(cells: Sequence[str]) -> tuple[str, ...]:
    """Pad right-aligned cells with digit-wide spaces, so that their decimal points stand below each other."""
    tails = [len(cell.partition(".")[2]) if _numeric(cell) else -1 for cell in cells]
    longest = max(tails, default=0)
    if longest <= 0:
        return tuple(cells)
    return tuple(
        cell if tail < 0 else cell + ("" if tail else _POINT_SPACE) + _FIGURE_SPACE * (longest - tail)
        for cell, tail in zip(cells, tails, strict=True)
    )


def padded(rows: Sequence[tuple[str, ...]]) -> tuple[tuple[str, ...], ...]:
    """Return the rows with every column but the first aligned on the decimal point."""
    columns = zip(*rows, strict=True)
    return tuple(zip(*(aligned(column) if i else column for i, column in enumerate(columns)), strict=True))


def rms(values: Float1D | Float2D) -> float:
    """Return the root mean square over all finite values; NaN if there are none."""
    finite = np.asarray(values)[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else math.nan


def _numeric(cell: str) -> bool:
    return bool(cell) and cell.lstrip("−+").replace(".", "", 1).replace(",", "").isdigit()
