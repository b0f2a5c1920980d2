"""What a recording of loads cannot tell apart: every sentence is said where it is true of the readings, and only there.

Each cause is played by an equilibrium of its own, never by the columns of the catalogue.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np
import pytest

from calibration_core.diagnosis.evidence.extended import aliases
from calibration_core.model.chain import Chain, rotation_rpy, rotation_x
from calibration_core.model.effects.state import State, state_of
from calibration_core.model.equilibrium import Equilibrium, solve_equilibrium
from calibration_core.model.kinematics import cross
from calibration_core.model.statics import Load, centres_of_mass
from calibration_core.timeseries import Float1D, Float2D

NAMES = ("sled", "turret", "boom", "stick", "roll", "bend", "spin")  # of seven; six have no sled
ROWS = ((0.35, -np.pi / 2, 0.75), (1.25, 0.0, 0.0), (0.041, -np.pi / 2, 0.0),
        (0.0, np.pi / 2, 1.1), (0.0, -np.pi / 2, 0.0), (0.0, 0.0, 0.23))  # fmt: skip
COMPLIANCE = 1 / np.array([1.4e6, 4.0e6, 9.4e5, 3.6e5, 3.7e5, 3.8e5])
LEVELS = (0.0, 0.5, 1.0, 0.4)
CONFIGURATIONS = 16
TIP = np.array([0.15, 0.05, 0.3])
ALIKE = 0.005  # of what a cause moves beyond what is fitted anyway: second order in the deflections
APART = 0.05
WAVES = (1, 2, 3, 4)


def _arm(*, masses: bool = True, sled: bool = False, tilted: float = 0.0, raised: float = 0.0) -> Chain:
    """Return a six-axis robot of the 240 kg class, its first axis tilted or raised, or all of it on a sled."""
    carried_r, carried_t = rotation_x(tilted), np.array([0.0, 0.0, raised])
    rotation, translation = [], []
    if sled:  # along the base's x
        rotation.append(rotation_rpy(0.0, np.pi / 2, 0.0))
        translation.append(np.zeros(3))
        carried_r = rotation[0].T
    for a, alpha, d in ROWS:
        rotation.append(carried_r)
        translation.append(carried_t)
        carried_r, carried_t = rotation_x(alpha), np.array([a, 0.0, d])
    n = len(rotation)
    mass = np.array([400.0, 300.0, 350.0, 250.0, 60.0, 40.0, 20.0])[-n:]
    return Chain(
        joints=NAMES[-n:], rotation=np.stack(rotation), translation=np.stack(translation), offset=np.zeros(n),
        flange_rotation=carried_r, flange_translation=carried_t, limits=np.tile([-3.0, 3.0], (n, 1)),
        gravity=np.array([0.0, 0.0, -9.81]), mass=mass if masses else None,
        com=np.tile([-0.2, 0.0, 0.05], (n, 1)) if masses else None, prismatic=(sled, *(n - 1) * (False,)),
    )  # fmt: skip


@dataclasses.dataclass(frozen=True, eq=False)
class Played:
    """A robot under loads, and what its points do when something else is true of it; `absolute`: at rest as well."""

    chain: Chain
    compliance: Float1D
    q: Float2D
    wrench: Float2D
    state: State
    absolute: bool

    @property
    def tips(self) -> Float2D:
        """The (3, m) m points in the flange frame."""
        return np.tile(TIP[:, None], (1, len(self.q)))

    def rest(self, extra: Callable[[Equilibrium], Float2D] | None = None, wrench: Float2D | None = None) -> Equilibrium:
        """Solve, with (n, m) rad beside the springs' deflections as they are at the equilibrium itself."""
        wrench = self.wrench if wrench is None else wrench
        load = Load(wrench[:, :3].T, wrench[:, 3:].T, np.array([0.1, -0.05, 0.25]), np.eye(3))
        rest = solve_equilibrium(self.chain, self.q, self.compliance, load)
        for _ in range(0 if extra is None else 5):
            assert extra is not None
            rest = solve_equilibrium(self.chain, self.q + extra(rest).T, self.compliance, load)
        return rest

    def column(self, extra: Callable[[Equilibrium], Float2D]) -> Float1D:
        """Return what a small deflection beside the springs' moves, (3 m,)."""
        return self.seen(self.rest(extra).at.point(self.tips) - self.rest().at.point(self.tips))

    def seen(self, moved: Float2D) -> Float1D:
        """Return what a movement (3, m) m is in the data: differences to step 0, or all of it."""
        return (moved.T if self.absolute else self.state.since_step_zero(moved.T)).ravel()

    def of_joint(self, joint: int, deflection: Callable[[Equilibrium], Float1D]) -> Float1D:
        """Return what a deflection (m,) of one joint moves."""

        def extra(rest: Equilibrium) -> Float2D:
            beside = np.zeros((self.chain.n, len(self.q)))
            beside[joint] = deflection(rest)
            return beside

        return self.column(extra)

    @property
    def stiffnesses(self) -> list[Float1D]:
        """What each joint's being softer moves."""
        return [self.of_joint(j, lambda rest, j=j: 1e-3 * self.compliance[j] * rest.torque[j]) for j in self.springs]

    @property
    def springs(self) -> list[int]:
        return [j for j in range(self.chain.n) if self.compliance[j] > 0]


def _played(chain: Chain, *, absolute: bool = False, read_again: bool = False) -> Played:
    rng = np.random.default_rng(8)
    span = np.array([0.5, 1.5, 0.6, 0.7, 2.0, 1.4, 2.0])[-chain.n :]
    q = np.repeat(rng.uniform(-span, span, (CONFIGURATIONS, chain.n)), len(LEVELS), axis=0)
    pull = rng.normal(size=(CONFIGURATIONS, 6)) * [900, 900, 900, 150, 150, 150]
    wrench = (pull[:, None] * np.array(LEVELS)[:, None]).reshape(-1, 6)
    compliance = np.concatenate([np.zeros(chain.n - 6), COMPLIANCE])
    load = Load(wrench[:, :3].T, wrench[:, 3:].T, np.array([0.1, -0.05, 0.25]), np.eye(3))
    if read_again:  # servos give way, and the encoders say so
        q = q + (0.02 * compliance[:, None] * solve_equilibrium(chain, q, compliance, load).torque).T
    m = len(q)
    state = state_of(
        chain, q, compliance, load, np.tile(TIP[:, None], (1, m)), point_index=np.zeros(m, dtype=np.int64),
        wrench=wrench, configuration=np.repeat(np.arange(CONFIGURATIONS), len(LEVELS)),
        step=np.tile(np.arange(len(LEVELS)), CONFIGURATIONS), time=np.arange(m) * 5.0, temperature=np.full(m, 20.0),
        tracker=np.eye(4), rated_load=240.0,
    )  # fmt: skip
    return Played(chain, compliance, q, wrench, state, absolute)


def _left(cause: Float1D, fitted: list[Float1D], alias: list[Float1D]) -> float:
    """Return which share of a cause an alias leaves, of what is left where the alias is not asked."""
    return _beside(cause, [*fitted, *alias]) / (_beside(cause, fitted) if alias else float(np.linalg.norm(cause)))


def _beside(cause: Float1D, columns: list[Float1D]) -> float:
    scaled = np.column_stack([column / np.linalg.norm(column) for column in columns])
    basis, size, _ = np.linalg.svd(scaled, full_matrices=False)
    basis = basis[:, size > 1e-9 * size[0]]
    return float(np.linalg.norm(cause - basis @ (basis.T @ cause)))


def _gain(played: Played) -> float:
    moved = played.rest(wrench=1.001 * played.wrench).at.point(played.tips) - played.rest().at.point(played.tips)
    return _left(played.seen(moved), played.stiffnesses, [])


def _scale(played: Played) -> float:
    seen = played.rest().at.point(played.tips) - np.array([[3.0], [1.0], [0.5]])  # from where the tracker stands
    return _left(played.seen(1e-4 * seen), played.stiffnesses, [])


def _servo(played: Played) -> float:
    """Return what is left of a servo that gives way; the encoder, where read again, has said it already."""
    joint = played.springs[2]
    said = np.ptp(played.state.since_step_zero(played.q)[:, joint]) > 0
    droop = played.of_joint(joint, lambda rest: 1e-2 * played.compliance[joint] * rest.torque[joint])
    return 1.0 if said else _left(droop, played.stiffnesses, [])


def _compensator(played: Played) -> float:
    """Return what is left of a spring beside the boom, whose torque is that of its triangle at the link's angle."""
    joint = played.chain.joints.index("boom")

    def triangle(rest: Equilibrium) -> Float1D:
        angle = 0.6 - (played.q[:, joint] + rest.deflection[joint])
        return played.compliance[joint] * 3000.0 * np.sin(angle) * (1 - 0.5 / np.sqrt(1 + 0.4 * np.cos(angle)))

    angle = played.q[:, joint]
    waves = [np.ones_like(angle), *(wave(n * angle) for n in WAVES for wave in (np.cos, np.sin))]
    zeros = waves[:1] if played.absolute else waves  # seen at rest, no zero follows an angle as far as that
    zero = [played.of_joint(joint, lambda _, w=w: 1e-4 * w) for w in zeros]
    stiffness = [played.of_joint(joint, lambda rest, w=w: 1e-8 * w * rest.torque[joint]) for w in waves]
    cause = played.of_joint(joint, triangle)
    fitted = played.stiffnesses
    assert _left(cause, fitted, stiffness) > APART  # the zero belongs to it
    return _left(cause, fitted, [*zero, *stiffness])


def _rocking(played: Played) -> float:
    """Return what is left of a base that rocks about a level axis, beside a hinge across the first joint's axis."""
    rest, chain = played.rest(), played.chain
    at, tip = rest.at, rest.at.point(played.tips)
    force, moment, where = played.state.force, played.state.moment, played.state.where
    total = cross(where, force) + moment  # about the base's origin
    if chain.mass is not None:
        for mass, centre in zip(chain.mass, centres_of_mass(chain, at), strict=True):
            total = total + cross(centre, np.broadcast_to((mass * chain.gravity)[:, None], centre.shape))

    def turned(axis: Float2D, about: Float2D) -> Float1D:
        return played.seen(cross(axis, tip) * np.sum(about * total, axis=0) * 1e-7)

    level = np.broadcast_to(np.array([[0.6], [0.8], [0.0]]), (3, len(played.q)))
    across = [chain.rotation[0][:, k] for k in (0, 1)]
    one, other = (np.broadcast_to(axis[:, None], (3, len(played.q))) for axis in across)
    hinge = [turned(one, one), turned(other, other), turned(one, other) + turned(other, one)]
    return _left(turned(level, level), played.stiffnesses, hinge)


CAUSES: Mapping[str, Callable[[Played], float]] = {
    "A gain common to all axes": _gain,
    "A wrong scale of the tracker": _scale,
    "A servo that gives way": _servo,
    "A gravity compensator of boom": _compensator,
    "Rocking of the base": _rocking,
}
ROBOTS: Mapping[str, tuple[Played, set[str]]] = {
    "six axes": (_played(_arm()), set(CAUSES)),
    "six axes, masses not known": (_played(_arm(masses=False)), set(CAUSES)),
    "first axis raised": (_played(_arm(raised=0.6)), set(CAUSES)),
    "first axis tilted": (_played(_arm(tilted=0.2)), set(CAUSES) - {"Rocking of the base"}),
    "on a sled": (_played(_arm(sled=True)), set(CAUSES) - {"Rocking of the base"}),
    "encoders read again": (_played(_arm(), read_again=True), set(CAUSES) - {"A servo that gives way"}),
    "postures at rest as well": (
        _played(_arm(), absolute=True),
        {"A servo that gives way", "Rocking of the base"},
    ),
}


def _said(played: Played) -> tuple[str, ...]:
    return aliases(played.state, differences=not played.absolute)


@pytest.mark.parametrize("robot", ROBOTS)
def test_sentences_are_said_of_the_robot_at_hand(robot: str) -> None:
    played, expected = ROBOTS[robot]
    said = _said(played)
    assert {start for start in CAUSES for sentence in said if sentence.startswith(start)} == expected
    assert len(said) == len(expected)
    assert not any("joint_" in sentence or "joint 1" in sentence or "joint 2" in sentence for sentence in said)
    rocking = [sentence for sentence in said if sentence.startswith("Rocking")]
    assert all(f" {played.chain.joints[0]} " in sentence for sentence in rocking)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("cause", CAUSES)
def test_what_is_said_is_so_and_what_is_not_said_is_not(robot: str, cause: str) -> None:
    played, expected = ROBOTS[robot]
    left = CAUSES[cause](played)
    assert left < ALIKE if cause in expected else left > APART, left


def test_several_recordings_share_no_sensor_and_no_tracker() -> None:
    played, _ = ROBOTS["six axes"]
    state = dataclasses.replace(played.state, setups=object())
    gain, scale, *_ = aliases(state, differences=True)
    assert "in all recordings" in gain
    assert "in all recordings" in scale
