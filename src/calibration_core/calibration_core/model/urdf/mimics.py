"""The joints between base and flange that a URDF lets mimic others: which of the robot's own moves each of them."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import CellError, quoted
from calibration_core.model.urdf.tree import MOVING, Tree
from calibration_core.timeseries import Float2D


@dataclasses.dataclass(frozen=True)
class Gear:
    """How a mimic joint goes with one of the robot's own: it stands at multiplier times that one plus offset.

    Attributes:
        driver: Index of the robot's own joint.
        multiplier: rad or m per rad or m.
        offset: rad, m where the mimic joint slides.
    """

    driver: int
    multiplier: float
    offset: float


def gears_of(cell: Cell, tree: Tree, path: list[str]) -> dict[str, Gear]:
    """Return the gears of the mimic joints among the joints from base to flange, by name.

    One whose multiplier is 0 stands still, as `Tree.standing` says, and is none of them.

    Raises:
        CellError: A joint of the cell mimics another, or a joint mimics what is none of the cell's.
    """
    own, joints = cell.robot.joints, tree.joints
    found = {}
    for name in path:
        mimic = joints[name].mimic
        if mimic is None or joints[name].type not in MOVING:
            continue
        driver, multiplier, offset = str(mimic.joint), float(mimic.multiplier), float(mimic.offset)
        if name in own:
            expected = f"joints with a drive of their own: leave it out, it goes with {quoted(driver)}"
            raise CellError(cell.path, f"robot.joints.{own.index(name)}", f"{quoted(name)}, a mimic joint", expected)
        if driver not in own:
            raise CellError(
                cell.urdf_path or cell.path,
                f"joint {quoted(name)}, mimic",
                "nothing" if mimic.joint is None else f"{quoted(driver)}, {_what(tree, path, driver, name)}",
                f"one of the cell's joints, which drive: {', '.join(own)}",
            )
        if multiplier != 0.0:
            found[name] = Gear(own.index(driver), multiplier, offset)
    return found


def _what(tree: Tree, path: list[str], driver: str, name: str) -> str:
    """Say why a joint cannot drive a mimic joint."""
    joint = tree.joints.get(driver)
    if joint is None:
        return "no joint of the URDF"
    if joint.type not in MOVING:
        return f"a {joint.type} joint"
    if joint.mimic is not None:
        chain = [name, driver]
        while (following := tree.joints.get(chain[-1])) is not None and following.mimic is not None:
            chain.append(str(following.mimic.joint))
            if chain[-1] in chain[:-1]:
                return f"in a circle of mimic joints, {' -> '.join(chain)}"
        return f"a mimic joint itself, of {quoted(chain[-1])}"
    return "a joint that the cell file does not name" if driver in path else "a joint beside the chain"


def narrowed(cell: Cell, tree: Tree, limits: Float2D, gears: dict[str, Gear]) -> Float2D:
    """Return the limits of the robot's own joints, (n, 2), within which the mimic joints keep their own, too.

    Raises:
        CellError: No position of a driver is within the limits of a joint that mimics it.
    """
    kept = np.array(limits)
    for name, gear in gears.items():
        limit = tree.joints[name].limit
        if tree.joints[name].type == "continuous" or limit is None or limit.lower is None or limit.upper is None:
            continue
        ends = sorted((end - gear.offset) / gear.multiplier for end in (limit.lower, limit.upper))
        low, high = max(kept[gear.driver, 0], ends[0]), min(kept[gear.driver, 1], ends[1])
        if not low < high:
            driver, (first, last) = cell.robot.joints[gear.driver], kept[gear.driver]
            reached = sorted(gear.multiplier * end + gear.offset for end in (first, last))
            raise CellError(
                cell.urdf_path or cell.path,
                f"joint {quoted(name)}, limit",
                f"[{limit.lower:g}, {limit.upper:g}]",
                f"some of what {quoted(driver)} makes it reach, [{reached[0]:g}, {reached[1]:g}]",
            )
        kept[gear.driver] = low, high
    return kept
