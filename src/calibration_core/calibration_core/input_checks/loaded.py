"""Wrenches: sign, units, axes, point of reference and order of the joints, judged by how the robot gave way to them."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator

import numpy as np

from calibration_core.input_checks.anomaly import (
    SEEN_BY_PRIOR,
    VISIBLE,
    CellSizes,
    InputAnomaly,
    apart,
    expected_motion,
    torques_apart,
    unit_anomaly,
)
from calibration_core.input_checks.explained import (
    Explanation,
    Motion,
    Reading,
    centred,
    columns_of,
    fit,
    posture_of,
    without_wild,
)
from calibration_core.input_checks.placed import best_zero, other_points
from calibration_core.input_checks.wrench_axes import LEAST_TURN, other_axes, turned_axes
from calibration_core.model.effects.joint_law.hysteresis import stop
from calibration_core.model.kinematics import cross, dot, linear_jacobian
from calibration_core.model.statics import Load, load_torque
from calibration_core.timeseries import Float1D, Float2D

FAR = 0.5  # what is meant leaves less than this share of the rest that stands
STATED = 0.95  # the same between the ways of reading a wrench that a cell file can state
NO_BETTER = 1.05  # of the least rest: readings of the wrench that do equally well
WELL = 0.7  # share of the motion explained
OTHER_ROBOT = 0.8  # share of what is no noise that springs, friction and bearings explain of the robot in the file
LEAST_EVIDENCE = 30.0  # nats
ZERO_FAR, ZERO_LEAST = 0.8, 0.025  # the same for the zero of a joint, and rad: less is no more than physics may mimic
TURNED_FAR = 0.1  # the same for other axes of displacements that are explained well as they stand
UNRELATED = 0.2  # share explained: motion far above the noise and less than this explained has no cause in the wrench
MANY = 60  # independent coordinates
BENT = 20.0  # times the claimed noise: loads of which no robot moves less
BENT_STATED = 5.0  # the same where the cell file states the stiffness
STANDARD_ACCELERATION = 9.80665  # m/s^2
OVERSTATED = 0.3  # times the claimed noise
COMPUTED = 1e-3  # times it: less than the last digit that an instrument shows


@dataclasses.dataclass(frozen=True, eq=False)
class Meant:
    """What a recording might mean, how well it does then, and whether a cell file can state it."""

    anomaly: InputAnomaly
    fit: Explanation
    stated: bool = False


def check_loaded(motion: Motion, given: Reading, readings: dict[str, Reading], facts: CellSizes) -> list[InputAnomaly]:
    """Return what is wrong with wrenches or joints; at most one fault, the one that explains by far the most."""
    if motion.freedom < MANY:
        return []
    if motion.total < motion.freedom * (VISIBLE * motion.sigma) ** 2:
        unseen = _unseen(motion, given, facts) or ([_claimed(motion)] if facts.base_claimed else [])
        return unseen or _overstated(motion, _as_it_stands(motion, given))
    stands, meant = _readings_of(motion, given, readings, facts)
    best = min([stands, *(one.fit for one in meant)], key=lambda one: one.rest)
    sound = without_wild(motion, best)
    if len(sound.group) < len(motion.group):
        motion = sound
        stands, meant = _readings_of(motion, given, readings, facts)
    chosen = _chosen(motion, stands, meant)
    if chosen is not None:
        return [_with_figures(motion, stands, chosen)]
    claimed = [one for one in meant if one.stated and one.anomaly.axes.startswith("in base axes")]
    for one in claimed if facts.base_claimed else []:
        if not _evident(motion, one.fit.rest, stands.rest, STATED):
            return [_with_figures(motion, stands, one)]
    if not facts.positions and (found := _of_displacements(motion, stands, given, facts)):
        return found
    if 1.0 - stands.rest / motion.total < UNRELATED:
        return [_no_relation(motion, stands)]
    if _share(motion, stands) < OTHER_ROBOT:
        physics = fit_with_physics(motion, given)
        if _share(motion, physics) < OTHER_ROBOT:
            return [_other_robot(motion, physics)]
    return _unit(motion, given, facts) or _overstated(motion, stands)


def _share(motion: Motion, explanation: Explanation) -> float:
    """Return the share of the motion, noise taken off, that is explained; 1 where there is nothing but noise."""
    return 1.0 - max(explanation.rest - motion.noise, 0.0) / max(motion.total - motion.noise, 1e-300)


def _claimed(motion: Motion) -> InputAnomaly:
    size = float(np.sqrt(motion.total / motion.freedom))
    text = (
        "the messages say that the wrench is in base axes, the cell file says sensor axes, and the points move too "
        f"little to tell ({1e6 * size:.2g} µm rms per coordinate)"
    )
    remedy = "state in measurements.wrench_axes what holds, and correct the frame_id of the messages"
    return InputAnomaly("wrench_frame", text, remedy, size, unit="m", axes="in base axes")


def _readings_of(
    motion: Motion, given: Reading, readings: dict[str, Reading], facts: CellSizes
) -> tuple[Explanation, list[Meant]]:
    """Fit the recording as it stands and everything that it might mean."""
    stands = _as_it_stands(motion, given)
    noise = motion.freedom * motion.sigma**2
    if noise >= STATED * stands.rest and not facts.base_claimed:  # it stays whatever is meant: nothing is evident
        return stands, []
    return stands, list(_alternatives(motion, given, readings, facts, stands.rest))


def _as_it_stands(motion: Motion, given: Reading) -> Explanation:
    return fit(motion, columns_of(motion, posture_of(motion), motion.force, motion.torque, given))


def _chosen(motion: Motion, stands: Explanation, meant: list[Meant]) -> Meant | None:
    """Return what explains by far the most; what a cell file can state goes before what does no better."""
    by_far = [one for one in meant if _by_far(motion, stands, one)]
    if not by_far:
        return None
    least = min(one.fit.rest for one in by_far)
    level = max(NO_BETTER * least, motion.freedom * motion.sigma**2)
    return min((one for one in by_far if one.fit.rest <= level), key=lambda one: (not one.stated, one.fit.rest))


def _by_far(motion: Motion, stands: Explanation, meant: Meant) -> bool:
    share = STATED if meant.stated else FAR
    count = motion.independent
    return 1.0 - meant.fit.rest / motion.total > WELL and _evident(motion, stands.rest, meant.fit.rest, share, count)


def _evident(motion: Motion, before: float, after: float, share: float, independent: float | None = None) -> bool:
    """Say whether a reading leaves less than a share, and is far more probable; noise stays whatever is meant.

    Args:
        motion: The motion under load.
        before: Sum of squares that stays as the recording stands, m^2.
        after: The same with what it might mean.
        share: Of the first that the second must stay below.
        independent: Number of independent coordinates; None: all, as with a rest that is noise.
    """
    floor = motion.freedom * motion.sigma**2
    rest, stands = max(after, floor), max(before, floor)
    count = motion.freedom if independent is None else independent
    return bool(rest < share * stands and 0.5 * count * np.log(stands / rest) > LEAST_EVIDENCE)


def _alternatives(
    motion: Motion, given: Reading, readings: dict[str, Reading], facts: CellSizes, limit: float
) -> Iterator[Meant]:
    """Yield what the recording might mean; what explains no more than it does as it stands is not fitted in full."""
    at = posture_of(motion)
    force, torque = motion.force, motion.torque
    remedy = "turn the sign of all forces and torques: wanted is the wrench of the environment on the robot"
    anomaly = InputAnomaly("wrench_sign", "all forces and torques have the wrong sign", remedy, 0.0, factor=-1.0)
    yield Meant(anomaly, fit(motion, columns_of(motion, at, -force, -torque, given), limit))
    for name, reading in readings.items():
        text = f"the wrench is recorded {name}"
        remedy = f"state in the cell file that {text} (measurements.wrench_axes, wrench_at)"
        anomaly = InputAnomaly("wrench_frame", text, remedy, 0.0, axes=name)
        columns = columns_of(motion, at, force, torque, reading)
        yield Meant(anomaly, fit(motion, columns, math.inf if facts.base_claimed else limit), stated=True)
    for anomaly, forces, torques in other_axes(motion, at, given, limit):
        yield Meant(anomaly, fit(motion, columns_of(motion, at, forces, torques, given), limit))
    if np.any(torque):
        for factor in apart():
            anomaly = torques_apart(motion, given, facts, factor)
            yield Meant(anomaly, fit(motion, columns_of(motion, at, force, factor * torque, given), limit))
    turned = dataclasses.replace(motion, q=np.radians(motion.q))
    remedy = f"give joint angles in rad: multiply them by {np.pi / 180:.6g}"
    anomaly = InputAnomaly("angle_unit", "the joint angles look like degrees", remedy, 0.0, factor=np.pi / 180)
    yield Meant(anomaly, fit(turned, columns_of(turned, posture_of(turned), force, torque, given), limit))
    names = motion.chain.joints
    for i, j in itertools.combinations(range(len(names)), 2):
        q = motion.q.copy()
        q[:, [i, j]] = q[:, [j, i]]
        swapped = dataclasses.replace(motion, q=q)
        remedy = f"exchange the angles of {names[i]} and {names[j]}"
        anomaly = InputAnomaly("joint_order", f"the angles of {names[i]} and {names[j]} are exchanged", remedy, 0.0,
                               joints=(names[i], names[j]))  # fmt: skip
        columns = columns_of(swapped, posture_of(swapped), force, torque, given)
        yield Meant(anomaly, fit(swapped, columns, limit))
    if not facts.positions and len(motion.names) > 1:
        for anomaly, points in other_points(motion.names, motion.points):
            other = dataclasses.replace(motion, points=points)
            yield Meant(anomaly, fit(other, columns_of(other, at, force, torque, given), limit))


def _of_displacements(motion: Motion, stands: Explanation, given: Reading, facts: CellSizes) -> list[InputAnomaly]:
    """Name the zero of a joint, or the axes of the displacements; these first where the cell file states none."""
    if facts.tracker is None:
        return _tracker_axes(motion, stands, given, facts) or _zero_off(motion, stands, given)
    return _zero_off(motion, stands, given) or _tracker_axes(motion, stands, given, facts)


def _tracker_axes(motion: Motion, stands: Explanation, given: Reading, facts: CellSizes) -> list[InputAnomaly]:
    """Name the axes of the displacements, where little is explained as they stand, and by far more in others."""
    if not _evident(motion, stands.rest, 0.0, FAR, motion.independent):
        return []  # no reading of it can be clearly better
    turned = turned_axes(motion, given, facts.tracker)
    meant = Meant(turned.anomaly, turned.fit)
    little = _share(motion, stands) < OTHER_ROBOT or turned.fit.rest < TURNED_FAR * stands.rest
    clear = little and turned.angle >= LEAST_TURN and _by_far(motion, stands, meant)
    return [_with_figures(motion, stands, meant)] if clear else []


def _zero_off(motion: Motion, stands: Explanation, given: Reading) -> list[InputAnomaly]:
    """Name the joint whose zero is off, where that alone explains by far the most of what is left of deflections."""

    def rest(offset: Float1D) -> float:
        turned = dataclasses.replace(motion, q=motion.q + offset)
        return fit(turned, columns_of(turned, posture_of(turned), motion.force, motion.torque, given)).rest

    zero = best_zero(rest, stands.rest, ~np.array(motion.chain.prismatic, dtype=bool), ZERO_LEAST)
    if zero is None or zero.rest > ZERO_FAR * stands.rest:
        return []
    before, after = (_independent_squares(motion, one) for one in (stands.rest, zero.rest))
    if 0.5 * motion.independent * np.log(before / after) < LEAST_EVIDENCE:
        return []
    name = motion.chain.joints[zero.joint]
    text = f"the zero of {name} is off by {zero.offset:+.3f} rad: with it, joint springs leave "
    text += f"{100 * zero.rest / stands.rest:.0f} % of what they leave as it stands"
    remedy = f"master {name} again, or add {zero.offset:+.3f} rad to its recorded angles"
    return [InputAnomaly("wrong_robot_file", text, remedy, zero.offset, unit="rad", joints=(name,))]


def _independent_squares(motion: Motion, rest: float) -> float:
    """Return the sum of squares, m^2, in the coordinates that physics leaves independent: what is no noise stays whole.

    Other physics than a zero repeats itself in all readings of a pull, as the zero does; their noise averages out.
    """
    return max(rest - motion.noise, 0.0) + motion.noise * motion.independent / motion.freedom


def _with_figures(motion: Motion, stands: Explanation, meant: Meant) -> InputAnomaly:
    before, after = (100.0 * (1.0 - one.rest / motion.total) for one in (stands, meant.fit))
    text = (
        f"{meant.anomaly.text}: so read, joint springs explain {after:.1f} % of the motion under load, as it stands "
        f"{max(before, 0.0):.1f} %"
    )
    return dataclasses.replace(meant.anomaly, text=text, magnitude=stands.rest / motion.total)


def _no_relation(motion: Motion, stands: Explanation) -> InputAnomaly:
    size = float(np.sqrt(motion.total / motion.freedom))
    text = (
        f"the points move by {1e3 * size:.3g} mm (rms per coordinate) between load steps, and no reading of the wrench "
        f"explains it (joint springs: {100 * max(1 - stands.rest / motion.total, 0.0):.0f} %)"
    )
    remedy = "check that recording, cell file and robot belong together, and that wrench and points share one clock"
    return InputAnomaly("no_relation", text, remedy, stands.rest / motion.total)


def _other_robot(motion: Motion, physics: Explanation) -> InputAnomaly:
    share = 100 * max(_share(motion, physics), 0.0)
    text = (
        f"joints of the robot in the file explain {share:.0f} % of the motion under load as springs with friction and "
        "bearings, with the right file more than 90 %: it describes another robot, or joints, signs or zeros are mixed "
        "up"
    )
    remedy = "use the file of this robot, and check its joint zeros and signs"
    return InputAnomaly("wrong_robot_file", text, remedy, physics.rest / motion.total)


def _unit(motion: Motion, given: Reading, facts: CellSizes) -> list[InputAnomaly]:
    """Judge a common factor of forces or of positions by the stated stiffness, else by the rated load."""
    expected = float(np.linalg.norm(expected_motion(motion, given, facts)))
    if expected == 0.0:
        return []
    size = float(np.linalg.norm(motion.moved)) / expected
    strength = float(np.linalg.norm(motion.force, axis=1).max()) / (facts.rated_load * STANDARD_ACCELERATION)
    return unit_anomaly(size, strength, stated=facts.stiffness is not None)


def _unseen(motion: Motion, given: Reading, facts: CellSizes) -> list[InputAnomaly]:
    """Judge motion that the noise hides: loads that bend any robot visibly, and no motion, do not belong together."""
    expected = expected_motion(motion, given, facts)
    bent = BENT if facts.stiffness is None else BENT_STATED
    if float(np.linalg.norm(expected)) < np.sqrt(motion.freedom) * bent * motion.sigma:
        return []
    size = float(np.linalg.norm(motion.moved) / np.linalg.norm(expected))
    if size > 1.0 / SEEN_BY_PRIOR:
        return []
    if size > 1e-2 / SEEN_BY_PRIOR:
        return _unit(motion, given, facts)
    text = (
        "the points do not move under loads that would move them by "
        f"{1e3 * float(np.linalg.norm(expected)) / np.sqrt(motion.freedom):.2g} mm (rms per coordinate)"
    )
    remedy = "check that the tracker measured, and that loads and points are of the same run"
    return [InputAnomaly("no_relation", text, remedy, 1.0)]


def _overstated(motion: Motion, stands: Explanation) -> list[InputAnomaly]:
    freedom = motion.freedom - len(stands.compliance)
    rms = float(np.sqrt(stands.rest / freedom))
    if rms > OVERSTATED * motion.sigma:
        return []
    text, remedy = overstated_words("joint springs leave", rms, motion.sigma)
    return [InputAnomaly("noise_overstated", text, remedy, rms, unit="m")]


def overstated_words(what: str, rms: float, claimed: float) -> tuple[str, str]:
    """Say that readings scatter far less than is claimed, and what to do; no instrument's scatter vanishes."""
    text = f"{what} {1e6 * rms:.2g} µm per coordinate of readings that claim {1e6 * claimed:.2g} µm of noise: "
    if rms < COMPUTED * claimed:
        return f"{text}they are computed, not measured", "use the readings of the instrument"
    remedy = "state the real standard deviation; or leave more time between readings than the noise lasts"
    return f"{text}the claim is too large, or readings that follow each other share their noise", remedy


RADII = (0.1, 0.4)  # strengths of the elements, of the largest torque of the joint


def fit_with_physics(motion: Motion, given: Reading) -> Explanation:
    """Fit springs, friction and bearings of every joint, none negative, in this order.

    Args:
        motion: What is explained; the readings of a group stand in the order in which they were taken.
        given: How the cell file says that the wrench is to be read.
    """
    springs = columns_of(motion, posture_of(motion), motion.force, motion.torque, given)
    return fit(motion, np.column_stack([springs, -_lag(motion, given), _tilt(motion, given)]))


def _tilt(motion: Motion, given: Reading) -> Float2D:
    """Return the (3 m, 2 n) m that the points move per unit compliance about x and y of the frame before each joint.

    That of the first joint is the base, which rocks.
    """
    at = posture_of(motion)
    target = at.point(motion.points[motion.point].T)
    force, torque, where = Load(motion.force.T, motion.torque.T, given.point, given.rotation).in_base(at)
    columns = []
    for origin, axis in ((at.origin[joint], at.before[joint, k]) for joint in range(len(at.origin)) for k in range(2)):
        moment = dot(axis, torque + cross(where - origin, force))
        columns.append(centred((cross(axis, target - origin) * moment).T, motion.group).reshape(-1))
    return np.column_stack(columns)


def _lag(motion: Motion, given: Reading) -> Float2D:
    """Return the (3 m, 2 n) m that the friction of every joint moves the points, per its strength."""
    at = posture_of(motion)
    turning = load_torque(at, Load(motion.force.T, motion.torque.T, given.point, given.rotation))
    lever = linear_jacobian(at, at.point(motion.points[motion.point].T))
    groups = [np.flatnonzero(motion.group == g) for g in range(int(motion.group.max()) + 1)]
    columns = []
    for torque, column in zip(turning, lever, strict=True):
        largest = float(np.abs(torque).max())
        for radius in RADII:
            friction = np.zeros(len(torque))
            for rows in groups:
                friction[rows] = stop(torque[None, rows], radius * largest, 0.0)[0]
            columns.append(centred((column * friction).T, motion.group).reshape(-1) / max(largest, 1e-300))
    return np.column_stack(columns)
