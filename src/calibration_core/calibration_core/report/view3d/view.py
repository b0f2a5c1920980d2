"""What is drawn in space: the robot in its postures, frames, targets, tracker, boxes, places and arrows."""

from __future__ import annotations

import base64
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.chain import Chain, pose_matrix
from calibration_core.model.robot import chain_of
from calibration_core.report.document import printable
from calibration_core.report.view3d.solids import Solid, robot_solids
from calibration_core.timeseries import Float1D, Float2D

SCHEMA = 2
NAME = 40  # characters of a name that are shown


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """A frame with its name.

    Attributes:
        name: As it is shown.
        on: What carries it.
        pose: (4, 4) in what carries it.
    """

    name: str
    on: Literal["base", "flange"]
    pose: Float2D


@dataclasses.dataclass(frozen=True, eq=False)
class Arrow:
    """An arrow in the base frame.

    Attributes:
        kind: Name of what it shows, one of the view's kinds.
        posture: Index of the posture that it belongs to.
        start: (3,) m.
        vector: (3,) m, as drawn.
    """

    kind: str
    posture: int
    start: Float1D
    vector: Float1D


@dataclasses.dataclass(frozen=True, eq=False)
class ArrowKind:
    """What arrows of one kind show.

    Attributes:
        name: As it is shown, where no other language has a word for it.
        colour: Red, green and blue, 0 to 1.
        note: What their length means; empty where that needs no word.
        shown: Whether they are drawn before somebody asks for them.
    """

    name: str
    colour: tuple[float, float, float]
    note: str = ""
    shown: bool = True


FORCE = ArrowKind("force", (0.25, 0.25, 0.25))
DEFLECTION = ArrowKind("deflection", (0.12, 0.31, 0.47))


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """Everything that is drawn; base frame, m, rad.

    Attributes:
        name: What is shown, for those who cannot see it.
        chain: The robot.
        solids: Its bodies.
        plain: Why the bodies are not the maker's; empty if they are.
        postures: Name and (n,) joint positions of each posture; at least one.
        targets: Name -> (3,) m in the flange frame.
        frames: Frames.
        tracker: (3,) m; None where it is not shown.
        boxes: Name, (3,) edges and (4, 4) pose of each box.
        places: Name -> (k, 3) m, shown at every posture.
        arrows: Arrows.
        kinds: What they show, in the order in which they can be chosen.
        bent: (n,) joint positions of each posture under its load, deflections enlarged as the arrows are; empty where
            no load is known.
    """

    name: str
    chain: Chain
    solids: tuple[Solid, ...]
    plain: str
    postures: tuple[tuple[str, Float1D], ...]
    targets: Mapping[str, Float1D]
    frames: tuple[Frame, ...] = ()
    tracker: Float1D | None = None
    boxes: tuple[tuple[str, Float1D, Float2D], ...] = ()
    places: Mapping[str, Float2D] = dataclasses.field(default_factory=dict)
    arrows: tuple[Arrow, ...] = ()
    kinds: tuple[ArrowKind, ...] = (FORCE, DEFLECTION)
    bent: tuple[Float1D, ...] = ()

    def json(self) -> dict[str, Any]:
        """Return the view as `scene.js` reads it (see the package)."""
        chain, meshes = self.chain.whole, [solid for solid in self.solids if solid.form == "mesh"]
        gears = {
            one.name: {"mimic": {"joint": one.driver, "multiplier": one.multiplier, "offset": one.offset}}
            for one in self.chain.mimics
        }
        numbers = {id(solid): k for k, solid in enumerate(meshes)}
        return {
            "schema": SCHEMA,
            "name": _name(self.name),
            "joints": [
                {
                    "name": _name(name),
                    "prismatic": chain.prismatic[i],
                    "offset": float(chain.offset[i]),
                    "pose": _pose(chain.rotation[i], chain.translation[i]),
                    **gears.get(name, {}),
                }
                for i, name in enumerate(chain.joints)
            ],
            "flange": _pose(chain.flange_rotation, chain.flange_translation),
            "solids": [
                {
                    "link": solid.link,
                    "form": solid.form,
                    "size": _numbers(solid.size),
                    "pose": _numbers(solid.pose[:3]),
                    **({"mesh": numbers[id(solid)]} if id(solid) in numbers else {}),
                }
                for solid in self.solids
            ],
            "meshes": [_mesh(solid) for solid in meshes],
            "postures": [
                {"name": _name(name), "q": _numbers(q), **({"bent": _numbers(self.bent[k])} if self.bent else {})}
                for k, (name, q) in enumerate(self.postures)
            ],
            "targets": {_name(name): _numbers(place) for name, place in self.targets.items()},
            "frames": [
                {"name": _name(frame.name), "on": frame.on, "pose": _numbers(frame.pose[:3])} for frame in self.frames
            ],
            "tracker": None if self.tracker is None else _numbers(self.tracker),
            "boxes": [
                {"name": _name(name), "size": _numbers(size), "pose": _numbers(pose[:3])}
                for name, size, pose in self.boxes
            ],
            "places": {_name(name): [_numbers(row) for row in rows] for name, rows in self.places.items()},
            "arrows": [
                {
                    "kind": arrow.kind,
                    "posture": arrow.posture,
                    "start": _numbers(arrow.start),
                    "vector": _numbers(arrow.vector),
                }
                for arrow in self.arrows
                if np.all(np.isfinite(arrow.vector))
            ],
            "kinds": [dataclasses.asdict(kind) for kind in self.kinds],
        }


def cell_view(cell: Cell, postures: Sequence[tuple[str, Float1D]] = ()) -> View:
    """Return what a cell file describes.

    Args:
        cell: The cell.
        postures: Name and (n,) joint positions of each posture; a bent arm if there are none.

    Raises:
        CellError: The robot cannot be read.
    """
    chain = chain_of(cell)
    solids, plain = robot_solids(cell, chain)
    frames = [Frame("base", "base", np.eye(4)), Frame("flange", "flange", np.eye(4))]
    if cell.frames.tracker is not None:
        pose = cell.frames.tracker
        frames.append(Frame("tracker", "base", pose_matrix(np.array(pose.xyz), np.array(pose.rpy))))
    if cell.frames.force_torque is not None:
        pose = cell.frames.force_torque
        frames.append(Frame("force/torque sensor", "flange", pose_matrix(np.array(pose.xyz), np.array(pose.rpy))))
    if cell.frames.wrench_point is not None:
        frames.append(Frame("wrench point", "flange", pose_matrix(np.array(cell.frames.wrench_point), np.zeros(3))))
    return View(
        name=f"{cell.robot.name} in {cell.name}",
        chain=chain,
        solids=solids,
        plain=plain,
        postures=tuple(postures) or (("as drawn", bent(chain)),),
        targets={name: np.array(place) for name, place in cell.frames.measurement_points.items()},
        frames=tuple(frames),
        tracker=None if cell.frames.tracker is None else np.array(cell.frames.tracker.xyz),
        boxes=tuple(
            (box.name, np.array(box.size), pose_matrix(np.array(box.xyz), np.array(box.rpy))) for box in cell.boxes
        ),
    )


def bent(chain: Chain) -> Float1D:
    """Return joint positions, (n,), at which a robot can be looked at: zero, or what of the limits is nearest."""
    low, high = chain.limits[:, 0], chain.limits[:, 1]
    return np.clip(np.zeros(chain.n), low, high)


def _name(text: str) -> str:
    return printable(text, NAME)


def _numbers(values: Any) -> list[float]:
    return [round(float(value), 6) for value in np.asarray(values, dtype=float).reshape(-1)]


def _pose(rotation: Float2D, translation: Float1D) -> list[float]:
    return _numbers(np.column_stack([rotation, translation]))


def _mesh(solid: Solid) -> dict[str, Any]:
    low = solid.vertices.min(axis=0) if len(solid.vertices) else np.zeros(3)
    step = float(np.max(solid.vertices - low, initial=1e-9)) / 65535.0
    grid = np.round((solid.vertices - low) / step).astype("<u2")
    return {
        "low": _numbers(low),
        "step": step,
        "vertices": base64.b64encode(grid.tobytes()).decode("ascii"),
        "faces": base64.b64encode(solid.faces.astype("<u2").tobytes()).decode("ascii"),
    }
