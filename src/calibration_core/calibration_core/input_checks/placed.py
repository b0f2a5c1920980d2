"""Positions: where the robot file puts the points, against where the tracker saw them, after the best tracker frame."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator

import numpy as np

from calibration_core.input_checks.anomaly import InputAnomaly
from calibration_core.model.chain import Chain, aligned
from calibration_core.model.kinematics import posture
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Int1D

RIGHT = 0.01  # of the reach: a robot file whose points come so near describes this robot
LOADED = 0.0025  # the same where loads are to be explained and no geometry is fitted; points taken as found
ZERO_FAR = 0.5  # a zero that is off leaves less than this share
FAR = 0.2  # what is meant leaves less than this share
UNRELATED = 0.5  # of the spread of the points
FEWEST = 6  # positions
FLAT = 1e-3  # positions on a line tell nothing
SCALES = {1e-3: "mm", 1e3: "km", 0.0254: "inches", 0.01: "cm", 0.3048: "feet"}
NEAR_SCALE = 0.03  # relative
FITS = 20  # turns of the tracker frame, each with the best points: a target 0.4 m off is found to 1 mm
LEAST_EVIDENCE = 30.0  # nats
NEAR_TURN = np.radians(40.0)  # of the stated orientation: two mirror images of one recording are half a turn apart


@dataclasses.dataclass(frozen=True, eq=False)
class PositionRecording:
    """Positions of one recording.

    Attributes:
        q: (m, n) rad.
        position: (m, 3) m, tracker frame.
        point: (m,) index of the measurement point.
        points: (k, 3) m, where the cell file has them, flange frame.
        loaded: Whether the recording holds loads, so that its geometry is taken from the robot file.
        tracker: (3, 3) orientation of the tracker in the base frame as the cell file states it; None: it does not.
    """

    chain: Chain
    q: Float2D
    position: Float2D
    point: Int1D
    points: Float2D
    names: tuple[str, ...]
    loaded: bool = False
    tracker: Float2D | None = None


def check_positions(seen: PositionRecording) -> list[InputAnomaly]:
    """Return what is wrong with joints, points, angles or the unit of positions; at most one fault."""
    spans = np.linalg.svd(seen.position - seen.position.mean(axis=0), compute_uv=False)
    if len(seen.q) < FEWEST or spans[1] < FLAT * spans[0]:
        return []
    reach = seen.chain.reach
    stands = misplaced(seen)
    tried = sorted(_alternatives(seen, stands, reach), key=lambda one: one[1])
    if stands > RIGHT * reach or _swapped_points(tried, stands):
        for anomaly, rms in tried[:1]:
            if rms < FAR * stands and rms < RIGHT * reach:
                text = f"{anomaly.text}: so read, the points are {1e3 * rms:.2g} mm (rms per coordinate) from where "
                text += f"the robot file puts them, as it stands {1e3 * stands:.3g} mm"
                return [dataclasses.replace(anomaly, text=text, magnitude=stands, unit="m")]
    freed = _with_free_points(seen)
    coupled = _coupled(seen, freed) if freed > (LOADED if seen.loaded else 2 * RIGHT) * reach else []
    if coupled:
        return coupled
    zero = _zero_off(seen, stands) if seen.loaded else []
    if zero:
        return zero
    spread = float(np.sqrt(np.mean((seen.position - seen.position.mean(axis=0)) ** 2)))
    if freed > UNRELATED * spread and freed > RIGHT * reach:
        text = f"positions and joint angles have nothing to do with each other: {1e3 * freed:.3g} mm are left of a "
        text += f"spread of {1e3 * spread:.3g} mm (rms per coordinate) with the best tracker frame and points"
        remedy = "check that recording, cell file and robot belong together"
        return [InputAnomaly("no_relation", text, remedy, freed, unit="m")]
    if freed > (LOADED if seen.loaded else 2 * RIGHT) * reach:
        text = f"with the best tracker frame and points they are {1e3 * freed:.3g} mm (rms per coordinate) from where "
        text += "the robot file puts them: it describes another robot, or joints, signs or zeros are mixed up"
        remedy = "use the file of this robot, and check its joint zeros and signs"
        return [InputAnomaly("wrong_robot_file", text, remedy, freed, unit="m")]
    return []


def _coupled(seen: PositionRecording, freed: float) -> list[InputAnomaly]:
    """Name that joint 3 is stated against the floor, as on a pendant of FANUC, where that alone explains the points."""
    if len(seen.chain.joints) < 6 or freed <= RIGHT * seen.chain.reach:
        return []
    second, third = seen.chain.joints[1:3]
    for factor in (1.0, -1.0):
        q = seen.q.copy()
        q[:, 2] += factor * q[:, 1]
        rms = _with_free_points(dataclasses.replace(seen, q=q))
        if rms < FAR * freed and rms < RIGHT * seen.chain.reach:
            text = f"the angle of {third} is stated with that of {second} in it: so read, the points are "
            text += f"{1e3 * rms:.2g} mm (rms per coordinate) from where the robot file puts them, as it stands "
            text += f"{1e3 * freed:.3g} mm"
            remedy = f"state robot.joint_coupling: {{{third}: {{{second}: {factor:g}}}}} in the cell file"
            return [InputAnomaly("joint_coupling", text, remedy, freed, unit="m", joints=(second, third))]
    return []


def _zero_off(seen: PositionRecording, stands: float) -> list[InputAnomaly]:
    """Name the joint whose zero is off, where that alone explains by far the most of what is left."""

    def rest(offset: Float1D) -> float:
        return misplaced(dataclasses.replace(seen, q=seen.q + offset)) ** 2

    zero = best_zero(rest, stands**2, ~np.array(seen.chain.prismatic, dtype=bool))
    if zero is None:
        return []
    after = float(np.sqrt(zero.rest))
    evidence = 3 * len(seen.q) * np.log(stands / max(after, 1e-12))
    if after > ZERO_FAR * stands or evidence < LEAST_EVIDENCE:
        return []
    name, freed = seen.chain.joints[zero.joint], _with_free_points(seen)
    turned = " (or the measurement points stand turned by as much about its axis)" if freed < 2 * after else ""
    text = f"the zero of {name} is off by {zero.offset:+.4f} rad{turned}: with it, the points are {1e3 * after:.2g} mm "
    text += f"(rms per coordinate) from where the robot file puts them, as it stands {1e3 * stands:.3g} mm"
    remedy = f"master {name} again, or add {zero.offset:+.4f} rad to its recorded angles"
    return [InputAnomaly("wrong_robot_file", text, remedy, zero.offset, unit="rad", joints=(name,))]


def _with_free_points(seen: PositionRecording) -> float:
    """Return the rms per coordinate, m, with the best tracker frame and the best points in the flange frame."""
    at = posture(seen.chain, seen.q)
    origin = at.point(np.zeros((3, len(seen.q)))).T
    axes = np.stack([at.point(np.repeat(row[:, None], len(seen.q), axis=1)).T - origin for row in np.eye(3)], axis=-1)
    shift = np.zeros((len(seen.q), 3, 3 * len(seen.points)))
    for index in range(len(seen.points)):
        of = seen.point == index
        shift[of, :, 3 * index : 3 * index + 3] = axes[of]
    design = (shift - shift.mean(axis=0)).reshape(3 * len(seen.q), -1)
    best = np.linalg.pinv(design.T @ design, hermitian=True)
    origin, position = origin - origin.mean(axis=0), seen.position - seen.position.mean(axis=0)
    target = _predicted(seen)
    for _ in range(FITS):
        moved = (_moved(target, position) - origin).ravel()
        target = origin + (design @ (best @ (design.T @ moved))).reshape(-1, 3)
    return _registered(target, seen.position)[0]


def _swapped_points(tried: list[tuple[InputAnomaly, float]], stands: float) -> bool:
    """Points are distinguishable where they differ by far less than the reach."""
    return bool(tried) and tried[0][0].kind == "point_order" and tried[0][1] < FAR * stands


def misplaced(seen: PositionRecording) -> float:
    """Return the rms per coordinate, m, between positions and where the robot puts the points, in the best frame."""
    return _registered(_predicted(seen), seen.position)[0]


def _predicted(seen: PositionRecording) -> Float2D:
    at = posture(seen.chain, seen.q)
    return at.point(seen.points[seen.point].T).T


def _moved(target: Float2D, source: Float2D) -> Float2D:
    """Return the source after the best rotation and shift, (m, 3) m."""
    return np.asarray((source - source.mean(axis=0)) @ aligned(target, source).T + target.mean(axis=0))


def _registered(target: Float2D, source: Float2D) -> tuple[float, float]:
    """Return rms after the best rotation and shift, and the scale that fits best (Umeyama, 1991)."""
    a, b = target - target.mean(axis=0), source - source.mean(axis=0)
    rotated = b @ aligned(target, source).T
    power = float(np.sum(b**2))
    return float(np.sqrt(np.mean((a - rotated) ** 2))), float(np.sum(a * rotated)) / power if power > 0 else 1.0


def _alternatives(seen: PositionRecording, stands: float, reach: float) -> Iterator[tuple[InputAnomaly, float]]:
    if len(seen.names) > 1:
        yield from _orders(seen)
    if stands <= RIGHT * reach:
        return
    names = seen.chain.joints
    for i, j in itertools.combinations(range(len(names)), 2):
        q = seen.q.copy()
        q[:, [i, j]] = q[:, [j, i]]
        remedy = f"exchange the angles of {names[i]} and {names[j]}"
        text = f"the angles of {names[i]} and {names[j]} are exchanged"
        anomaly = InputAnomaly("joint_order", text, remedy, 0.0, joints=(names[i], names[j]))
        yield anomaly, misplaced(dataclasses.replace(seen, q=q))
    for factor, unit in ((np.pi / 180.0, "degrees"), (180.0 / np.pi, "radians converted twice")):
        anomaly = InputAnomaly("angle_unit", f"the joint angles look like {unit}", "give joint angles in rad: multiply "
                               f"them by {factor:.6g}", 0.0, factor=factor)  # fmt: skip
        yield anomaly, misplaced(dataclasses.replace(seen, q=factor * seen.q))
    scale = _registered(_predicted(seen), seen.position)[1]
    for factor, unit in SCALES.items():
        if abs(scale / factor - 1.0) < NEAR_SCALE:
            anomaly = InputAnomaly("position_unit", f"positions look like {unit}", f"give positions in m: multiply "
                                   f"them by {factor:g}", 0.0, factor=factor)  # fmt: skip
            yield anomaly, misplaced(dataclasses.replace(seen, position=factor * seen.position))
    yield _mirrored(seen)


def _orders(seen: PositionRecording) -> Iterator[tuple[InputAnomaly, float]]:
    for anomaly, points in other_points(seen.names, seen.points):
        yield anomaly, misplaced(dataclasses.replace(seen, points=points))


def _mirrored(seen: PositionRecording) -> tuple[InputAnomaly, float]:
    """Return that the tracker's axes are left-handed, with what is left of the positions then.

    Mirror images in the three axes are turns of each other: only a stated orientation of the tracker says which one.
    """
    images = [seen.position * np.where(np.arange(3) == axis, -1.0, 1.0) for axis in range(3)]
    there, which = _predicted(seen), ""
    if seen.tracker is not None:
        cosines = [(np.trace(seen.tracker.T @ aligned(there, image)) - 1.0) / 2.0 for image in images]
        axis = int(np.argmax(cosines))
        which = "xyz"[axis] if np.arccos(np.clip(cosines[axis], -1.0, 1.0)) < NEAR_TURN else ""
    wrong = "the sign of one coordinate of the readings is wrong: "
    if which:
        remedy = f"{wrong}turn the sign of {which} of all positions"
    else:
        remedy = (
            f"{wrong}export the positions in right-handed axes, or turn the sign of one of x, y and z of all of them"
        )
    text = "the readings are mirrored: the tracker's axes are left-handed"
    axes = f"-{which}" if which else ""
    anomaly = InputAnomaly("point_order", text, remedy, 0.0, points=seen.names, axes=axes)
    return anomaly, _registered(there, images[0])[0]


MOST_POINTS = 5  # all of whose orders are tried


def other_points(names: tuple[str, ...], points: Float2D) -> Iterator[tuple[InputAnomaly, Float2D]]:
    """Yield every other order and mirror image of (k, 3) points, with what it means; none of a single point's order."""
    count = len(names)
    orders = itertools.permutations(range(count)) if count <= MOST_POINTS else _exchanges(count)
    for order in orders:
        changed = [i for i in range(count) if order[i] != i]
        if not changed:
            continue
        words = ", ".join(f"{names[i]} is {names[order[i]]}" for i in changed)
        text = f"measurement points are exchanged ({words})"
        remedy = f"name the points as the cell file has them: {words}"
        anomaly = InputAnomaly("point_order", text, remedy, 0.0, points=tuple(names[i] for i in changed))
        yield anomaly, points[list(order)]
    for axis in range(3):
        mirrored = points * np.where(np.arange(3) == axis, -1.0, 1.0)
        if np.array_equal(mirrored, points):
            continue
        text = f"the measurement points are mirrored: {'xyz'[axis]} has the wrong sign in the cell file"
        remedy = f"turn the sign of {'xyz'[axis]} of frames.measurement_points"
        yield InputAnomaly("point_order", text, remedy, 0.0, points=names, axes=f"-{'xyz'[axis]}"), mirrored


def _exchanges(count: int) -> Iterator[tuple[int, ...]]:
    for i, j in itertools.combinations(range(count), 2):
        order = list(range(count))
        order[i], order[j] = j, i
        yield tuple(order)


LEAST = 0.01  # rad, ten times what robots in order have
MOST = 0.35  # rad, beyond which it is no zero
STEP = 0.03  # rad, of the first parabola
ROUNDS = 4


@dataclasses.dataclass(frozen=True)
class JointZero:
    """The zero of one joint that explains a recording best.

    Attributes:
        offset: What is to be added to the recorded angle, rad.
        rest: Sum of squares that stays, m^2.
    """

    joint: int
    offset: float
    rest: float


def best_zero(
    rest: Callable[[Float1D], float], stands: float, revolute: Bool1D, least: float = LEAST
) -> JointZero | None:
    """Return the single zero, of `least` to MOST in size, that leaves the least; None where none does better.

    The sum of squares is nearly a parabola in the offset; its lowest point is found by three of its values, again and
    again (successive parabolic interpolation), from both sides.

    Args:
        rest: Sum of squares, m^2, for (n,) rad added to the recorded angles.
        stands: The same for none added.
        revolute: (n,) joints that turn.
        least: rad.
    """
    found = [_lowest(rest, stands, int(joint), len(revolute)) for joint in np.flatnonzero(revolute)]
    better = [zero for zero in found if least <= abs(zero.offset) <= MOST and zero.rest < stands]
    return min(better, key=lambda zero: zero.rest, default=None)


def _lowest(rest: Callable[[Float1D], float], stands: float, joint: int, n: int) -> JointZero:
    unit = np.eye(n)[joint]
    at, value, step, move, farthest = 0.0, stands, STEP, 0.0, MOST
    for _ in range(ROUNDS):
        left, right = rest((at - step) * unit), rest((at + step) * unit)
        bend = left - 2 * value + right
        move = 0.5 * step * (left - right) / bend if bend > 0 else step * float(np.sign(left - right))
        farthest = 3 * step
        move = float(np.clip(move, -farthest, farthest))
        there = rest((at + move) * unit)
        if there < value:
            at, value = at + move, there
        step = max(0.3 * abs(move), 1e-3)
        if abs(move) < 2e-4 or abs(at) > MOST:
            break
    if abs(move) >= farthest:  # still on its way: no lowest point was found
        return JointZero(joint, 0.0, stands)
    return JointZero(joint, at, value)
