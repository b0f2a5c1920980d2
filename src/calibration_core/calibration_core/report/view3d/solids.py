"""The robot's bodies: the URDF's, with meshes made simple, or cylinders along the joints where there are none."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.chain import Chain
from calibration_core.model.urdf.reading import Body, Form, lost_meshes, urdf_shapes
from calibration_core.timeseries import Float1D, Float2D, Int2D

MOST_FACES = 1200
"""Faces that a mesh keeps at most."""

SLENDER = 0.045
"""Radius of an arm without a shape of its own, as a share of the reach."""

KINDS: tuple[Literal["visual", "collision"], ...] = ("visual", "collision")


@dataclasses.dataclass(frozen=True, eq=False)
class Solid:
    """One body of the robot.

    Attributes:
        link: 0 for the base, i for what moving joint i carries, those that mimic others counted (`Chain.whole`).
        form: What it is.
        size: m: (3,) edges of a box; (2,) radius and length of a cylinder along z; (1,) radius; (0,) of a mesh.
        pose: (4, 4) in the link's body frame.
        vertices: (k, 3) m of a mesh, in its own frame; (0, 3) otherwise.
        faces: (f, 3) rows of `vertices`.
    """

    link: int
    form: Form
    size: Float1D
    pose: Float2D
    vertices: Float2D = dataclasses.field(default_factory=lambda: np.zeros((0, 3)))
    faces: Int2D = dataclasses.field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))


def robot_solids(cell: Cell, chain: Chain) -> tuple[tuple[Solid, ...], str]:
    """Return the robot's bodies, and why they are not the maker's; empty if they are.

    A URDF's visual bodies are taken, else its collision bodies, else cylinders from joint to joint.
    """
    reason = "the cell file has DH rows" if cell.urdf_path is None else "the URDF has no bodies"
    for kind in KINDS if cell.urdf_path is not None else ():
        shapes, lost = urdf_shapes(cell, kind)
        if shapes and not lost:
            return tuple(_solid(body, shape) for body, shape in shapes), ""
        reason = lost_meshes(lost) or reason
    return _slender(chain.whole), reason


def simplified(vertices: Float2D, faces: Int2D, most: int = MOST_FACES) -> tuple[Float2D, Int2D]:
    """Return a mesh with at most `most` faces: vertices in one cell of a grid become one, in their middle.

    Args:
        vertices: (k, 3) m.
        faces: (f, 3) rows of `vertices`.
        most: Faces at most.
    """
    extent = float(np.max(np.ptp(vertices, axis=0), initial=0.0))
    if len(faces) <= most or extent == 0.0:
        return vertices, faces
    cells = 96
    while True:
        kept, rows = _clustered(vertices, faces, extent / cells)
        if len(rows) <= most or cells == 1:
            return kept, rows
        cells = max(1, int(cells * 0.8))


def _clustered(vertices: Float2D, faces: Int2D, step: float) -> tuple[Float2D, Int2D]:
    grid = np.floor((vertices - vertices.min(axis=0)) / step).astype(np.int64)
    _, index = np.unique(grid, axis=0, return_inverse=True)
    index = index.reshape(-1)
    count = np.bincount(index)
    middle = np.stack([np.bincount(index, weights=vertices[:, k]) / count for k in range(3)], axis=1)
    mapped = index[faces]
    whole = (mapped[:, 0] != mapped[:, 1]) & (mapped[:, 1] != mapped[:, 2]) & (mapped[:, 2] != mapped[:, 0])
    _, once = np.unique(np.sort(mapped[whole], axis=1), axis=0, return_index=True)
    return middle, mapped[whole][np.sort(once)]


def _solid(body: Body, mesh: Any) -> Solid:
    """Return a body; `mesh` is its `coal` shape."""
    if body.form != "mesh":
        return Solid(body.link, body.form, body.size, body.pose)
    vertices = np.array(mesh.vertices(), dtype=float)
    faces = np.array([[row[0], row[1], row[2]] for row in (mesh.tri_indices(i) for i in range(mesh.num_tris))])
    return Solid(body.link, "mesh", np.zeros(0), body.pose, *simplified(vertices, faces.reshape(-1, 3).astype(int)))


def _slender(chain: Chain) -> tuple[Solid, ...]:
    """Return cylinders from each joint to the next, along its axis and then across, and one around every joint."""
    radius = SLENDER * chain.reach
    ends = [*chain.translation, chain.flange_translation]
    solids = []
    for link, end in enumerate(ends):
        width = radius * (1.0 - 0.5 * link / chain.n)
        corner = np.array([0.0, 0.0, end[2]])
        for start, stop in ((np.zeros(3), corner), (corner, np.asarray(end))):
            if np.linalg.norm(stop - start) > 1e-9:
                solids.append(_rod(link, start, stop, 0.7 * width))
        if link < chain.n and not chain.prismatic[link]:
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = chain.rotation[link], end
            solids.append(Solid(link, "cylinder", np.array([width, 2.2 * width]), pose))
    return tuple(solids)


def _rod(link: int, start: Float1D, stop: Float1D, radius: float) -> Solid:
    """Return a cylinder between two points, (3,) m."""
    length = float(np.linalg.norm(stop - start))
    z = (stop - start) / length
    side = np.cross(z, [1.0, 0.0, 0.0] if abs(z[0]) < 0.9 else [0.0, 1.0, 0.0])
    x = side / np.linalg.norm(side)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), (start + stop) / 2
    return Solid(link, "cylinder", np.array([radius, length]), pose)


def mesh_of(solid: Solid, sides: int = 20) -> tuple[Float2D, Int2D]:
    """Return the surface of a body as a mesh: (k, 3) m in its own frame, and (f, 3) rows of it."""
    if solid.form == "mesh":
        return solid.vertices, solid.faces
    if solid.form == "box":
        corners = np.array([(x, y, z) for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]) * solid.size
        quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
        return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    if solid.form == "cylinder":
        radius, length = solid.size
        return _lathe(np.array([[0.0, -0.5], [1.0, -0.5], [1.0, 0.5], [0.0, 0.5]]) * [radius, length], sides)
    angles = np.linspace(-np.pi / 2, np.pi / 2, 9)
    return _lathe(solid.size[0] * np.stack([np.cos(angles), np.sin(angles)], axis=1), sides)


def _lathe(profile: Float2D, sides: int) -> tuple[Float2D, Int2D]:
    """Turn a profile, (k, 2) m of radius and height from below, about z."""
    angle = np.linspace(0.0, 2 * np.pi, sides, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices = np.concatenate([np.column_stack([r * ring, np.full(sides, z)]) for r, z in profile])
    here = np.arange(sides)
    following = (here + 1) % sides
    faces = []
    for k in range(len(profile) - 1):
        low, high = k * sides, (k + 1) * sides
        faces.append(np.stack([low + here, low + following, high + following], axis=1))
        faces.append(np.stack([low + here, high + following, high + here], axis=1))
    return vertices, np.concatenate(faces)
