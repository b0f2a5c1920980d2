"""Where the robot is to be measured: the cube of ISO 9283, or the places of a task program (CWA 17384, 5.1 and 5.4)."""

from __future__ import annotations

import csv
import io
import itertools
import math
from pathlib import Path

import numpy as np

from calibration_core.errors import PlanError, quoted
from calibration_core.files.regular import read_regular
from calibration_core.planning.feasible.candidates import Ground, brought, places_of
from calibration_core.planning.feasible.space import joint_range
from calibration_core.timeseries import Bool1D, Float2D

CUBE_SIDES = (1.0, 0.63, 0.4, 0.25)  # m (EN ISO 9283:1998, 6.8)
STARTS = 40  # postures from which a corner is tried to be reached
GRID = 7  # places along x and z at which the cube's centre is tried
REACHED = 2e-3  # m
MOST_ROWS = 10_000
MAX_BYTES = 8 << 20

Box = tuple[tuple[float, float], ...]


def iso_cube(ground: Ground, side: float | None = None, seed: int = 0) -> Box:
    """Return the largest cube of ISO 9283 that the middle of the measurement points can be brought to all corners of.

    Its edges are parallel to the base axes, its centre lies in the plane of the base's x and z axes; among the places
    at which all corners and the centre can be measured, the one in the middle of them is taken.

    Args:
        ground: The cell.
        side: m, of the cube; None: the largest of 1000, 630, 400 and 250 mm that fits.
        seed: Of the postures from which corners are tried to be reached.

    Raises:
        PlanError: No such cube fits.
    """
    reach = ground.site.chain.reach
    corners = np.array([(0.0, 0.0, 0.0), *itertools.product((-0.5, 0.5), repeat=3)])
    across = np.linspace(0.3, 0.9, GRID) * reach
    height = np.linspace(0.0, 0.9, GRID) * reach
    centres = np.array([(x, 0.0, z) for x in across for z in height])
    for size in CUBE_SIDES if side is None else (side,):
        fits = _reachable(ground, (centres[:, None] + size * corners).reshape(-1, 3), seed)
        whole = fits.reshape(len(centres), -1).all(axis=1)
        if whole.any():
            inside = centres[whole]
            middle = inside[int(np.argmin(np.linalg.norm(inside - inside.mean(axis=0), axis=1)))]
            return tuple((float(c - size / 2), float(c + size / 2)) for c in middle)
    wanted = "any cube of ISO 9283" if side is None else f"a cube of {1e3 * side:.0f} mm"
    text = f"no place for {wanted} whose corners can all be measured"
    raise PlanError(ground.cell.path, "robot", text, "more free space, or a tracker that sees more of it")


def _reachable(ground: Ground, places: Float2D, seed: int) -> Bool1D:
    """Tell which places, (k, 3) m, the middle of the points can be measured at, as booleans (k,)."""
    low, high = joint_range(ground.site.chain, ground.rules)
    rng = np.random.default_rng([seed, 9])
    found = np.zeros(len(places), dtype=bool)
    for _ in range(STARTS):
        left = np.flatnonzero(~found)
        if not len(left):
            break
        q = brought(ground.site, rng.uniform(low, high, (len(left), len(low))), places[left], low, high)
        near = np.linalg.norm(places_of(ground.site, q) - places[left], axis=1) < REACHED
        rows = np.flatnonzero(near)
        near[rows] = ground.fit(q[rows])
        found[left[near]] = True
    return found


def read_task(path: str | Path, ground: Ground) -> Float2D:
    """Read the places of a task program, (k, 3) m, where it brings the middle of the measurement points, base frame.

    The file is a table (CSV) with a header: `x y z` in m, base frame; or joint angles, as `q1` ... `qn` in rad or as in
    Table 1 of the standard, `theta_1` ... `theta_n` in degrees.  Further columns are passed over.

    Raises:
        PlanError: It is missing or malformed, or holds none of these columns.
    """
    path = Path(path)
    content = read_regular(path, MAX_BYTES, "table (CSV)", PlanError)
    try:
        text = io.StringIO(content.decode("utf-8"), newline="")
        rows = list(itertools.islice(csv.reader(text), MOST_ROWS + 2))
    except (UnicodeDecodeError, csv.Error) as error:
        raise PlanError(path, "", str(error), "a table (CSV) in UTF-8") from None
    head = [name.strip() for name in rows[0]] if rows else []
    n = ground.site.chain.n
    for prefix, unit in (("q", 1.0), ("theta_", np.pi / 180)):
        names = [f"{prefix}{i + 1}" for i in range(n)]
        if all(name in head for name in names):
            return places_of(ground.site, unit * _numbers(path, rows, [head.index(name) for name in names]))
    if all(name in head for name in "xyz"):
        return _numbers(path, rows, [head.index(name) for name in "xyz"])
    expected = f"the columns x, y, z or q1 ... q{n} or theta_1 ... theta_{n}"
    raise PlanError(path, "line 1", quoted(",".join(head)), expected)


def _numbers(path: Path, rows: list[list[str]], columns: list[int]) -> Float2D:
    if not 2 <= len(rows) <= MOST_ROWS + 1:
        raise PlanError(path, "", f"{len(rows) - 1} rows", f"1 to {MOST_ROWS} places")
    values = []
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(rows[0]):
            raise PlanError(path, f"line {line}", f"{len(row)} fields", f"{len(rows[0])}, as in the header")
        for column in columns:
            try:
                number = float(row[column])
            except ValueError:
                number = math.nan
            if not math.isfinite(number):
                raise PlanError(path, f"line {line}, {rows[0][column].strip()}", quoted(row[column]), "a number")
            values.append(number)
    return np.array(values).reshape(-1, len(columns))
