"""What a joint may follow that no physics of the catalogue says: the dictionary of empirical laws.

A term is an extra deflection of one joint, in parts of its deflection at its largest torque:

    C tau_r * g(t) * (a f_1(q) + b f_2(q)),    t = tau / tau_r,

with g a function of what changes within a configuration (torque, loading direction, step, time, temperature) and f of
the joint angles.  Angles hardly change within a configuration, so that a term is the column of g times one number per
configuration; this is what makes the search cheap.
Source: sparse regression over a library of functions (Brunton, Proctor and Kutz 2016).
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from calibration_core.model.effects.springs import largest
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D, Float2D, Float3D

HARMONICS = 3  # cycles per turn of a joint, at most
SIZE, SQUARE = "the size of the torque", "the square of the torque"
WHOLE_SIZE = "the size of the torque with the weight"
EVEN = frozenset({SIZE, SQUARE, WHOLE_SIZE})  # what a joint follows that gives way more on one flank than on the other
KNEES = (0.5, 0.7, 0.85)  # of the largest torque, where a joint begins to give way more, or less
SLIGHT = 0.02  # of the largest torque: a smaller change is neither loading nor unloading


@dataclasses.dataclass(frozen=True, eq=False)
class Within:
    """What changes within a configuration.

    Attributes:
        joint: Index of the joint that gives way.
        words: What it follows.
        deflection: (m,) rad for a coefficient of one.
    """

    joint: int
    words: str
    deflection: Float1D

    def column(self, state: State) -> Float2D:
        """Return the (m, 3) m that the points move for a coefficient of one."""
        return state.joint_column(self.joint, self.deflection)


@dataclasses.dataclass(frozen=True, eq=False)
class DictionaryTerm:
    """One entry of the dictionary.

    Attributes:
        within: Index of its function within a configuration.
        joint: Index of the joint that gives way.
        words: What the joint follows, for a person.
        names: Its one or two functions of the angles; their coefficients are the term's parameters.
        factors: (c, k) value of those functions in every configuration.
    """

    within: int
    joint: int
    words: str
    names: tuple[str, ...]
    factors: Float2D

    def columns(self, state: State, withins: tuple[Within, ...]) -> Float3D:
        """Return the (m, 3, k) m that the points move for coefficients of one."""
        column = withins[self.within].column(state)
        return np.asarray(column[:, :, None] * self.factors[state.configuration][:, None, :])


def dictionary(state: State) -> tuple[tuple[Within, ...], tuple[DictionaryTerm, ...]]:
    """Return all functions within a configuration, and all terms made of them, for m readings of a robot."""
    withins: list[Within] = []
    terms: list[DictionaryTerm] = []
    angles = _angles(state)
    ones = np.ones((len(angles), 1))
    for joint, name in enumerate(state.chain.joints):
        if state.compliance[joint] <= 0 or not np.any(state.load_torque[joint]):
            continue
        unit = state.compliance[joint] * state.largest_torque(joint)
        share = state.load_torque[joint] / state.largest_torque(joint)
        own = len(withins)
        withins.append(Within(joint, f"torque of {name}", unit * share))
        terms += [
            DictionaryTerm(own, joint, words, names, factors)
            for words, names, factors in _modulations(state, angles, joint)
        ]
        whole = state.torque[joint] / largest(state.torque[joint])
        for words, values in _laws(state, share, whole):
            terms.append(DictionaryTerm(len(withins), joint, words, (words,), ones))
            withins.append(Within(joint, words, unit * values))
    return tuple(withins), tuple(terms)


def _angles(state: State) -> Float2D:
    """Return the (c, n) mean angles of every configuration, rad."""
    count = int(state.configuration.max()) + 1
    size = np.maximum(np.bincount(state.configuration, minlength=count), 1)
    sums = [np.bincount(state.configuration, state.q[:, j], minlength=count) for j in range(state.chain.n)]
    return np.asarray(np.stack(sums, axis=1) / size[:, None])


def _modulations(state: State, angles: Float2D, joint: int) -> list[tuple[str, tuple[str, ...], Float2D]]:
    """Return how a joint's compliance may follow one angle, or its own with another one: words, names, (c, 2)."""
    joints = state.chain.joints
    own = np.eye(len(joints))
    waves = [
        (_multiple(times, joints[other]), times * own[other])
        for other, times in itertools.product(range(len(joints)), range(1, HARMONICS + 1))
    ]
    for other in range(len(joints)):
        if other == joint:
            continue
        for mine, its, sign in itertools.product(range(1, HARMONICS + 1), range(1, HARMONICS + 1), (1, -1)):
            words = f"{_multiple(mine, joints[joint])} {'+' if sign > 0 else '-'} {_multiple(its, joints[other])}"
            waves.append((words, mine * own[joint] + sign * its * own[other]))
    phases = np.stack([weights for _, weights in waves]) @ angles.T
    factors = np.stack([np.cos(phases), np.sin(phases)], axis=2)
    return [
        (f"the angle {words}", (f"cos({words})", f"sin({words})"), one)
        for (words, _), one in zip(waves, factors, strict=True)
    ]


def _multiple(times: int, joint: str) -> str:
    return joint if times == 1 else f"{times} {joint}"


def _laws(state: State, share: Float1D, whole: Float1D) -> list[tuple[str, Float1D]]:
    """Return functions (m,) of torque, loading direction, step, time and temperature; those that are none left out."""
    direction = state.along_steps(share, _direction)
    laws = [
        (SIZE, np.abs(share)),
        (WHOLE_SIZE, np.abs(whole)),
        ("the sign of the torque", np.where(np.abs(share) > SLIGHT, np.sign(share), 0.0)),
        (SQUARE, share**2),
        ("the square of the torque with its sign", share * np.abs(share)),
        ("the cube of the torque", share**3),
        *((f"the torque beyond {100 * knee:.0f} %", _beyond(share, knee)) for knee in KNEES),
        *((f"the torque with the weight beyond {100 * knee:.0f} %", _beyond(whole, knee)) for knee in KNEES),
        ("the loading direction", direction),
        ("torque times loading direction", np.abs(share) * direction),
        ("the number of the step", state.step / largest(state.step.astype(np.float64))),
        ("torque times the number of the step", share * state.step / largest(state.step.astype(np.float64))),
    ]
    for words, values in (("time", state.time), ("temperature", state.temperature)):
        if np.isfinite(values).all() and np.ptp(values) > 0:
            laws.append((f"torque times {words}", share * 2 * (values - values.mean()) / np.ptp(values)))
    return laws


def _beyond(share: Float1D, knee: float) -> Float1D:
    return np.asarray(np.sign(share) * np.clip(np.abs(share) - knee, 0.0, None) / (1.0 - knee))


def _direction(share: Float2D) -> Float2D:
    """Return +1 after the size of the torque grew last, -1 after it fell last, 0 before any load; (s, k)."""
    size = np.abs(share)
    result = np.zeros_like(share)
    for step in range(1, share.shape[1]):
        change = size[:, step] - size[:, step - 1]
        result[:, step] = np.where(np.abs(change) > SLIGHT, np.sign(change), result[:, step - 1])
    return result
