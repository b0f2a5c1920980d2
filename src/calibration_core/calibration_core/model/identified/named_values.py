"""Names for every number of a model: the path at which it stands in the model file.

`compliance.joint_2`, `geometry.joint_2.rx`, `tracker.yaw`, `measurement_points.mp1.x`, `wrench_point.z`,
`force_torque.x` and `effects.0.compliance_x` (the first effect of the file).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from calibration_core.model.chain import pose_matrix, xyz_rpy
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float2D

AXES = ("x", "y", "z")
GEOMETRY = ("x", "y", "z", "rx", "ry", "rz")
POSE = ("x", "y", "z", "roll", "pitch", "yaw")


def value_of(parameters: ModelParameters, name: str) -> float:
    """Return the value that a name stands for.

    Raises:
        KeyError: The model has no such number.
    """
    group, _, rest = name.partition(".")
    inside, _, last = rest.rpartition(".")
    if group == "compliance":
        return float(parameters.compliance[_index(parameters.joints, rest)])
    if group == "geometry":
        return float(parameters.geometry[_index(parameters.joints, inside), _index(GEOMETRY, last)])
    if group == "tracker":
        return _of_pose(parameters.tracker, rest)
    if group == "force_torque" and parameters.force_torque is not None:
        return _of_pose(parameters.force_torque, rest)
    if group == "measurement_points":
        return float(parameters.points[inside][_index(AXES, last)])
    if group == "wrench_point" and parameters.wrench_point is not None:
        return float(parameters.wrench_point[_index(AXES, rest)])
    if group == "effects":
        number, _, parameter = rest.partition(".")
        if number.isdecimal() and int(number) < len(parameters.effects):
            return parameters.effects[int(number)].parameters[parameter]
    raise KeyError(name)


def with_values(parameters: ModelParameters, values: Mapping[str, float]) -> ModelParameters:
    """Return the model with some of its numbers changed; compliances do not become negative.

    Args:
        parameters: The model.
        values: Name -> value, SI units.

    Raises:
        KeyError: The model has no such number.
    """
    compliance, geometry = parameters.compliance.copy(), parameters.geometry.copy()
    points = {name: point.copy() for name, point in parameters.points.items()}
    wrench_point = None if parameters.wrench_point is None else parameters.wrench_point.copy()
    poses: dict[str, dict[str, float]] = {"tracker": {}, "force_torque": {}}
    effects = [dict(effect.parameters) for effect in parameters.effects]
    for name, value in values.items():
        value_of(parameters, name)  # a name that the model does not know is refused
        group, _, rest = name.partition(".")
        inside, _, last = rest.rpartition(".")
        if group == "compliance":
            compliance[_index(parameters.joints, rest)] = max(value, 0.0)
        elif group == "geometry":
            geometry[_index(parameters.joints, inside), _index(GEOMETRY, last)] = value
        elif group == "measurement_points":
            points[inside][_index(AXES, last)] = value
        elif group == "wrench_point" and wrench_point is not None:
            wrench_point[_index(AXES, rest)] = value
        elif group == "effects":
            number, _, parameter = rest.partition(".")
            effects[int(number)][parameter] = value
        else:
            poses[group][rest] = value
    sensor = parameters.force_torque
    return parameters.replace(
        compliance=compliance,
        geometry=geometry,
        tracker=_changed_pose(parameters.tracker, poses["tracker"]),
        points=points,
        wrench_point=wrench_point,
        force_torque=None if sensor is None else _changed_pose(sensor, poses["force_torque"]),
        effects=tuple(
            dataclasses.replace(effect, parameters=changed)
            for effect, changed in zip(parameters.effects, effects, strict=True)
        ),
    )


def unit_of(name: str, prismatic: Mapping[str, bool]) -> str:
    """Return the unit of a number that is no effect's; those of effects stand in the catalogue.

    Raises:
        KeyError: It is an effect's, or there is no such name.
    """
    group, _, rest = name.partition(".")
    if group == "compliance":
        return "m/N" if prismatic[rest] else "rad/(N*m)"
    if group in {"geometry", "tracker", "force_torque", "measurement_points", "wrench_point"}:
        return "m" if rest.rpartition(".")[2] in AXES else "rad"
    raise KeyError(name)


def _index(names: tuple[str, ...], name: str) -> int:
    if name not in names:
        raise KeyError(name)
    return names.index(name)


def _of_pose(pose: Float2D, part: str) -> float:
    return float(xyz_rpy(pose)[_index(POSE, part)])


def _changed_pose(pose: Float2D, values: Mapping[str, float]) -> Float2D:
    if not values:
        return pose
    numbers = xyz_rpy(pose)
    for part, value in values.items():
        numbers[_index(POSE, part)] = value
    return pose_matrix(numbers[:3], numbers[3:])
