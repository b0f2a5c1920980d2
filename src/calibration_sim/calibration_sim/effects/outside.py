"""Effects that no catalogue holds: the diagnosis shall say that something is left which it cannot name.

Amplitude one is a first guess; scenarios scale it to what can be seen.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calibration_core.timeseries import Float1D, Float3D
from calibration_sim.cell.protocol import STANDARD_ACCELERATION
from calibration_sim.effects.draw import Draw, unit
from calibration_sim.effects.effect import Acting, At, Effect, Session, modulated, moving, seen
from calibration_sim.mechanics.statics import Push


def _numbers(indices: list[int]) -> tuple[int, ...]:
    return tuple(k + 1 for k in indices)


def pose_modulation(draw: Draw) -> Effect:
    """A joint's compliance varies with two joint angles together, C (1 + a sin(2 q_j + 3 q_k + phase))."""
    j = draw.among(1, 2)
    label = draw.label("outside", "pose_modulation", draw.at(j))
    share, phase, joint = 0.15 * draw.amplitude, draw.phase(), draw.first + j
    return modulated(label, joint, lambda q: share * np.sin(2.0 * q[joint] + 3.0 * q[joint + 1] + phase))


def nest_slip(draw: Draw) -> Effect:
    """In a few configurations a target slips in its nest at one step; it sits right again in the next configuration."""
    point = draw.among(0, 1, 2)
    chosen = draw.some(3)
    size = 1.5e-4 * draw.amplitude
    slips = [(k, int(draw.rng.integers(2, 7)), size * draw.direction()) for k in chosen]
    label = draw.label("outside", "nest_slip", {"point": f"mp{point + 1}"}, configurations=_numbers(chosen))

    def slip(points: Float3D, session: Session) -> Float3D:
        result = points.copy()
        for index, step, shift in slips:
            moved = session.from_step(index, step)
            result[moved, point] += session.axes[moved] @ shift
        return result

    return seen(label, slip)


def rig_contact(draw: Draw) -> Effect:
    """In a few configurations the arm runs against a stop of the rig as it gives way: a one-sided spring."""
    chosen, link, gap = draw.some(5), draw.first + 4, 1e-4
    label = draw.label("outside", "rig_contact", {"robot": "robot"}, configurations=_numbers(chosen))
    down = np.array([0.0, 0.0, -1.5])
    stops = [(k, unit(draw.direction() + down)) for k in chosen]  # from where the link is at step 0, base axes
    stiffness = (1e5 if draw.size.tool_mass > 5.0 else 8e3) * draw.amplitude

    def stop(free: Float1D, towards: Float1D) -> Callable[[Float1D], Float1D]:
        return lambda place: np.asarray(-stiffness * max(0.0, float((place - free) @ towards) - gap) * towards)

    def pushes(at: At) -> tuple[Push, ...]:
        if at.places is None:
            return ()
        free = at.places[link]
        return tuple(
            Push(f"link_{link + 1}", np.zeros(3), stop(free, towards)) for k, towards in stops if k == at.index
        )

    return Acting(label, {"pushes": pushes})


def thermal_jump(draw: Draw) -> Effect:
    """A door opens while a configuration is measured: all that is seen shifts and turns from one step on."""
    chosen = draw.some(4)
    size = draw.amplitude
    jumps = [
        (k, int(draw.rng.integers(2, 7)), 6e-5 * size * draw.direction(), 1e-4 * size * draw.direction())
        for k in chosen
    ]
    label = draw.label("outside", "thermal_jump", {"robot": "robot"}, configurations=_numbers(chosen))

    def jump(points: Float3D, session: Session) -> Float3D:
        result = points.copy()
        for index, step, shift, turn in jumps:
            moved = session.from_step(index, step)
            middle = points[moved].mean(axis=(0, 1)) if moved.any() else np.zeros(3)
            result[moved] += shift + np.cross(turn, points[moved] - middle)
        return result

    return seen(label, jump)


def rig_stick_slip(draw: Draw) -> Effect:
    """Part of the pull goes past the sensor, through a guide that sticks and slips: another share at every step."""
    force = STANDARD_ACCELERATION * (240.0 if draw.size.tool_mass > 5.0 else 10.0)
    largest, seed = 0.02 * draw.amplitude * force, draw.seed()

    def pushes(at: At) -> tuple[Push, ...]:
        """Pull at the flange, from the second step on."""
        if at.step == 0:
            return ()
        rng = np.random.default_rng((seed, at.index))
        direction = unit(rng.standard_normal(3))
        levels = rng.uniform(-1.0, 1.0, 64)
        held = levels[at.step - 1] if levels[32 + at.step] > 0.0 else levels[at.step - at.step % 3]
        pull = largest * float(held) * direction
        return (Push("flange", np.zeros(3), lambda place: np.asarray(pull + 0.0 * place)),)

    return Acting(draw.label("outside", "rig_stick_slip", {"robot": "robot"}), {"pushes": pushes})


def turning_tool(draw: Draw) -> Effect:
    """The adapter's bolts give way unevenly: the wrist tilts by a third harmonic of joint 6, joint 4 with it."""
    compliance, phase, tilts = 0.15 * draw.amplitude / float(draw.stiffness[4]), draw.phase(), draw.first + 4

    def tilt(torque: Float1D, at: At) -> dict[int, float]:
        wave = 3.0 * at.q[tilts + 1] + phase
        dragged = compliance * np.cos(wave) * torque[tilts - 1]
        return {tilts: compliance * np.sin(wave) * torque[tilts], tilts - 1: dragged}

    return moving(draw.label("outside", "turning_tool", draw.at(4)), tilt)
