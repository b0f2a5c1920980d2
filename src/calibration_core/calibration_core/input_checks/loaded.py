"""Wrenches: sign, units, axes, point of reference and order of the joints, judged by how the robot gave way to them."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np

from calibration_core.input_checks.anomaly import InputAnomaly
from calibration_core.input_checks.explained import (
    Fit,
    Motion,
    Reading,
    columns_of,
    fit,
    posture_of,
)
from calibration_core.model.effects.priors import typical
from calibration_core.timeseries import Float1D, Float2D

FAR = 0.3  # what is meant leaves less than this share of the rest that stands
FAR_WHERE_GOOD = 0.1  # the same where the recording as it stands is explained well already
STATED = 0.7  # the same between the ways of reading a wrench that a cell file can state
WELL, GOOD = 0.7, 0.95  # shares of the motion explained
LEAST_EVIDENCE = 30.0  # nats
VISIBLE = 3.0  # times the claimed noise: less motion tells nothing
UNRELATED = 0.2  # share explained: motion far above the noise and less than this explained has no cause in the wrench
MANY = 60  # independent coordinates
UNIT = 100.0  # stiffness this many times from what robots have is a matter of units
BENT = 20.0  # times the claimed noise: loads of which no robot moves less
WEAK = 0.01  # largest force over the rated load's weight, below which a force is in a larger unit
STANDARD_ACCELERATION = 9.80665  # m/s^2
OVERSTATED = 0.3  # times the claimed noise


@dataclasses.dataclass(frozen=True, eq=False)
class Meant:
    """What a recording might mean, how well it does then, and whether a cell file can state it."""

    anomaly: InputAnomaly
    fit: Fit
    stated: bool = False


def check_loaded(motion: Motion, given: Reading, readings: dict[str, Reading], facts: Facts) -> list[InputAnomaly]:
    """Return what is wrong with wrenches or joints; at most one fault, the one that explains by far the most.

    Args:
        motion: The motion under load.
        given: How the cell file says the wrench is to be read.
        readings: The other ways, by what they are called.
        facts: What the cell file tells about sizes.
    """
    if motion.freedom < MANY:
        return []
    if motion.total < motion.freedom * (VISIBLE * motion.sigma) ** 2:
        return _unseen(motion, given, facts)
    at = posture_of(motion)
    stands = fit(motion, columns_of(motion, at, motion.force, motion.torque, given))
    meant = sorted(_alternatives(motion, given, readings), key=lambda one: one.fit.rest)
    if meant and _by_far(motion, stands, meant[0]):
        return [_with_figures(motion, stands, meant[0])]
    if stands.rest > (1.0 - UNRELATED) * motion.total:
        return [_no_relation(motion, stands)]
    return _unit(motion, given, facts) or _overstated(motion, stands)


@dataclasses.dataclass(frozen=True)
class Facts:
    """What a cell file tells about sizes.

    Attributes:
        rated_load: kg.
        stiffness: N*m/rad per joint, where the cell file states it.
        joints: Names.
    """

    rated_load: float
    stiffness: tuple[float, ...] | None
    joints: tuple[str, ...]


def _by_far(motion: Motion, stands: Fit, meant: Meant) -> bool:
    explained, other = 1.0 - stands.rest / motion.total, meant.fit
    share = STATED if meant.stated else FAR_WHERE_GOOD if explained > GOOD else FAR
    floor = motion.freedom * motion.sigma**2  # nothing is explained better than to the noise
    rest, before = max(other.rest, floor), max(stands.rest, floor)
    evidence = 0.5 * motion.freedom * np.log(before / rest)
    return bool(rest < share * before and 1.0 - other.rest / motion.total > WELL and evidence > LEAST_EVIDENCE)


def _alternatives(motion: Motion, given: Reading, readings: dict[str, Reading]) -> Iterator[Meant]:
    at = posture_of(motion)
    force, torque = motion.force, motion.torque
    remedy = "turn the sign of all forces and torques: wanted is the wrench of the environment on the robot"
    anomaly = InputAnomaly("wrench_sign", "all forces and torques have the wrong sign", remedy, 0.0, factor=-1.0)
    yield Meant(anomaly, fit(motion, columns_of(motion, at, -force, -torque, given)))
    for name, reading in readings.items():
        text = f"the wrench is recorded {name}"
        remedy = f"state in the cell file that {text} (measurements.wrench_axes, wrench_at)"
        anomaly = InputAnomaly("wrench_frame", text, remedy, 0.0, axes=name)
        yield Meant(anomaly, fit(motion, columns_of(motion, at, force, torque, reading)), stated=True)
    for turn in quarter_turns():
        axes = _axes(turn)
        remedy = f"turn frames.force_torque, or record the wrench in axes that are {axes} of the recorded ones"
        anomaly = InputAnomaly("wrench_frame", f"the axes of the wrench are {axes} of the recorded ones", remedy, 0.0,
                               axes=axes)  # fmt: skip
        yield Meant(anomaly, fit(motion, columns_of(motion, at, force @ turn.T, torque @ turn.T, given)))
    if np.any(torque):
        for factor, unit in ((1e-3, "N·mm"), (1e3, "kN·m")):
            remedy = f"multiply the torques by {factor:g}: they look like {unit} beside forces of another unit"
            anomaly = InputAnomaly("wrench_unit", "forces and torques have units that do not belong together", remedy,
                                   0.0, factor=factor)  # fmt: skip
            yield Meant(anomaly, fit(motion, columns_of(motion, at, force, factor * torque, given)))
    turned = dataclasses.replace(motion, q=np.radians(motion.q))
    remedy = f"give joint angles in rad: multiply them by {np.pi / 180:.6g}"
    anomaly = InputAnomaly("angle_unit", "the joint angles look like degrees", remedy, 0.0, factor=np.pi / 180)
    yield Meant(anomaly, fit(turned, columns_of(turned, posture_of(turned), force, torque, given)))
    names = motion.chain.joints
    for i, j in itertools.combinations(range(len(names)), 2):
        q = motion.q.copy()
        q[:, [i, j]] = q[:, [j, i]]
        swapped = dataclasses.replace(motion, q=q)
        remedy = f"exchange the angles of {names[i]} and {names[j]}"
        anomaly = InputAnomaly("joint_order", f"the angles of {names[i]} and {names[j]} are exchanged", remedy, 0.0,
                               joints=(names[i], names[j]))  # fmt: skip
        columns = columns_of(swapped, posture_of(swapped), force, torque, given)
        yield Meant(anomaly, fit(swapped, columns))


def quarter_turns() -> list[Float2D]:
    """Return the 23 rotations that take axes to axes, identity left out."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            turn = np.zeros((3, 3))
            turn[range(3), order] = signs
            if np.linalg.det(turn) > 0 and not np.array_equal(turn, np.eye(3)):
                found.append(turn)
    return found


def _axes(turn: Float2D) -> str:
    """Return what the recorded x, y, z should have been, e.g. `y, -x, z`."""
    words = []
    for row in turn:
        k = int(np.argmax(np.abs(row)))
        words.append(("-" if row[k] < 0 else "") + "xyz"[k])
    return ", ".join(words)


def _with_figures(motion: Motion, stands: Fit, meant: Meant) -> InputAnomaly:
    before, after = (100.0 * (1.0 - one.rest / motion.total) for one in (stands, meant.fit))
    text = (
        f"{meant.anomaly.text}: so read, joint springs explain {after:.1f} % of the motion under load, as it stands "
        f"{max(before, 0.0):.1f} %"
    )
    return dataclasses.replace(meant.anomaly, text=text, magnitude=stands.rest / motion.total)


def _no_relation(motion: Motion, stands: Fit) -> InputAnomaly:
    size = float(np.sqrt(motion.total / motion.freedom))
    text = (
        f"the points move by {1e3 * size:.3g} mm (rms per coordinate) between load steps, and no reading of the wrench "
        f"explains it (joint springs: {100 * max(1 - stands.rest / motion.total, 0.0):.0f} %)"
    )
    remedy = "check that recording, cell file and robot belong together, and that wrench and points share one clock"
    return InputAnomaly("no_relation", text, remedy, stands.rest / motion.total)


def _unit(motion: Motion, given: Reading, facts: Facts) -> list[InputAnomaly]:
    """Judge a common factor of forces or of positions: by the rated load, and by how stiff robots of that load are."""
    expected = float(np.linalg.norm(_expected(motion, given, facts)))
    if expected == 0.0:
        return []
    size = float(np.linalg.norm(motion.moved)) / expected
    strength = float(np.linalg.norm(motion.force, axis=1).max()) / (facts.rated_load * STANDARD_ACCELERATION)
    if 1.0 / UNIT < size < UNIT:
        return []
    seen = f"the robot gives way {size:.2g} times as much as {'its stated stiffness' if facts.stiffness else 'robots'} "
    seen += f"{'says' if facts.stiffness else 'of its rated load do'}; the largest force is {100 * strength:.2g} % of "
    seen += "the rated load"
    if size >= UNIT and strength < WEAK:
        remedy = "give forces in N and torques in N·m: multiply them by 1000 (they look like kN and kN·m)"
        return [InputAnomaly("wrench_unit", seen, remedy, size, factor=1000.0)]
    factor = 1e-3 if size >= UNIT else 1e3
    looks = "mm" if size >= UNIT else "km, or millimetres divided twice"
    remedy = f"give positions in m: multiply them by {factor:g} (they look like {looks})"
    return [InputAnomaly("position_unit", seen, remedy, size, factor=factor)]


def _unseen(motion: Motion, given: Reading, facts: Facts) -> list[InputAnomaly]:
    """Judge motion that the noise hides: loads that bend any robot visibly, and no motion, do not belong together."""
    expected = _expected(motion, given, facts)
    if float(np.linalg.norm(expected)) < np.sqrt(motion.freedom) * BENT * motion.sigma:
        return []
    size = float(np.linalg.norm(motion.moved) / np.linalg.norm(expected))
    if size > 1.0 / UNIT:
        return []
    if size > 1e-2 / UNIT:
        return _unit(motion, given, facts)
    text = (
        "the points do not move under loads that would move them by "
        f"{1e3 * float(np.linalg.norm(expected)) / np.sqrt(motion.freedom):.2g} mm (rms per coordinate)"
    )
    remedy = "check that the tracker measured, and that loads and points are of the same run"
    return [InputAnomaly("no_relation", text, remedy, 1.0)]


def _expected(motion: Motion, given: Reading, facts: Facts) -> Float1D:
    """Return the (3 m,) motion that a robot of the stated stiffness, or of the usual one, would show."""
    usual = np.full(len(facts.joints), typical("joint_elasticity", facts.rated_load))
    if facts.stiffness is not None:
        usual = 1.0 / np.array(facts.stiffness)
    return columns_of(motion, posture_of(motion), motion.force, motion.torque, given) @ usual


def _overstated(motion: Motion, stands: Fit) -> list[InputAnomaly]:
    freedom = motion.freedom - len(stands.compliance)
    rms = float(np.sqrt(stands.rest / freedom))
    if rms > OVERSTATED * motion.sigma:
        return []
    text = (
        f"joint springs leave {1e6 * rms:.2g} µm per coordinate of readings that claim {1e6 * motion.sigma:.2g} µm of "
        "noise: these readings are not independent measurements of this, or the claim is too large"
    )
    remedy = "use the readings of the instrument, not computed ones; or state its real standard deviation"
    return [InputAnomaly("noise_overstated", text, remedy, rms, unit="m")]
