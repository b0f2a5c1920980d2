"""The two grids of scenarios, each from one seed: which effects, how large, on which robot, under which protocol.

A scenario is a plan; `generate` turns it into a recording.  All of a scenario's randomness comes from its own seed, so
that any subset of a grid gives the same recordings.  The second grid has own weight and loads in one recording, laws
of other shapes, other robots and names; its sizes are drawn from log-normal distributions, and each effect is loud
enough to be named, as counted after everything that is refitted, the geometry included.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from types import MappingProxyType

import numpy as np

from calibration_core.timeseries import Int1D
from calibration_sim.effects import ANOMALIES, EVERYWHERE, OTHER_SHAPES, OUTSIDE
from calibration_sim.effects.draw import MORE_ROBOTS, ROBOTS
from calibration_sim.scenarios.measure import Noise
from calibration_sim.scenarios.names import JOINTS, NAMES

Rng = np.random.Generator

SINGLES = (
    "off_axis_compliance", "link_bending", "base_compliance", "tool_compliance", "joint_coupling",
    "pose_dependent_stiffness", "gravity_compensator", "nonlinear_stiffness", "soft_zone", "backlash", "hysteresis",
    "creep", "wrench_gain", "wrench_crosstalk", "wrench_frame_misalignment", "wrench_point_offset",
    "tracker_frame_misalignment", "measurement_point_offset", "transmission_error", "thermal_growth",
)  # fmt: skip
NEEDS_SINGLE_STEPS = frozenset({"gravity_compensator", "transmission_error", "thermal_growth"})
# Protocol beside the twenty: what shows in absolute positions, or hardly ever.
BESIDES = {
    "tool_weight": "LA", "cable_force": "LA", "tracker_scale": "LA", "tracker_drift": "LA", "wrench_drift": "R",
    "joint_zero_offset": "LA", "geometry_error": "A", "wrist_coupling": "A", "joint_elasticity": "A",
    "approach_direction": "A", "transmission_error": "A", "thermal_growth": "A",
}  # fmt: skip
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
ALIASES = (("base_compliance", None), *(("off_axis_compliance", place) for place in (0, 2, 3, 4, 5)))
ALL_ROBOTS = (*ROBOTS, *MORE_ROBOTS)
# What next to no load shows on a robot: an adapter that is stiff beside the arm, short links under their own weight.
HARDLY = frozenset({("light", "tool_compliance"), ("tiny", "link_bending"), ("tiny", "joint_coupling")})
LOUDER = 20.0  # least SNR in the second grid
SPREAD = 0.5  # of the logarithm of an amplitude
AT_REST = (
    "off_axis_compliance", "link_bending", "base_compliance", "joint_coupling", "pose_dependent_stiffness",
    "gravity_compensator", "transmission_error",
)  # fmt: skip
# Loaded configurations beside such of a single step, few of either and many.
MIXTURES = ("L1A60", "L2A40", "L5A40", "L18A1", "L18A5", "L18A19", "L18A20", "L18A36", "R9A24")
UNDER_LOAD = ("tool_compliance", "nonlinear_stiffness", "soft_zone", "backlash", "hysteresis")
ACROSS = (
    ("nonlinear_stiffness", "soft_zone", "backlash", "hysteresis", "tool_compliance"),
    ("transmission_error", "gravity_compensator", "base_compliance"),
)
LOADED_SINGLES = (
    "off_axis_compliance", "link_bending", "base_compliance", "tool_compliance", "joint_coupling",
    "nonlinear_stiffness", "soft_zone", "backlash", "hysteresis", "wrench_crosstalk",
)  # fmt: skip
# One target, zero and full load: what the standard allows at the least, and a few configurations more.
MINIMAL = ("S12", "S16", "S12", "S18")


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
        group: single, besides, nothing, clutter, pair, triple, outside, alias or anomaly; or one of `SECOND_KINDS`.
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
    robot: str
    protocol: str
    planned: tuple[Planned, ...] = ()
    names: str = "plain"
    clutter: float = 0.0
    group: str = ""


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
    return tuple(_scenario(number, row, rng, second=False) for number, row in enumerate(rows))


def second_grid(seed: int) -> tuple[Scenario, ...]:
    """Return all scenarios of a seed, kind by kind; a kind's scenarios do not depend on the other kinds."""
    scenarios: list[Scenario] = []
    for k, (kind, rows) in enumerate(SECOND_KINDS.items()):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(21, k)))
        for row in rows(rng):
            scenarios.append(_scenario(len(scenarios), dataclasses.replace(row, group=kind), rng, second=True))
    return tuple(scenarios)


def _scenario(number: int, row: _Row, rng: Rng, *, second: bool) -> Scenario:
    """Draw the seed and the noise of a row; no gross errors or misstated noise where they are the question."""
    seed = int(rng.integers(2**31))
    factor = float(np.exp(rng.uniform(math.log(0.7), math.log(1.5))))
    correlated, wild, spherical = rng.random(3) < (0.25, 0.3 if second else 0.4, 0.5)
    if row.group == "anomaly":
        factor, wild = float(np.clip(factor, 0.85, 1.2)), False
    noise = Noise(factor, bool(correlated), 0.01 if wild else 0.0, spherical_claim=bool(spherical))
    return Scenario(
        number, row.group, row.robot, row.protocol, seed, row.planned, row.clutter, noise, row.names, second
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
            yield _Row(robot, protocol, (Planned(name, amplitude),), group="single")


def _besides() -> Iterator[_Row]:
    for (name, protocol), amplitude, robot in itertools.product(BESIDES.items(), (1.0, 2.0), ROBOTS):
        yield _Row(robot, protocol, (Planned(name, amplitude),), group="besides")


def _nothing() -> Iterator[_Row]:
    for k in range(200):
        robot = ROBOTS[k % 2]
        if k % 3 == 2:
            yield _Row(robot, "LR"[k // 2 % 2], clutter=1.0 if k % 4 == 3 else 3.0, group="clutter")
        else:
            yield _Row(robot, ("L", "R", "L", "R", "L", "R", "W", "LA")[k // 2 % 8], group="nothing")


def _several(rng: np.random.Generator, members: int, count: int) -> Iterator[_Row]:
    for k in range(count):
        kinds = rng.choice(len(KINDS), members, replace=False)
        names = [str(rng.choice(KINDS[i])) for i in kinds]
        planned = tuple(Planned(name, float(rng.uniform(1.0, 2.0)), snr=LOUD, at_least=True) for name in names)
        yield _Row(ROBOTS[k % 2], "LR"[k // 2 % 2], planned, group="pair" if members == 2 else "triple")


def _outside() -> Iterator[_Row]:
    for k, name in enumerate(itertools.islice(itertools.cycle(OUTSIDE), 90)):
        planned = Planned(name, snr=OUTSIDE_SNR[k // len(OUTSIDE) % 3])
        yield _Row(ROBOTS[k // 2 % 2], "LR"[k // 4 % 2], (planned,), group="outside")


def _aliases() -> Iterator[_Row]:
    for k, (name, place) in enumerate(itertools.islice(itertools.cycle(ALIASES), 30)):
        robot = "heavy" if place in {2, 3} else ROBOTS[k // len(ALIASES) % 2]
        protocol = "LR"[k // 2 % 2]
        yield _Row(robot, protocol, (Planned(name, 1.0, place, plain=True, snr=ALIAS_SNR),), group="alias")


def _anomalies() -> Iterator[_Row]:
    for name, robot, protocol in itertools.product(ANOMALIES, ROBOTS, ("L", "R")):
        for amplitude in (1.0, 1.5):
            yield _Row(robot, protocol, (Planned(name, amplitude),), group="anomaly")


def _planned(rng: Rng, name: str) -> Planned:
    loud = 0.0 if name == "every_spring" else LOUDER  # what is refitted anyway has no signal of its own
    return Planned(name, float(np.exp(SPREAD * rng.standard_normal())), snr=loud, at_least=True)


def _robot(rng: Rng, names: tuple[str, ...]) -> str:
    """Draw a robot that shows these effects."""
    return str(rng.choice([robot for robot in ALL_ROBOTS if not HARDLY & {(robot, name) for name in names}]))


def _at_rest(rng: Rng) -> Iterator[_Row]:
    for k in range(105):
        name = AT_REST[k % len(AT_REST)]
        robot = ALL_ROBOTS[k // len(AT_REST) % 5]
        yield _Row(_robot(rng, (name,)) if (robot, name) in HARDLY else robot, "A", (_planned(rng, name),))


def _mixed(rng: Rng) -> Iterator[_Row]:
    effects = (*AT_REST, *UNDER_LOAD)
    for k in range(108):
        protocol = MIXTURES[k // len(effects) % len(MIXTURES)]
        names = UNDER_LOAD if protocol in {"L18A1", "L18A5"} else effects
        few = protocol in {"L1A60", "L2A40"}
        name = (AT_REST if few else names)[k % len(AT_REST if few else names)]
        yield _Row(_robot(rng, (name,)), protocol, (_planned(rng, name),))


def _across(rng: Rng) -> Iterator[_Row]:
    for _ in range(50):
        names = tuple(str(rng.choice(group)) for group in ACROSS)
        protocol = str(rng.choice(["LA", "RA", "L9A40"]))
        yield _Row(_robot(rng, names), protocol, tuple(_planned(rng, name) for name in names))


def _other_law(rng: Rng) -> Iterator[_Row]:
    for k in range(96):
        name = tuple(OTHER_SHAPES)[k % len(OTHER_SHAPES)]
        yield _Row(str(rng.choice(ALL_ROBOTS)), "LR"[k // len(OTHER_SHAPES) % 2], (_planned(rng, name),))


def _everywhere(rng: Rng) -> Iterator[_Row]:
    protocols = {"every_gear": ("A", "LA"), "every_spring": ("A", "A")}
    for k in range(40):
        name = tuple(EVERYWHERE)[k % len(EVERYWHERE)]
        protocol = protocols.get(name, ("L", "R"))[k // len(EVERYWHERE) % 2]
        yield _Row(str(rng.choice(ALL_ROBOTS)), protocol, (_planned(rng, name),))


def _other_robot(rng: Rng) -> Iterator[_Row]:
    for k in range(60):
        name = LOADED_SINGLES[k % len(LOADED_SINGLES)]
        yield _Row(MORE_ROBOTS[k // len(LOADED_SINGLES) % 3], str(rng.choice(["L", "R"])), (_planned(rng, name),))


def _other_names(rng: Rng) -> Iterator[_Row]:
    names = tuple(JOINTS)
    for k in range(45):
        absolute = k % 3 == 2
        name = str(rng.choice(AT_REST if absolute else LOADED_SINGLES))
        protocol = "A" if absolute else str(rng.choice(["L", "R"]))
        yield _Row(_robot(rng, (name,)), protocol, (_planned(rng, name),), names[k // 3 % 3])


def _nothing_else(rng: Rng) -> Iterator[_Row]:
    for k in range(70):
        protocol = ("A", "L", "LA", "R", *MIXTURES)[k % (4 + len(MIXTURES))]
        yield _Row(ALL_ROBOTS[k % 5], protocol, names=str(rng.choice(NAMES)))


def _prismatic(rng: Rng) -> Iterator[_Row]:
    effects = ("off_axis_compliance", "link_bending", "nonlinear_stiffness", "backlash", "hysteresis", "joint_coupling")
    for k in range(26):
        if k % 13 == 12:
            yield _Row("column", "LA")
            continue
        absolute = k % 3 == 2
        name = "transmission_error" if absolute else str(rng.choice(effects))
        yield _Row("column", "A" if absolute else str(rng.choice(["L", "R"])), (_planned(rng, name),))


def _minimal(_: Rng) -> Iterator[_Row]:
    """Every effect that loads show, of typical size and twice, and as many recordings in which nothing is missing."""
    shown = [name for name in SINGLES if name not in NEEDS_SINGLE_STEPS]
    for k in range(400):
        robot, protocol = ROBOTS[k // 2 % 2], MINIMAL[k // 4 % len(MINIMAL)]
        turn, which = divmod(k // 2, len(shown))
        planned = (Planned(shown[which], 1.0 + turn % 2),) if k % 2 else ()
        yield _Row(robot, protocol, planned)


SECOND_KINDS: MappingProxyType[str, Callable[[Rng], Iterator[_Row]]] = MappingProxyType(
    {
        "rest": _at_rest,
        "mixed": _mixed,
        "across": _across,
        "other_law": _other_law,
        "everywhere": _everywhere,
        "other_robot": _other_robot,
        "other_names": _other_names,
        "nothing_else": _nothing_else,
        "prismatic": _prismatic,
        "minimal": _minimal,
    }
)
