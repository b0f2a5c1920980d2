"""Where recording and simulation differ, said without a hypothesis: about which joint, at which load, when.

Three points give the small rigid motion of the tool that the model leaves (its residual twist).  A joint that gives way
in any direction turns the tool about lines through its origin; so the share of the residual that such turns explain
tells how well it could be that joint.  Dependence on load, branch, angles, time and temperature is tested by permuting
whole configurations, and by the largest of all tests at once (Westfall and Young 1993), so that no pattern is read
into noise.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.kinematics import Posture, linear_jacobian, posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import load_of, load_torque
from calibration_core.observations.kinds import levels_of
from calibration_core.policy import CERTAIN
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D, Readings, numbers_in_time

PERMUTATIONS = 400
MOST = 1500  # configurations that are looked at, evenly taken
FEWEST = 6  # configurations
UNLOADED = 0.02
AS_WELL = 0.03  # share by which a joint may explain less than the best and still be said to do as well
MAIN, MAIN_TILT = 0.5, 0.75  # shares that make a pattern the main one; turns about any axis explain a third of noise
STAYS = 0.25  # share of the full load's residual that stays without load, beyond which no law of the load is read


@dataclasses.dataclass(frozen=True)
class JointShare:
    """How well turns about one joint explain the residual.

    Attributes:
        any_axis: Share of the residual's squares explained by turns about any line through the joint's origin.
        own_axis: The same about its own axis alone.
    """

    joint: str
    any_axis: float
    own_axis: float


@dataclasses.dataclass(frozen=True)
class Dependence:
    """A quantity that the residual might follow.

    Attributes:
        on: What it is.
        share: Share of the residual's squares that is proportional to it.
        chance: Of such a share, or a larger one of any other quantity, among permuted configurations.
    """

    on: str
    share: float
    chance: float


@dataclasses.dataclass(frozen=True)
class Level:
    """The residual at one step: share of the full load, and rms per coordinate of its part along the full load's, m."""

    step: int
    level: float
    along: float


@dataclasses.dataclass(frozen=True, eq=False)
class Located:
    """What can be said without a hypothesis.

    Attributes:
        rms: Of the residual that was looked at, m per coordinate.
        turn, shift: rms of the tool's residual rotation, rad, and translation at the middle of its points, m; NaN with
            fewer than three points.
        shares: Per joint, the best first; empty with fewer than three points.
        dependences: The largest share first.
        levels: In the order of steps; empty without load steps.
        memory: m, rms of the difference between unloading and loading at the same load; NaN where no load recurs.
        memory_chance: Of so much if signs of whole configurations are drawn by lot.
        sentences: All of it in words.
    """

    rms: float
    turn: float
    shift: float
    shares: tuple[JointShare, ...]
    dependences: tuple[Dependence, ...]
    levels: tuple[Level, ...]
    memory: float
    memory_chance: float
    sentences: tuple[str, ...]

    @property
    def strongest(self) -> str:
        """The strongest pattern in one sentence; empty where none is more than chance."""
        found = [
            (one.share, f"follows {one.on}") for one in self.dependences if one.chance < CERTAIN and one.share > MAIN
        ]
        own = max(self.shares, key=lambda one: one.own_axis, default=None)
        if own is not None and own.own_axis > MAIN:
            found.append((own.own_axis, f"is a turn about the axis of {own.joint}"))
        alike = [one for one in self.shares if one.any_axis > self.shares[0].any_axis - AS_WELL]
        if not found and len(alike) == 1 and alike[0].any_axis > MAIN_TILT:
            found.append((alike[0].any_axis, f"is a tilt at {alike[0].joint}, not about its axis alone"))
        if not found:
            return ""
        share, words = max(found)
        return f"Where: {100 * share:.0f} % of the difference {words}."


def locate(readings: Readings, residual: Float2D, cell: Cell, model: ModelParameters) -> Located | None:
    """Locate what a model leaves.

    Args:
        readings: The m readings.
        residual: (m, 3) m, base axes; of loaded recordings without the offsets of configurations.
        cell: The cell file.
        model: The null model, for geometry, points and frames.

    Returns:
        None where there are too few configurations for any pattern.
    """
    numbers = numbers_in_time(readings.configuration)
    if len(numbers) < FEWEST:
        return None
    if len(numbers) > MOST:
        kept = numbers[np.linspace(0, len(numbers) - 1, MOST).astype(int)]
        rows = np.isin(readings.configuration, kept)
        readings, residual = readings.select(rows), residual[rows]
    chain = chain_of(cell).corrected(model.geometry)
    table = _table(readings, residual)
    if table is None:
        return None
    points = np.stack([model.points[readings.points[k]] for k in table.points])
    at = posture(chain, table.q)
    place = np.stack([at.point(point).T for point in points], axis=1)  # (k, p, 3)
    levels: tuple[Level, ...] = ()
    peak = table.first
    memory, chance = float("nan"), float("nan")
    if table.loaded:
        share = levels_of(readings.select(table.rows))
        if len(share) == table.whole.shape[1]:
            peak, levels = _along(table.whole, share)
            memory, chance = _memory(table.whole, share)
        else:
            peak = table.whole[np.arange(len(table.whole)), np.argmax((table.whole**2).sum(axis=(2, 3)), axis=1)]
    shares, turn, shift = _shares(at, place, peak, chain.joints)
    torque = None
    if table.loaded:
        torque = load_torque(
            posture(chain, readings.q[table.peaks]), load_of(readings.select(table.peaks), cell, model)
        )
    dependences = _dependences(peak, at, table, torque, chain.joints)
    rms = float(np.sqrt(np.mean(peak**2)))
    found = Located(rms, turn, shift, shares, dependences, levels, memory, chance, ())
    return dataclasses.replace(found, sentences=_sentences(found, place.shape[1], table.loaded))


@dataclasses.dataclass(frozen=True, eq=False)
class _Table:
    """Residuals by configuration.

    Attributes:
        rows: Readings of it, in their order.
        points: Indices of the points.
        whole: (k, s, p, 3) m, since the first step.
        first: (k, p, 3) m, at the first step (absolute recordings).
        q: (k, n) rad.
        time: (k,) s, or the order where unknown.
        temperature: (k,) degrees Celsius, NaN where unknown.
        peaks: (k,) rows of the readings at the largest load.
        loaded: Whether there are load steps.
    """

    rows: Int1D
    points: Int1D
    whole: Float3D
    first: Float3D
    q: Float2D
    time: Float1D
    temperature: Float1D
    peaks: Int1D
    loaded: bool


def _table(readings: Readings, residual: Float2D) -> _Table | None:
    """Arrange residuals of the configurations with the steps that most have, of all points; None if there are too few.

    A reference that is measured again and again has other steps.
    """
    numbers, index = np.unique(readings.configuration, return_inverse=True)
    steps, points = np.unique(readings.step), np.unique(readings.point)
    place = np.full((len(numbers), len(steps), len(points)), -1)
    place[index.reshape(-1), np.searchsorted(steps, readings.step), np.searchsorted(points, readings.point)] = (
        np.arange(len(readings))
    )
    has = (place >= 0).all(axis=2)
    patterns, counts = np.unique(has, axis=0, return_counts=True)
    common = patterns[np.argmax(counts)]
    place = place[(has == common).all(axis=1)][:, common]
    if len(place) < FEWEST or not common.any():
        return None
    values = residual[place]
    q = readings.q[place[:, 0, 0]]
    time = readings.time[place[:, 0, 0]]
    peaks = place[:, 0, 0]
    if readings.wrench is not None:
        force = np.linalg.norm(readings.wrench[place[:, :, 0], :3], axis=2)
        peaks = place[np.arange(len(place)), np.argmax(force, axis=1), 0]
    return _Table(
        rows=np.sort(place, axis=None),
        points=points,
        whole=values - values[:, :1],
        first=values[:, 0],
        q=q,
        time=time if np.isfinite(time).all() else np.arange(len(place), dtype=np.float64),
        temperature=readings.temperature[place[:, 0, 0]],
        peaks=peaks,
        loaded=readings.wrench is not None and int(common.sum()) > 1,
    )


def _along(whole: Float3D, share: tuple[float, ...]) -> tuple[Float3D, tuple[Level, ...]]:
    """Return the residual at the first full load, (k, p, 3), and the residual of every step along it."""
    full = int(np.argmax(share))
    peak = whole[:, full]
    power = float((peak**2).sum())
    size = float(np.sqrt(np.mean(peak**2)))
    along = [float((whole[:, s] * peak).sum()) / max(power, 1e-30) * size for s in range(len(share))]
    return peak, tuple(Level(s, level, value) for s, (level, value) in enumerate(zip(share, along, strict=True)))


def _memory(whole: Float3D, share: tuple[float, ...]) -> tuple[float, float]:
    """Compare steps of equal load before and after the full one; permute signs of whole configurations."""
    full = int(np.argmax(share))
    pairs = [
        (a, b)
        for a in range(1, full)
        for b in range(full + 1, len(share))
        if abs(share[a] - share[b]) < UNLOADED and share[a] > UNLOADED
    ]
    if not pairs:
        return float("nan"), float("nan")
    different = np.mean([whole[:, b] - whole[:, a] for a, b in pairs], axis=0)
    direction = whole[:, full]
    seen = np.einsum("kpa,kpa->k", different, direction)
    rng = np.random.default_rng(0)
    signs = rng.choice([-1.0, 1.0], (PERMUTATIONS, len(seen)))
    chance = float((1 + np.sum(np.abs(signs @ seen) >= abs(seen.sum()))) / (1 + PERMUTATIONS))
    return float(np.sqrt(np.mean(different**2))), chance


def _shares(
    at: Posture, place: Float3D, peak: Float3D, joints: tuple[str, ...]
) -> tuple[tuple[JointShare, ...], float, float]:
    """Explain each configuration's residual by turns about every joint; return the tool's turn and shift as well."""
    k, p, _ = place.shape
    if p < 3:
        return (), float("nan"), float("nan")
    flat = peak.reshape(k, -1)
    total = float((flat**2).sum())
    if total == 0.0:
        return (), 0.0, 0.0
    shares = []
    for joint, name in enumerate(joints):
        lever = place - at.origin[joint].T[:, None]
        about = np.stack([np.cross(np.eye(3)[a], lever) for a in range(3)], axis=-1).reshape(k, 3 * p, 3)
        own = np.cross(at.axis(joint).T[:, None], lever)
        if at.whole is not None:  # what mimics the joint moves with it
            own = np.stack([linear_jacobian(at, place[:, i].T)[joint].T for i in range(p)], axis=1)
        axis = own.reshape(k, 3 * p, 1)
        shares.append(JointShare(name, _explained(about, flat) / total, _explained(axis, flat) / total))
    middle = place.mean(axis=1, keepdims=True)
    turns = np.stack([np.cross(np.eye(3)[a], place - middle) for a in range(3)], axis=-1).reshape(k, 3 * p, 3)
    moves = np.broadcast_to(np.tile(np.eye(3), (p, 1)), (k, 3 * p, 3))
    twist = np.einsum("kij,kj->ki", np.linalg.pinv(np.concatenate([turns, moves], axis=2)), flat)
    size = np.sqrt(np.mean((twist**2).reshape(k, 2, 3).sum(axis=2), axis=0))
    return tuple(sorted(shares, key=lambda share: -share.any_axis)), float(size[0]), float(size[1])


def _explained(columns: Float3D, values: Float2D) -> float:
    coefficients = np.einsum("kji,ki->kj", np.linalg.pinv(columns), values)
    return float((np.einsum("kij,kj->ki", columns, coefficients) ** 2).sum())


def _dependences(
    peak: Float3D, at: Posture, table: _Table, torque: Float2D | None, joints: tuple[str, ...]
) -> tuple[Dependence, ...]:
    """Correlate the residual, in base and in flange axes, with everything that changes between configurations."""
    names, columns = ["the time"], [table.time]
    if np.isfinite(table.temperature).all() and np.ptp(table.temperature) > 0.2:
        names.append("the temperature")
        columns.append(table.temperature)
    for joint, name in enumerate(joints):
        for word, function in (("cosine", np.cos), ("sine", np.sin)):
            names.append(f"the {word} of {name}")
            columns.append(function(table.q[:, joint]))
        if torque is not None:
            names.append(f"the load's torque on {name}")
            columns.append(torque[joint])
    wide = np.stack(columns)
    wide = wide - wide.mean(axis=1, keepdims=True)
    length = np.linalg.norm(wide, axis=1)
    varies = length > 1e-9 * max(float(length.max()), 1e-30)
    wide, names = (
        wide[varies] / length[varies][:, None],
        [name for name, good in zip(names, varies, strict=True) if good],
    )
    flange = np.einsum("akm,mpk->mpa", at.flange, peak)
    sets = [values.reshape(len(peak), -1) for values in (peak, flange)]
    sets = [values - values.mean(axis=0) for values in sets]
    power = max(float((peak**2).sum()), 1e-30)
    seen = np.max([((wide @ values) ** 2).sum(axis=1) for values in sets], axis=0) / power
    rng = np.random.default_rng(0)
    largest = np.empty(PERMUTATIONS)
    for draw in range(PERMUTATIONS):
        order = rng.permutation(len(peak))
        largest[draw] = max(float(((wide @ values[order]) ** 2).sum(axis=1).max()) for values in sets) / power
    chance = (1 + (largest[:, None] >= seen).sum(axis=0)) / (1 + PERMUTATIONS)
    found = [Dependence(name, float(s), float(c)) for name, s, c in zip(names, seen, chance, strict=True)]
    return tuple(sorted(found, key=lambda dependence: -dependence.share))


def _sentences(found: Located, points: int, loaded: bool) -> tuple[str, ...]:
    when = "under the full load" if loaded else "at rest"
    lines = [f"What the model leaves {when} is {1e6 * found.rms:.0f} µm rms a coordinate."]
    if found.shares:
        lines[0] = lines[0][:-1] + (
            f"; as a rigid motion of the tool, {1e6 * found.turn:.0f} µrad and {1e6 * found.shift:.0f} µm of shift."
        )
        lines.append(_about_joints(found.shares, points))
    if len(found.levels) > 2:
        lines.append(_proportional(found.levels))
    if np.isfinite(found.memory):
        certain = found.memory_chance < CERTAIN
        lines.append(
            f"At the same load, unloading and loading differ by {1e6 * found.memory:.0f} µm rms"
            + (
                f": the robot remembers (chance {found.memory_chance:.3f})."
                if certain
                else f", no more than by chance ({found.memory_chance:.2f})."
            )
        )
    follows = [d for d in found.dependences if d.chance < CERTAIN][:4]
    if follows:
        listed = "; ".join(f"{d.on} ({100 * d.share:.0f} % of it, chance {d.chance:.3f})" for d in follows)
        lines.append(f"From configuration to configuration it follows {listed}.")
    else:
        lines.append("From configuration to configuration it follows no angle, torque, time or temperature by itself.")
    return tuple(lines)


def _about_joints(shares: tuple[JointShare, ...], points: int) -> str:
    """Say about which joints the tool turns; three turns explain a third of the noise of three points by chance."""
    best, chance = shares[0], 1.0 / points
    if best.any_axis < 0.5 * (1.0 + chance):
        return (
            f"It meets the lines of no joint: turns about {best.joint} explain {100 * best.any_axis:z.0f} % of it, and "
            f"would explain {100 * chance:.0f} % of noise."
        )
    as_well = [share for share in shares if share.any_axis >= best.any_axis - AS_WELL]
    named = " or ".join(f"{share.joint} ({100 * share.any_axis:z.0f} %)" for share in as_well)
    others = [share for share in shares if share not in as_well][:3]
    text = f"Turns about lines through {named} explain most of it"
    if others:
        text += f"; through {', '.join(f'{share.joint} {100 * share.any_axis:z.0f} %' for share in others)}"
    own = max(shares, key=lambda share: share.own_axis)
    return f"{text}. About a joint's own axis alone {own.joint} explains most, {100 * own.own_axis:z.0f} %."


def _proportional(levels: tuple[Level, ...]) -> str:
    """Say how the residual grows with the load, from the loading branch."""
    full = max(range(len(levels)), key=lambda k: levels[k].level)
    part = [level for level in levels[1:full] if level.level > UNLOADED]
    size = levels[full].along
    listed = ", ".join(f"{100 * level.level:.0f} %: {1e6 * level.along:.0f} µm" for level in (*part, levels[full]))
    plain = f"Along the residual of the full load it is, by load: {listed}"
    if not part or size <= 0:
        return f"{plain}."
    back = [level for level in levels[full + 1 :] if level.level <= UNLOADED]
    if not back:
        return f"{plain}; without a step after unloading no law of the load is read from it."
    if abs(back[-1].along) > STAYS * size:
        stays = f"{1e6 * back[-1].along:.0f} µm stay when the load is gone"
        return f"{plain}; {stays}: noise or memory, and no law of the load is read from it."
    ratio = float(np.mean([level.along / (size * level.level) for level in part]))
    word = "in proportion to the load" if abs(ratio - 1) < 0.15 else (
        "faster at small loads than at large ones" if ratio > 1 else "slower at small loads than at large ones"
    )  # fmt: skip
    return f"It grows {word} ({listed})."
