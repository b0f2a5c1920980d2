"""What the links of a URDF look like and touch with: primitives and references to meshes, link by link."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import CellError, quoted
from calibration_core.model.urdf.reading import link_poses
from calibration_core.model.urdf.tree import tree_of
from calibration_core.timeseries import Float1D, Float2D

MAX_MESH_BYTES = 256 << 20
FOLDERS_ABOVE = 3  # of the URDF's, in which meshes are looked for
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
        mesh: The mesh's file; None for a primitive.
        pose: (4, 4) in the link's body frame (after the joint's rotation; the base frame for the base).
    """

    link: int
    name: str
    form: Form
    size: Float1D
    mesh: Path | None
    pose: Float2D


def urdf_bodies(cell: Cell, kind: Kind = "collision") -> tuple[Body, ...]:
    """Return the bodies of the URDF's links, none where it states none; joints off the chain stand at zero.

    `package://` and relative names of meshes are looked for beside the URDF and in the three folders above it.

    Raises:
        CellError: The URDF cannot be read, or a mesh that it names does not exist.
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


def _form(urdf: Path, place: str, geometry: Any) -> tuple[Form, Float1D, Path | None]:
    if geometry is None:
        raise CellError(urdf, place, "no geometry", "a box, cylinder, sphere or mesh")
    if geometry.box is not None:
        return "box", np.asarray(geometry.box.size, dtype=float), None
    if geometry.cylinder is not None:
        return "cylinder", np.array([geometry.cylinder.radius, geometry.cylinder.length]), None
    if geometry.sphere is not None:
        return "sphere", np.array([geometry.sphere.radius]), None
    scale = np.ones(3) if geometry.mesh.scale is None else np.broadcast_to(geometry.mesh.scale, 3).astype(float)
    return "mesh", scale, _mesh_file(urdf, place, str(geometry.mesh.filename))


def _mesh_file(urdf: Path, place: str, name: str) -> Path:
    scheme, _, rest = name.rpartition("://")
    folders = (urdf.parent, *list(urdf.parents)[1 : FOLDERS_ABOVE + 1])
    places = [folder / rest for folder in folders]
    if scheme == "package":  # the package's folder may be left out, or be one of the folders
        places += [folder / Path(*Path(rest).parts[1:]) for folder in folders]
    found = next((path for path in places if path.is_file()), None)
    if found is None:
        raise CellError(urdf, place, quoted(name), "a mesh beside the URDF or in one of the three folders above it")
    if found.stat().st_size > MAX_MESH_BYTES:
        raise CellError(urdf, place, f"{quoted(name)} of {found.stat().st_size} bytes", f"at most {MAX_MESH_BYTES}")
    return found


def coal_shape(cell: Cell, body: Body) -> Any:
    """Return a body as a `coal.CollisionGeometry`.

    Raises:
        CellError: The mesh cannot be read.
    """
    import coal

    if body.form == "box":
        return coal.Box(*body.size)
    if body.form == "cylinder":
        return coal.Cylinder(*body.size)
    if body.form == "sphere":
        return coal.Sphere(*body.size)
    try:
        return coal.MeshLoader().load(str(body.mesh), body.size)
    except (RuntimeError, ValueError) as error:
        place = f"collision, {body.name}"
        raise CellError(body.mesh or cell.path, place, quoted(str(error)), "a mesh that can be read") from None
