"""What both recordings say of the same thing: wrench, joint angles, temperature, time; and which of the two is wrong.

The measured positions judge: the model is fitted to them once with what the recording says and once with what the
simulation says, and whichever leaves clearly more is the witness that is wrong.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.model import refitted, rigid_misfit
from calibration_core.diagnosis.comparison.result import ComparedChannel, Side, Witness
from calibration_core.diagnosis.comparison.wrench import gain_of, turn_between
from calibration_core.model.simulation.simulate import wrench_sigma
from calibration_core.timeseries import Float2D, Readings

WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
BEYOND = 4.0  # standard deviations of the sensor: nearer to each other, two wrenches are the same
LEAST = 0.005  # of the largest force or torque: the same
CLEARLY = 1.04  # times what the other leaves: a turn of the sensor by 3.6 degrees leaves 110 beside 97 µm
HALVED = 0.5  # of the difference, that a turn, gains or a limit may leave to be named
AT_LIMIT = 0.01  # of the largest reading: readings so near to it stand at it
FEWEST = 6  # readings at the limit
ANGLE = 1e-4  # rad: servo and encoder leave less
WARMER, LATER = 2.0, 0.02  # K; of the duration


def witnesses(ours: Readings, theirs: Readings, cell: Cell, *, known: bool) -> Iterator[Witness]:
    """Yield what the two say differently of the same measurement.

    Args:
        ours: Rows of the recording.
        theirs: The corresponding rows of the simulation.
        cell: The cell file.
        known: Whether units, signs, axes or orders differ: then only these are said.
    """
    if known:
        return
    if ours.wrench is not None and theirs.wrench is not None:
        yield from _wrench(ours, ours.wrench, theirs.wrench, cell)
    apart = np.sqrt(np.mean((ours.q - theirs.q) ** 2, axis=0))
    if apart.max() > ANGLE:
        named = tuple(ComparedChannel(joint, gain_of(a, b), float(c), "rad") for joint, a, b, c in
                      zip(cell.robot.joints, ours.q.T, theirs.q.T, apart, strict=True))  # fmt: skip
        left = None
        if cell.measurements.points == "absolute":
            left = tuple(rigid_misfit(dataclasses.replace(ours, q=q), cell) for q in (ours.q, theirs.q))
        most = max(named, key=lambda one: one.rms)
        yield _judged("joint angles", named, f"those of {most.name} differ by {1e3 * most.rms:.2f} mrad", left)
    yield from _conditions(ours, theirs)


def _wrench(ours: Readings, recorded: Float2D, simulated: Float2D, cell: Cell) -> Iterator[Witness]:
    size = np.repeat([np.abs(part).max(initial=0.0) for part in (simulated[:, :3], simulated[:, 3:])], 3)
    apart = np.sqrt(np.mean((recorded - simulated) ** 2, axis=0))
    different = apart > np.maximum(BEYOND * wrench_sigma(cell), LEAST * size)
    if not different.any() or not size.any():
        return
    named = tuple(
        ComparedChannel(name, gain_of(recorded[:, k], simulated[:, k]), float(apart[k]), "N" if k < 3 else "N*m")
        for k, name in enumerate(WRENCH)
    )
    left = tuple(refitted(dataclasses.replace(ours, wrench=wrench), cell) for wrench in (recorded, simulated))
    yield _judged("wrench", named, _how(recorded, simulated, different), left)


def _how(recorded: Float2D, simulated: Float2D, different: np.ndarray) -> str:
    """Say how the recorded wrench differs from the simulated one: a limit, a turn or gains; else on which axes."""
    force, other = recorded[:, :3], simulated[:, :3]
    before = float(np.sum((recorded - simulated) ** 2))
    most = np.abs(recorded).max(axis=0)
    limits = [
        k
        for k in np.flatnonzero(different)
        if np.sum((np.abs(recorded[:, k]) > (1 - AT_LIMIT) * most[k]) & (np.abs(simulated[:, k]) > most[k])) >= FEWEST
    ]
    clipped = np.clip(simulated, -most, most)
    if limits and np.sum((recorded - clipped)[:, limits] ** 2) < HALVED * np.sum(
        (recorded - simulated)[:, limits] ** 2
    ):
        return f"{', '.join(f'{WRENCH[k]} stops at {most[k]:.0f}' for k in limits)} and goes on in the other"
    turn = turn_between(force, other)
    rest = sum(float(np.sum((recorded[:, k] - simulated[:, k] @ turn.T) ** 2)) for k in (slice(0, 3), slice(3, 6)))
    gains = np.array([gain_of(recorded[:, k], simulated[:, k]) for k in range(6)])
    scaled = float(np.sum((recorded - simulated * gains) ** 2))
    if min(rest, scaled) > HALVED**2 * before:
        return f"they differ on {', '.join(WRENCH[k] for k in np.flatnonzero(different))}"
    if rest < scaled:
        angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
        return f"the recorded one is turned by {angle:.1f} degrees"
    listed = ", ".join(f"{WRENCH[k]} {100 * (gains[k] - 1):+.1f} %" for k in np.flatnonzero(different))
    return f"the recorded one is larger or smaller: {listed}"


def _judged(what: str, named: Sequence[ComparedChannel], how: str, left: Sequence[float] | None) -> Witness:
    side: Side = "either"
    if left is None or not np.isfinite(left).all():
        return Witness(what, side, tuple(named), None, f"{what}: {how}.")
    ours, theirs = left
    if ours > CLEARLY * theirs:
        side = "recording"
    elif theirs > CLEARLY * ours:
        side = "simulation"
    verdict = "which is wrong stays open" if side == "either" else f"that of the {side} is wrong"
    figures = f"fitted, {1e6 * ours:.0f} µm are left with the recorded, {1e6 * theirs:.0f} µm with the simulated"
    return Witness(what, side, tuple(named), (ours, theirs), f"{what}: {how}; {figures}: {verdict}.")


def _conditions(ours: Readings, theirs: Readings) -> Iterator[Witness]:
    warmer = ours.temperature - theirs.temperature
    if np.isfinite(warmer).any():
        size = float(np.sqrt(np.nanmean(warmer**2)))
        if size > WARMER:
            channel = ComparedChannel("temperature", float("nan"), size, "K")
            text = f"temperature: recorded and simulated differ by {size:.1f} K."
            yield Witness("temperature", "either", (channel,), None, text)
    later = (
        (ours.time - np.nanmin(ours.time)) - (theirs.time - np.nanmin(theirs.time)) if _timed(ours, theirs) else None
    )
    if later is not None:
        size, whole = float(np.sqrt(np.mean(later**2))), float(np.ptp(ours.time))
        if size > LATER * whole:
            text = f"time: the readings stand {size:.0f} s apart in {whole:.0f} s; creep and drift are other ones."
            yield Witness("time", "either", (ComparedChannel("time", float("nan"), size, "s"),), None, text)


def _timed(ours: Readings, theirs: Readings) -> bool:
    return bool(np.isfinite(ours.time).all() and np.isfinite(theirs.time).all() and len(ours))
