"""What the links of a URDF look like and touch with: primitives and meshes, link by link.

A URDF is often handed on without its meshes.  They are looked for beside it, in the folders above it, and where ROS
looks: in `ROS_PACKAGE_PATH` and `AMENT_PREFIX_PATH`.  One that is not found, or that holds nothing, is no error: it is
named, and others take the link's place.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal
from urllib.parse import unquote

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import CellError, quoted
from calibration_core.model.urdf.reading import link_poses
from calibration_core.model.urdf.tree import tree_of
from calibration_core.timeseries import Float1D, Float2D

MESHES = "meshes"  # folder beside a URDF into which `init` copies its meshes
MAX_MESH_BYTES = 256 << 20
SHOWN = 3  # meshes that a message names
Kind = Literal["collision", "visual"]
Form = Literal["box", "cylinder", "sphere", "mesh"]


@dataclasses.dataclass(frozen=True, eq=False)
class Body:
    """One rigid body of the robot.

    Attributes:
        link: 0 for the base, i for what moving joint i carries, those that mimic others counted (`Chain.whole`).
        name: Of the URDF's link, with a number where it has several bodies.
        form: What it is.
        size: m: edges of a box, (3,); radius and length of a cylinder, (2,); radius of a sphere, (1,); the factors by
            which a mesh is scaled, (3,).
        mesh: The mesh as the URDF names it; empty for a primitive.
        pose: (4, 4) in the link's body frame (after the joint's rotation; the base frame for the base).
    """

    link: int
    name: str
    form: Form
    size: Float1D
    mesh: str
    pose: Float2D


def urdf_bodies(cell: Cell, kind: Kind = "collision") -> tuple[Body, ...]:
    """Return the bodies of the URDF's links, none where it states none; joints off the chain stand at zero.

    Raises:
        CellError: The URDF cannot be read.
    """
    if cell.urdf_path is None:
        return ()
    tree = tree_of(cell)
    bodies = []
    for name, (carrier, pose) in link_poses(cell, tree).items():
        link = tree.links[name]
        for number, one in enumerate(link.collisions if kind == "collision" else link.visuals):
            placed = pose if one.origin is None else pose @ np.asarray(one.origin, dtype=float)
            title = name if number == 0 else f"{name} {number + 1}"
            form, size, mesh = _form(cell.urdf_path, f"link {quoted(name)}, {kind}", one.geometry)
            bodies.append(Body(carrier + 1, title, form, size, mesh, placed))
    return tuple(bodies)


def _form(urdf: Path, place: str, geometry: Any) -> tuple[Form, Float1D, str]:
    if geometry is None:
        raise CellError(urdf, place, "no geometry", "a box, cylinder, sphere or mesh")
    if geometry.box is not None:
        return "box", np.asarray(geometry.box.size, dtype=float), ""
    if geometry.cylinder is not None:
        return "cylinder", np.array([geometry.cylinder.radius, geometry.cylinder.length]), ""
    if geometry.sphere is not None:
        return "sphere", np.array([geometry.sphere.radius]), ""
    scale = np.ones(3) if geometry.mesh.scale is None else np.broadcast_to(geometry.mesh.scale, 3).astype(float)
    return "mesh", scale, str(geometry.mesh.filename)


def urdf_shapes(cell: Cell, kind: Kind = "collision") -> tuple[list[tuple[Body, Any]], dict[Body, str]]:
    """Return the bodies with their `coal.CollisionGeometry`, and those whose mesh cannot be had, with the reason.

    Raises:
        CellError: The URDF cannot be read.
    """
    shapes: list[tuple[Body, Any]] = []
    lost: dict[Body, str] = {}
    for body in urdf_bodies(cell, kind):
        found = _shape(cell, body)
        if isinstance(found, str):
            lost[body] = found
        else:
            shapes.append((body, found))
    return shapes, lost


def lost_meshes(lost: dict[Body, str]) -> str:
    """Return a sentence on meshes that cannot be had, with what is done instead and the cure; empty for none."""
    if not lost:
        return ""
    names = list(dict.fromkeys(f"{body.mesh} ({reason})" for body, reason in lost.items()))
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return (
        f"meshes of the URDF cannot be used: {', '.join(names[:SHOWN])}{more}; capsules along the links take their "
        f"place; to have them, set ROS_PACKAGE_PATH or AMENT_PREFIX_PATH, or give calibration init --meshes FOLDER"
    )


def mesh_file(urdf: Path, name: str, folders: Sequence[Path] = ()) -> Path | None:
    """Return where a mesh of a URDF lies; None where it is not found.

    Args:
        urdf: The URDF.
        name: As the URDF names it: `package://PACKAGE/...`, `file:///...`, a path.
        folders: Where to look besides, first.
    """
    scheme, _, rest = name.rpartition("://")
    inside = mesh_place(name)
    places = [urdf.parent / MESHES / inside]
    places += [] if scheme == "package" else [urdf.parent / unquote(rest)]
    places += [
        place for folder in folders for place in (folder / inside, *_within(folder, inside), folder / inside.name)
    ]
    for folder in urdf.parents:
        places += [folder / inside, *_within(folder, inside)]
    if scheme == "package":
        roots = [Path(one) for one in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if one]
        places += [place for root in roots for place in (root / inside, *_within(root, inside))]
        places += [found for root in roots for found in sorted(root.glob(f"*/{inside}"))]  # a repository of packages
        prefixes = [Path(one) for one in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if one]
        places += [prefix / "share" / inside for prefix in prefixes]
    return next((place for place in places if place.is_file()), None)


def mesh_place(name: str) -> Path:
    """Return where a mesh that a URDF names lies in a folder of meshes: without scheme and ways upwards."""
    return Path(*(part for part in Path(unquote(name.rpartition("://")[2])).parts if part not in ("..", "/")))


def _within(folder: Path, inside: Path) -> Iterator[Path]:
    """Yield a file of a package in a folder that is the package's, of whatever name."""
    if len(inside.parts) > 1:
        yield folder / Path(*inside.parts[1:])


def _shape(cell: Cell, body: Body) -> Any:
    """Return a body as a `coal.CollisionGeometry`, or why its mesh cannot be used."""
    import coal

    if body.form == "box":
        return coal.Box(*body.size)
    if body.form == "cylinder":
        return coal.Cylinder(*body.size)
    if body.form == "sphere":
        return coal.Sphere(*body.size)
    path = None if cell.urdf_path is None else mesh_file(cell.urdf_path, body.mesh)
    if path is None:
        return "not found"
    if path.stat().st_size > MAX_MESH_BYTES:
        return f"more than {MAX_MESH_BYTES >> 20} MB"
    try:
        shape = coal.MeshLoader().load(str(path), body.size)
    except (RuntimeError, ValueError):  # what the loader says names a place in its own sources
        return "empty or not readable"
    return shape if shape.num_tris > 0 and np.isfinite(np.asarray(shape.vertices())).all() else "empty or not readable"
