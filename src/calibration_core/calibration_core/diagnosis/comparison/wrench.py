"""How the wrenches of two recordings of one measurement are related: sign, unit, axes, reference point."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np

from calibration_core.diagnosis.comparison.result import Difference, Side, farther_off
from calibration_core.timeseries import Float1D, Float2D, Float3D

SAME = 0.08  # of the recorded force: below, two wrenches are the same
CLOSE = 0.01  # the same: of two ways this close the simpler one is taken
TORQUE = 0.2  # the same for the torque
UNITS = {1.0: "", 1e3: "a factor of 1000 (kN for N)", 9.80665: "a factor of 9.81 (kilograms for N)"}
SMALL = 1e-6  # N: no load
ENOUGH = 3  # of the six axes that agree: the loads are the same, and the others are a witness's fault
REMOTE = 0.02  # m: a reference point that is farther away is another one


@dataclasses.dataclass(frozen=True, eq=False)
class _Way:
    """One way from the simulated to the recorded wrench: recorded = factor * axes @ simulated."""

    factor: float
    axes: Float3D
    name: str
    changes: int


def wrench_differences(recorded: Float2D, simulated: Float2D, axes: Float3D, side: Side) -> tuple[Difference, ...]:
    """Say in which way the wrenches are not the same.

    Args:
        recorded: (m, 6) N and N*m, as recorded.
        simulated: (m, 6), of the corresponding readings.
        axes: (m, 3, 3) columns are the sensor's axes in the base frame.
        side: Which of the two bends as the cell file's model does not.
    """
    force, other = recorded[:, :3], simulated[:, :3]
    size, model = (float(np.sqrt(np.mean(f**2))) for f in (force, other))
    if size < SMALL or model < SMALL:
        if size < SMALL and model < SMALL:
            return ()
        which: Side = "recording" if size < SMALL else "simulation"
        text = f"The {which} holds no load, the other does."
        return (Difference("loads", {"sensor": "force_torque"}, which, max(size, model), "N", text, True),)
    best, least = _best(recorded, simulated, axes)
    if best is None:
        if likened(recorded, simulated):
            return ()
        text = (
            f"The loads differ: recorded forces of {size:.0f} N rms, simulated ones of {model:.0f} N, and no sign, "
            f"unit or axes make them equal (best {100 * least:.0f} % off)."
        )
        return (Difference("loads", {"sensor": "force_torque"}, "either", least, "1", text, True),)
    return (*_named(best, side), *_reference(recorded, simulated, best, side))


def _best(recorded: Float2D, simulated: Float2D, axes: Float3D) -> tuple[_Way | None, float]:
    """Return the simplest way from simulated to recorded forces, None where there is none; and the least misfit."""
    force, other = recorded[:, :3], simulated[:, :3]
    size = float(np.sqrt(np.mean(force**2)))
    ways = sorted(_ways(axes), key=lambda way: way.changes)
    misfits = [float(np.sqrt(np.mean((force - _forward(way, other)) ** 2))) / size for way in ways]
    most = min(SAME, 2 * min(misfits) + CLOSE)
    return next((way for way, left in zip(ways, misfits, strict=True) if left <= most), None), min(misfits)


def read_as(recorded: Float2D, simulated: Float2D, axes: Float3D) -> Float2D:
    """Return a simulated wrench, (m, 6), in unit, sign, axes and at the point of the recorded one."""
    way, _ = _best(recorded, simulated, axes)
    if way is None:
        return simulated
    force, torque = _forward(way, simulated[:, :3]), _forward(way, simulated[:, 3:])
    factor, arm = _reduced(recorded, torque)
    return np.hstack([force, factor * torque + np.cross(arm, force)])


def likened(recorded: Float2D, simulated: Float2D) -> bool:
    """Tell whether two wrenches are the same loads, (m, 6) each: on half of the axes, or after a turn or gains."""
    size = np.repeat([np.sqrt(np.mean(part**2)) for part in (recorded[:, :3], recorded[:, 3:])], 3)
    near = SAME * np.maximum(size, SMALL) * np.sqrt(3)
    apart = np.sqrt(np.mean((recorded - simulated) ** 2, axis=0))
    turn = turn_between(recorded[:, :3], simulated[:, :3])
    turned = np.hstack([simulated[:, :3] @ turn.T, simulated[:, 3:] @ turn.T])
    others = (turned, simulated * [gain_of(*pair) for pair in zip(recorded.T, simulated.T, strict=True)])
    explained = any(np.all(np.sqrt(np.mean((recorded - other) ** 2, axis=0)) <= near) for other in others)
    return explained or int((apart <= near).sum()) >= ENOUGH


def turn_between(recorded: Float2D, simulated: Float2D) -> Float2D:
    """Return the (3, 3) turn that takes simulated forces to the recorded ones best (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(recorded.T @ simulated)
    return np.asarray((u * np.array([1.0, 1.0, np.linalg.det(u @ vt)])) @ vt)


def gain_of(recorded: Float1D, simulated: Float1D) -> float:
    """Return recorded over simulated by least squares, (m,) each; NaN where nothing is simulated."""
    power = float(simulated @ simulated)
    return float(recorded @ simulated) / power if power > 0 else float("nan")


def _ways(axes: Float3D) -> Iterator[_Way]:
    m = len(axes)
    same = np.broadcast_to(np.eye(3), (m, 3, 3))
    turns = [("", same, 0), ("in base axes", axes.transpose(0, 2, 1), 1), ("in sensor axes", axes, 1)]
    for factor in UNITS:
        for power in (1, -1) if factor != 1.0 else (1,):
            for sign in (1, -1):
                for name, turn, changes in turns:
                    count = changes + (sign < 0) + (factor != 1.0)
                    yield _Way(sign * factor**power, turn, name, count)
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if order != (0, 1, 2) or len(set(signs)) > 1:
                listed = ", ".join(f"{'-' if s < 0 else ''}{'xyz'[k]}" for k, s in zip(order, signs, strict=True))
                yield _Way(1.0, np.broadcast_to(matrix, (m, 3, 3)), f"x, y, z of the recording are {listed}", 3)


def _forward(way: _Way, vectors: Float2D) -> Float2D:
    return np.asarray(way.factor * np.einsum("mij,mj->mi", way.axes, vectors))


def _named(way: _Way, side: Side) -> Iterator[Difference]:
    where = {"sensor": "force_torque"}
    if way.factor < 0:
        text = "The wrench has the opposite sign: one side records what the robot applies to the environment."
        remedy = "turn the sign of all forces and torques"
        yield Difference("wrench_sign", where, side, 1.0, "1", text, True, remedy, {"factor": -1.0})
    size = abs(way.factor)
    if size != 1.0:
        words = next(text for factor, text in UNITS.items() if max(size, 1 / size) == factor)
        text = f"The forces differ by {words}; the {'simulation' if size > 1 else 'recording'} has the smaller numbers."
        by = size if side == "simulation" else 1 / size
        remedy = f"give forces in N and torques in N·m: multiply them by {by:g}"
        yield Difference("wrench_unit", where, side, size, "1", text, True, remedy, {"factor": by})
    if way.name:
        text = (
            f"The wrench is recorded in other axes: the simulation's are {way.name[3:]}, the recording's are not."
            if way.name.startswith("in ")
            else f"The wrench is recorded in other axes: {way.name} of the simulation."
        )
        remedy = "correct measurements.wrench_axes or frames.force_torque in the cell file"
        if side == "simulation":
            remedy = "give the simulated wrench in the axes of the sensor"
        axes = way.name.removeprefix("x, y, z of the recording are ")
        yield Difference("wrench_frame", where, side, 1.0, "1", text, True, remedy, {"axes": axes})


def _reference(recorded: Float2D, simulated: Float2D, way: _Way, side: Side) -> Iterator[Difference]:
    """Yield what makes the torques differ once the forces agree: the point to which they are reduced, or the unit."""
    factor, arm = _reduced(recorded, _forward(way, simulated[:, 3:]))
    where, length = {"sensor": "force_torque"}, float(np.linalg.norm(arm))
    if factor != 1.0:
        text = "The torques differ by a factor of 1000 (N·mm for N·m), the forces do not."
        by = factor if side == "simulation" else 1 / factor
        remedy = f"give torques in N·m: multiply them by {by:g}"
        yield Difference("wrench_unit", where, side, factor, "1", text, True, remedy, {"factor": by})
    elif length:
        vector = ", ".join(f"{1e3 * x:z.0f}" for x in arm)
        away = f"{1e3 * length:.0f} mm away ({vector} mm in the axes of the wrench)"
        text = f"The wrench is reduced to another point, {away}."
        remedy = "correct measurements.wrench_at or frames.force_torque in the cell file"
        yield Difference("wrench_frame", where, side, length, "m", text, True, remedy)


def _reduced(recorded: Float2D, torque: Float2D) -> tuple[float, Float1D]:
    """Return factor and arm, (3,) m, that take torques to the recorded ones; 1 and zeros where these are the same."""
    force, rest = recorded[:, :3], recorded[:, 3:] - torque
    size = float(np.sqrt(np.mean(force**2)))
    near = TORQUE * max(float(np.sqrt(np.mean(recorded[:, 3:] ** 2))), REMOTE * size)
    before = float(np.sqrt(np.mean(rest**2)))
    if before < near:
        return 1.0, np.zeros(3)
    for factor in (1e3, 1e-3):
        if float(np.sqrt(np.mean((recorded[:, 3:] - factor * torque) ** 2))) < near:
            return factor, np.zeros(3)
    arm = _arm(force, rest)
    left = float(np.sqrt(np.mean((rest - np.cross(arm, force)) ** 2)))
    shown = left < near and farther_off(before, left) == "recording" and np.linalg.norm(arm) > REMOTE
    return 1.0, arm if shown else np.zeros(3)


def _arm(force: Float2D, torque: Float2D) -> Float1D:
    """Return the (3,) m with torque = arm x force, by least squares."""
    x, y, z = force.T
    zero = np.zeros_like(x)
    rows = np.stack([
        np.stack([zero, z, -y], axis=-1), np.stack([-z, zero, x], axis=-1), np.stack([y, -x, zero], axis=-1)
    ], axis=1)  # fmt: skip
    return np.asarray(np.linalg.lstsq(rows.reshape(-1, 3), torque.reshape(-1), rcond=1e-9)[0])
