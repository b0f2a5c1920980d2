"""URDFs, read with yourdfpy: kinematic chain, masses, and the bodies that links are made of."""

from calibration_core.model.urdf.bodies import Body, lost_meshes, mesh_file, urdf_bodies, urdf_shapes
from calibration_core.model.urdf.reading import chain_of_urdf

__all__ = ["Body", "chain_of_urdf", "lost_meshes", "mesh_file", "urdf_bodies", "urdf_shapes"]
