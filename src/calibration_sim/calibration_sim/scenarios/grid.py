"""The grid of scenarios, from one seed: which effects, how large, on which robot, under which protocol.

A scenario is a plan; `generate` turns it into a recording.  All of a scenario's randomness comes from its own seed, so
that any subset of the grid gives the same recordings.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from calibration_core.timeseries import Int1D
from calibration_sim.generators import ANOMALIES, OUTSIDE
from calibration_sim.generators.robots import ROBOTS
from calibration_sim.scenarios.measure import Noise

SINGLES = (
    "off_axis_compliance",
    "link_bending",
    "base_compliance",
    "tool_compliance",
    "joint_coupling",
    "pose_dependent_stiffness",
    "gravity_compensator",
    "nonlinear_stiffness",
    "soft_zone",
    "backlash",
    "hysteresis",
    "creep",
    "wrench_gain",
    "wrench_crosstalk",
    "wrench_frame_misalignment",
    "wrench_point_offset",
    "tracker_frame_misalignment",
    "measurement_point_offset",
    "transmission_error",
    "thermal_growth",
)
NEEDS_SINGLE_STEPS = frozenset({"gravity_compensator", "transmission_error", "thermal_growth"})
# Protocol beside the twenty: what shows in absolute positions, or hardly ever.
BESIDES = {
    "tool_weight": "LA",
    "cable_force": "LA",
    "tracker_scale": "LA",
    "tracker_drift": "LA",
    "wrench_drift": "R",
    "joint_zero_offset": "LA",
    "geometry_error": "A",
    "wrist_coupling": "A",
    "joint_elasticity": "A",
    "approach_direction": "A",
    "transmission_error": "A",
    "thermal_growth": "A",
}
# For pairs and triples: one of each kind, so that what is meant by two effects is beyond dispute.
KINDS = (
    ("off_axis_compliance", "link_bending", "base_compliance", "tool_compliance", "joint_coupling"),
    ("nonlinear_stiffness", "soft_zone", "backlash"),
    ("hysteresis",),
    ("wrench_gain", "wrench_crosstalk", "wrench_frame_misalignment", "wrench_point_offset"),
)
AMPLITUDES = (0.5, 1.0, 2.0)
LOUD = 12.0  # least SNR of each member of a pair or triple
OUTSIDE_SNR = (12.0, 20.0, 40.0)
ALIAS_SNR = 20.0
CLUTTER = 50
# Exact aliases: (effect, place).  Base rocking and the first joint's bearing; isotropic bearings of joints whose axes
# meet.  Those of the third and the fourth joint pass each other at a distance: on the heavy robot, too small to tell.
ALIASES = (
    ("base_compliance", None),
    ("off_axis_compliance", 0),
    ("off_axis_compliance", 2),
    ("off_axis_compliance", 3),
    ("off_axis_compliance", 4),
    ("off_axis_compliance", 5),
)


@dataclasses.dataclass(frozen=True)
class Planned:
    """One effect of a scenario.

    Attributes:
        name: Of its maker.
        amplitude: In units of the typical magnitude.
        place: Joint or link (index); None: drawn.
        plain: See `makers.draw.Draw`.
        snr: Scale the amplitude to this signal-to-noise ratio; 0: leave it.
        at_least: Only ever make it larger.
    """

    name: str
    amplitude: float = 1.0
    place: int | None = None
    plain: bool = False
    snr: float = 0.0
    at_least: bool = False


@dataclasses.dataclass(frozen=True)
class Scenario:
    """One recording to be made.

    Attributes:
        number: In the grid, from 0.
        group: single, besides, nothing, clutter, pair, triple, outside, alias or anomaly; or a kind of `second_grid`.
        robot: See `robots`.
        protocol: See `protocols`.
        seed: Of truth, protocol, places and noise.
        planned: Effects.
        clutter: Signal-to-noise ratio of each of fifty small effects; 0: none.
        noise: How the instruments err.
        names: How joints and points are called, see `names`.
        second: Whether it is one of `second_grid`: what an effect shows is counted beyond the geometry, stiffnesses
            differ more from the file, and the label lists what looks alike.
    """

    number: int
    group: str
    robot: str
    protocol: str
    seed: int
    planned: tuple[Planned, ...]
    clutter: float
    noise: Noise
    names: str = "plain"
    second: bool = False


@dataclasses.dataclass(frozen=True)
class _Row:
    group: str
    robot: str
    protocol: str
    planned: tuple[Planned, ...] = ()
    clutter: float = 0.0


def grid(seed: int) -> tuple[Scenario, ...]:
    """Return all scenarios of a seed, in the order of their groups."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(11,)))
    rows = [
        *_singles(),
        *_besides(),
        *_nothing(),
        *_several(rng, 2, 150),
        *_several(rng, 3, 50),
        *_outside(),
        *_aliases(),
        *_anomalies(),
    ]
    return tuple(
        Scenario(
            number,
            row.group,
            row.robot,
            row.protocol,
            int(rng.integers(2**31)),
            row.planned,
            row.clutter,
            _noise(rng, row),
        )
        for number, row in enumerate(rows)
    )


def sample(scenarios: Sequence[Scenario], count: int | None, only: Sequence[str] = ()) -> tuple[Scenario, ...]:
    """Choose scenarios.

    Args:
        scenarios: All of them.
        count: How many, the first by name, which is at random over the grid: fewer are always among more; None: all.
        only: Names of groups or effects; empty: all.
    """
    wanted = set(only)
    chosen = [s for s in scenarios if not wanted or s.group in wanted or wanted & {p.name for p in s.planned}]
    first = sorted(chosen, key=lambda s: recording_name(s, len(scenarios)))[:count]
    return tuple(sorted(first, key=lambda s: s.number))


def recording_name(scenario: Scenario, total: int) -> str:
    """Return a name that says nothing: numbers shuffled by the grid's length alone."""
    return f"r{int(_shuffled(total)[scenario.number]) + 1:04d}"


@functools.cache
def _shuffled(total: int) -> Int1D:
    return np.random.default_rng(total).permutation(total)


def _singles() -> Iterator[_Row]:
    for name, amplitude, robot, loads in itertools.product(SINGLES, AMPLITUDES, ROBOTS, ("L", "R")):
        protocol = loads + ("A" if name in NEEDS_SINGLE_STEPS else "")
        for _ in range(2):
            yield _Row("single", robot, protocol, (Planned(name, amplitude),))


def _besides() -> Iterator[_Row]:
    for (name, protocol), amplitude, robot in itertools.product(BESIDES.items(), (1.0, 2.0), ROBOTS):
        yield _Row("besides", robot, protocol, (Planned(name, amplitude),))


def _nothing() -> Iterator[_Row]:
    for k in range(200):
        robot = ROBOTS[k % 2]
        if k % 3 == 2:
            yield _Row("clutter", robot, "LR"[k // 2 % 2], clutter=1.0 if k % 4 == 3 else 3.0)
        else:
            yield _Row("nothing", robot, ("L", "R", "L", "R", "L", "R", "W", "LA")[k // 2 % 8])


def _several(rng: np.random.Generator, members: int, count: int) -> Iterator[_Row]:
    for k in range(count):
        kinds = rng.choice(len(KINDS), members, replace=False)
        names = [str(rng.choice(KINDS[i])) for i in kinds]
        planned = tuple(Planned(name, float(rng.uniform(1.0, 2.0)), snr=LOUD, at_least=True) for name in names)
        yield _Row("pair" if members == 2 else "triple", ROBOTS[k % 2], "LR"[k // 2 % 2], planned)


def _outside() -> Iterator[_Row]:
    for k, name in enumerate(itertools.islice(itertools.cycle(OUTSIDE), 90)):
        planned = Planned(name, snr=OUTSIDE_SNR[k // len(OUTSIDE) % 3])
        yield _Row("outside", ROBOTS[k // 2 % 2], "LR"[k // 4 % 2], (planned,))


def _aliases() -> Iterator[_Row]:
    for k, (name, place) in enumerate(itertools.islice(itertools.cycle(ALIASES), 30)):
        robot = "heavy" if place in {2, 3} else ROBOTS[k // len(ALIASES) % 2]
        protocol = "LR"[k // 2 % 2]
        yield _Row("alias", robot, protocol, (Planned(name, 1.0, place, plain=True, snr=ALIAS_SNR),))


def _anomalies() -> Iterator[_Row]:
    for name, robot, protocol in itertools.product(ANOMALIES, ROBOTS, ("L", "R")):
        for amplitude in (1.0, 1.5):
            yield _Row("anomaly", robot, protocol, (Planned(name, amplitude),))


def _noise(rng: np.random.Generator, row: _Row) -> Noise:
    """Draw how the instruments err; gross errors and misstated noise are not added where they are the question."""
    factor = float(np.exp(rng.uniform(math.log(0.7), math.log(1.5))))
    correlated, wild, spherical = rng.random(3) < (0.25, 0.4, 0.5)
    if row.group == "anomaly":
        factor, wild = float(np.clip(factor, 0.85, 1.2)), False
    return Noise(factor, bool(correlated), 0.01 if wild else 0.0, spherical_claim=bool(spherical))
