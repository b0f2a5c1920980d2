"""URDFs, read with yourdfpy: kinematic chain, masses, and the bodies that links are made of."""

from calibration_core.model.urdf.reading import Body, chain_of_urdf, lost_meshes, mesh_file, urdf_bodies, urdf_shapes

__all__ = ["Body", "chain_of_urdf", "lost_meshes", "mesh_file", "urdf_bodies", "urdf_shapes"]
