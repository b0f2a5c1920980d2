"""Draws effects that no catalogue holds.  Amplitude one is a first guess; scenarios scale it to what can be seen."""

from __future__ import annotations

import numpy as np

from calibration_core.timeseries import Float1D
from calibration_sim.cell.protocol import STANDARD_ACCELERATION
from calibration_sim.effect_models import outside
from calibration_sim.effect_models.effect import Effect, Label
from calibration_sim.generators.draw import Draw, at_joint


def pose_modulation(draw: Draw) -> Effect:
    """Compliance that follows two joint angles together."""
    j = draw.among(1, 2)
    label = Label("outside", "pose_modulation", at_joint(j), draw.amplitude)
    phase = float(draw.rng.uniform(0.0, 2.0 * np.pi))
    return outside.PoseModulation(label, j, j + 1, 0.15 * draw.amplitude, phase)


def _chosen(draw: Draw, count: int) -> list[int]:
    return sorted(int(k) for k in draw.rng.choice(draw.configurations, count, replace=False))


def _numbers(indices: list[int]) -> tuple[int, ...]:
    return tuple(k + 1 for k in indices)


def _unit(vector: Float1D) -> Float1D:
    return np.asarray(vector / np.linalg.norm(vector))


def nest_slip(draw: Draw) -> Effect:
    """A target that slips at one step of a few configurations."""
    point = draw.among(0, 1, 2)
    chosen = _chosen(draw, 3)
    size = 1.5e-4 * draw.amplitude
    slips = tuple((k, int(draw.rng.integers(2, 7)), size * draw.direction()) for k in chosen)
    label = Label("outside", "nest_slip", {"point": f"mp{point + 1}"}, draw.amplitude, configurations=_numbers(chosen))
    return outside.NestSlip(label, point, slips)


def rig_contact(draw: Draw) -> Effect:
    """A stop below the wrist that the arm runs against in a few configurations."""
    chosen = _chosen(draw, 5)
    heavy = draw.size.tool_mass > 5.0
    label = Label("outside", "rig_contact", {"robot": "robot"}, draw.amplitude, configurations=_numbers(chosen))
    down = np.array([0.0, 0.0, -1.5])
    stops = tuple((k, _unit(draw.direction() + down)) for k in chosen)
    stiffness = (1e5 if heavy else 8e3) * draw.amplitude
    return outside.RigContact(label, 4, "link_5", stops, 1e-4, stiffness)


def thermal_jump(draw: Draw) -> Effect:
    """A door that opens while a configuration is measured."""
    chosen = _chosen(draw, 4)
    size = draw.amplitude
    jumps = tuple(
        (k, int(draw.rng.integers(2, 7)), 6e-5 * size * draw.direction(), 1e-4 * size * draw.direction())
        for k in chosen
    )
    label = Label("outside", "thermal_jump", {"robot": "robot"}, size, configurations=_numbers(chosen))
    return outside.ThermalJump(label, jumps)


def rig_stick_slip(draw: Draw) -> Effect:
    """A guide of the rig that sticks and slips beside the sensor."""
    force = STANDARD_ACCELERATION * (240.0 if draw.size.tool_mass > 5.0 else 10.0)
    label = Label("outside", "rig_stick_slip", {"robot": "robot"}, draw.amplitude)
    return outside.RigStickSlip(label, 0.02 * draw.amplitude, force, draw.seed())


def turning_tool(draw: Draw) -> Effect:
    """A wrist that tilts by a third harmonic of the last joint."""
    label = Label("outside", "turning_tool", at_joint(4), draw.amplitude)
    compliance = 0.15 * draw.amplitude / float(draw.stiffness[4])
    return outside.TurningTool(label, 4, 5, compliance, float(draw.rng.uniform(0.0, 2.0 * np.pi)))
