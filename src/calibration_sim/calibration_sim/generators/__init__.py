"""Makers of effects, by name: each turns an amplitude and a source of randomness into a law at a place."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from calibration_sim.effect_models.effect import Effect
from calibration_sim.generators import (
    absolute,
    anomalies,
    chains,
    everywhere,
    joint_law,
    other_shapes,
    outside,
    structure,
)
from calibration_sim.generators.draw import Draw

Maker = Callable[[Draw], Effect]


def _by_name(*makers: Maker) -> Mapping[str, Maker]:
    return MappingProxyType({maker.__name__: maker for maker in makers})


CATALOGUE = _by_name(
    structure.off_axis_compliance,
    structure.link_bending,
    structure.base_compliance,
    structure.tool_compliance,
    structure.joint_coupling,
    structure.pose_dependent_stiffness,
    structure.gravity_compensator,
    joint_law.nonlinear_stiffness,
    joint_law.soft_zone,
    joint_law.backlash,
    joint_law.hysteresis,
    joint_law.creep,
    chains.wrench_gain,
    chains.wrench_crosstalk,
    chains.wrench_drift,
    chains.wrench_frame_misalignment,
    chains.wrench_point_offset,
    chains.tool_weight,
    chains.cable_force,
    chains.tracker_frame_misalignment,
    chains.tracker_scale,
    chains.tracker_drift,
    chains.measurement_point_offset,
    chains.clock_offset,
    absolute.joint_zero_offset,
    absolute.geometry_error,
    absolute.transmission_error,
    absolute.wrist_coupling,
    absolute.joint_elasticity,
    absolute.thermal_growth,
    absolute.approach_direction,
)
ANOMALIES = _by_name(
    anomalies.target_moved,
    anomalies.loose_target,
    anomalies.tracker_moved,
    anomalies.outlier_readings,
    anomalies.noise_understated,
    anomalies.unsettled,
    anomalies.wrong_robot_file,
)
OUTSIDE = _by_name(
    outside.pose_modulation,
    outside.nest_slip,
    outside.rig_contact,
    outside.thermal_jump,
    outside.rig_stick_slip,
    outside.turning_tool,
)
OTHER_SHAPES = _by_name(
    other_shapes.wedge_friction,
    other_shapes.dahl_friction,
    other_shapes.uneven_friction,
    other_shapes.power_law,
    other_shapes.lost_preload,
    other_shapes.one_sided,
    other_shapes.other_wave,
)
EVERYWHERE = _by_name(
    everywhere.every_gear,
    everywhere.every_friction,
    everywhere.every_soft_zone,
    everywhere.every_spring,
)
GENERATORS: Mapping[str, Maker] = MappingProxyType({**CATALOGUE, **ANOMALIES, **OUTSIDE, **OTHER_SHAPES, **EVERYWHERE})
