"""The tree of links and joints of a URDF, as yourdfpy reads it, with the path between two links."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import io
import sys
import types
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from calibration_core.cell import Cell
from calibration_core.cell.urdf import urdf_bytes
from calibration_core.errors import CellError, quoted
from calibration_core.model.chain import rotation_about
from calibration_core.timeseries import Float1D, Float2D


class _Whole:
    """All of trimesh, imported at the first use of a name.

    It stands nowhere in `sys.modules`: the first line of a ROS node's log asks every module there for its file, and
    would have to wait until a lazy one is loaded (1.8 s of processor time).
    """

    def __getattr__(self, name: str) -> Any:
        """Return what trimesh calls so."""
        return getattr(importlib.import_module("trimesh"), name)


@functools.cache
def yourdfpy() -> Any:
    """Return the module."""
    spec = importlib.util.find_spec("trimesh")
    if "trimesh" in sys.modules or spec is None or spec.loader is None or spec.submodule_search_locations is None:
        return importlib.import_module("yourdfpy")
    package = types.ModuleType("trimesh")  # the real one's folder, without its __init__
    package.__path__ = list(spec.submodule_search_locations)
    package.__getattr__ = lambda _: object  # type: ignore[method-assign]  # names in annotations
    sys.modules["trimesh"] = package
    try:
        loaded = importlib.import_module("yourdfpy")
    finally:
        del sys.modules["trimesh"]
    loaded.urdf.trimesh = _Whole()
    return loaded


MOVING = ("revolute", "continuous", "prismatic")
SHORTEST_AXIS = 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class Tree:
    """A URDF's links and joints.

    Attributes:
        links: `yourdfpy.Link` by name.
        joints: `yourdfpy.Joint` by name.
        above: Name of the joint that carries a link, by the link's name; the root has none.
    """

    links: Mapping[str, Any]
    joints: Mapping[str, Any]
    above: Mapping[str, str]

    def path(self, base: str, link: str) -> list[str] | None:
        """Return the names of the joints from one link down to another; None where the second hangs elsewhere."""
        names: list[str] = []
        while link != base:
            if link not in self.above:
                return None
            names.append(self.above[link])
            link = self.joints[names[-1]].parent
        return names[::-1]

    def origin(self, name: str) -> Float2D:
        """Return the (4, 4) pose of what a joint carries in its parent link, at zero."""
        origin = self.joints[name].origin
        return np.eye(4) if origin is None else np.asarray(origin, dtype=float)

    def standing(self, name: str) -> Float2D:
        """Return the (4, 4) pose of what a joint carries in its parent link, at zero, a mimic joint at its offset."""
        joint = self.joints[name]
        pose = self.origin(name)
        if joint.mimic is None or joint.type not in MOVING:
            return pose
        moved, axis = np.eye(4), unit_axis(joint.axis)
        if axis is not None and joint.type == "prismatic":
            moved[:3, 3] = axis * joint.mimic.offset
        elif axis is not None:
            moved[:3, :3] = rotation_about(axis * joint.mimic.offset)
        return np.asarray(pose @ moved)


def unit_axis(axis: Float1D) -> Float1D | None:
    """Return an axis, (3,), of length one; None where it has none."""
    length = float(np.linalg.norm(axis))
    return None if length < SHORTEST_AXIS else np.asarray(axis, dtype=float) / length


def tree_of(cell: Cell) -> Tree:
    """Return the tree of the cell's URDF.

    Raises:
        CellError: The file is missing, would do harm, or is no URDF of a robot.
    """
    path = cell.urdf_path
    assert path is not None  # noqa: S101 - asked for only where the cell has a URDF
    limited = cell.robot.joints if cell.robot.joint_limits is None else ()
    try:
        tree = _parsed(urdf_bytes(path, limited))
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:  # what yourdfpy trips over
        raise CellError(path, "", quoted(str(error) or type(error).__name__), "a URDF that yourdfpy can read") from None
    for key in ("base_link", "flange"):
        name = getattr(cell.robot, key)
        if name not in tree.links:
            raise CellError(cell.path, f"robot.{key}", quoted(name), f"a link of the URDF: {', '.join(tree.links)}")
    return tree


@functools.lru_cache(maxsize=4)
def _parsed(raw: bytes) -> Tree:
    root = ET.fromstring(raw)
    root.attrib.setdefault("name", "robot")  # yourdfpy reads none without
    robot = yourdfpy().URDF.load(io.BytesIO(ET.tostring(root)), build_scene_graph=False, load_meshes=False).robot
    links = {link.name: link for link in robot.links}
    joints = {joint.name: joint for joint in robot.joints}
    return Tree(links, joints, {joint.child: joint.name for joint in robot.joints})
