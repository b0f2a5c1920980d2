"""URDFs, read with yourdfpy: kinematic chain, masses, and the bodies that links are made of."""

from calibration_core.model.urdf.bodies import Body, coal_shape, urdf_bodies
from calibration_core.model.urdf.reading import chain_of_urdf

__all__ = ["Body", "chain_of_urdf", "coal_shape", "urdf_bodies"]
