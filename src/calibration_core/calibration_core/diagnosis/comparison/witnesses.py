"""What both recordings say of the same thing: wrench, joint angles, temperature, time; and which of the two is wrong.

The measured positions judge: the whole model, what was found missing in it included, is fitted to them once with what
the recording says and once with what the simulation says.  Whichever predicts configurations left out worse, and not by
chance, is the witness that is wrong.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.result import ComparedChannel, Side, Witness
from calibration_core.diagnosis.comparison.wrench import gain_of, turn_between
from calibration_core.model.simulation.simulate import wrench_sigma
from calibration_core.policy import BEYOND, CERTAIN
from calibration_core.timeseries import Bool1D, Float2D, Int1D, Readings

WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
HALVED = 0.5  # of the difference, that a turn, gains or a limit may leave to be named
AT_LIMIT = 0.01  # of the largest reading: readings so near to it stand at it
FEWEST = 6  # readings at the limit
ANGLE = 1e-4  # rad: servo and encoder leave less
WARMER, LATER = 2.0, 0.02  # K; of the duration


def witnesses(ours: Readings, theirs: Readings, cell: Cell, *, known: bool) -> Iterator[Witness]:
    """Yield what the two say differently of the same measurement; no positions have judged it yet.

    Args:
        ours: Rows of the recording.
        theirs: The corresponding rows of the simulation.
        cell: The cell file.
        known: Whether units, signs, axes or orders differ: then only these are said.
    """
    if known:
        return
    if ours.wrench is not None and theirs.wrench is not None:
        yield from _wrench(ours.wrench, theirs.wrench, cell)
    apart = np.sqrt(np.mean((ours.q - theirs.q) ** 2, axis=0))
    if apart.max() > ANGLE:
        named = tuple(ComparedChannel(joint, gain_of(a, b), float(c), "rad") for joint, a, b, c in
                      zip(cell.robot.joints, ours.q.T, theirs.q.T, apart, strict=True))  # fmt: skip
        most = max(named, key=lambda one: one.rms)
        yield _stated("joint angles", named, f"those of {most.name} differ by {1e3 * most.rms:.2f} mrad")
    yield from _conditions(ours, theirs)


def _wrench(recorded: Float2D, simulated: Float2D, cell: Cell) -> Iterator[Witness]:
    apart = np.sqrt(np.mean((recorded - simulated) ** 2, axis=0))
    different = apart > BEYOND * wrench_sigma(cell)
    if not different.any() or not simulated.any():
        return
    named = tuple(
        ComparedChannel(name, gain_of(recorded[:, k], simulated[:, k]), float(apart[k]), "N" if k < 3 else "N*m")
        for k, name in enumerate(WRENCH)
    )
    yield _stated("wrench", named, _how(recorded, simulated, different))


def _how(recorded: Float2D, simulated: Float2D, different: Bool1D) -> str:
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


def _stated(what: str, channels: tuple[ComparedChannel, ...], how: str) -> Witness:
    return Witness(what, "either", channels, None, f"{what}: {how}.")


def judged(stated: Witness, ours: Float2D, theirs: Float2D, configuration: Int1D) -> Witness:
    """Let the measured positions say which of the two is wrong.

    They stand a share of the way from what the recording makes of them to what the simulation does: 0 or 1 where one is
    right.  Student's test, whole configurations drawn one by one, says whether the share is on one side of a half; its
    spread is that of clusters (Liang and Zeger 1986).

    Args:
        stated: What the two say.
        ours: (m, 3) m, that the model leaves of configurations left out, with what the recording says.
        theirs: The same with what the simulation says.
        configuration: (m,)
    """
    from scipy.special import stdtr  # slow to load, and a recording by itself does not need it

    numbers, group = np.unique(configuration, return_inverse=True)
    way = ours - theirs
    along, whole = (np.bincount(group.reshape(-1), np.sum(way * part, axis=1)) for part in (ours, way))
    share, others, chance = 0.5, len(numbers) - 1, 1.0
    if others and whole.any():
        share = float(along.sum() / whole.sum())
        spread = math.sqrt(len(numbers) / others * float(np.sum((along - share * whole) ** 2)))
        chance = 2 * stdtr(others, -abs(share - 0.5) * float(whole.sum()) / max(spread, 1e-30))
    side: Side = "either" if chance > CERTAIN else "recording" if share > 0.5 else "simulation"
    left = tuple(float(np.sqrt(np.mean(part**2))) for part in (ours, theirs))
    verdict = "which is wrong stays open" if side == "either" else f"that of the {side} is wrong"
    figures = f"{1e6 * left[0]:.0f} µm with the recorded, {1e6 * left[1]:.0f} µm with the simulated"
    text = f"{stated.text[:-1]}; configurations left out are left with {figures}: {verdict}."
    return dataclasses.replace(stated, wrong=side, left=(left[0], left[1]), text=text)


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
