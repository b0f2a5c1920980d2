"""The second grid of scenarios: own weight and loads in one recording, laws of other shapes, other robots and names.

Places, magnitudes and stiffnesses are drawn from log-normal distributions; each effect is loud enough to be named, as
counted after everything that is refitted, the geometry included.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from types import MappingProxyType

import numpy as np

from calibration_sim.generators import EVERYWHERE, OTHER_SHAPES
from calibration_sim.generators.robots import MORE_ROBOTS, ROBOTS
from calibration_sim.scenarios.grid import Planned, Scenario
from calibration_sim.scenarios.measure import Noise
from calibration_sim.scenarios.names import JOINTS, NAMES

Rng = np.random.Generator

ALL_ROBOTS = (*ROBOTS, *MORE_ROBOTS)
# What next to no load shows on a robot: an adapter that is stiff beside the arm, short links under their own weight.
HARDLY = frozenset({("light", "tool_compliance"), ("tiny", "link_bending"), ("tiny", "joint_coupling")})
LOUD = 20.0  # least signal-to-noise ratio
SPREAD = 0.5  # of the logarithm of an amplitude
AT_REST = (
    "off_axis_compliance",
    "link_bending",
    "base_compliance",
    "joint_coupling",
    "pose_dependent_stiffness",
    "gravity_compensator",
    "transmission_error",
)
# Loaded configurations beside such of a single step, few of either and many.
MIXTURES = ("L1A60", "L2A40", "L5A40", "L18A1", "L18A5", "L18A19", "L18A20", "L18A36", "R9A24")
UNDER_LOAD = ("tool_compliance", "nonlinear_stiffness", "soft_zone", "backlash", "hysteresis")
ACROSS = (
    ("nonlinear_stiffness", "soft_zone", "backlash", "hysteresis", "tool_compliance"),
    ("transmission_error", "gravity_compensator", "base_compliance"),
)
LOADED_SINGLES = (
    "off_axis_compliance",
    "link_bending",
    "base_compliance",
    "tool_compliance",
    "joint_coupling",
    "nonlinear_stiffness",
    "soft_zone",
    "backlash",
    "hysteresis",
    "wrench_crosstalk",
)


@dataclasses.dataclass(frozen=True)
class _Row:
    robot: str
    protocol: str
    planned: tuple[Planned, ...] = ()
    names: str = "plain"


def second_grid(seed: int) -> tuple[Scenario, ...]:
    """Return all scenarios of a seed, kind by kind; a kind's scenarios do not depend on the other kinds."""
    scenarios: list[Scenario] = []
    for k, (kind, rows) in enumerate(KINDS.items()):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(21, k)))
        for row in rows(rng):
            number, own = len(scenarios), int(rng.integers(2**31))
            noise = _noise(rng)
            scenarios.append(
                Scenario(number, kind, row.robot, row.protocol, own, row.planned, 0.0, noise, row.names, second=True)
            )
    return tuple(scenarios)


def _planned(rng: Rng, name: str) -> Planned:
    loud = 0.0 if name == "every_spring" else LOUD  # what is refitted anyway has no signal of its own
    return Planned(name, float(np.exp(SPREAD * rng.standard_normal())), snr=loud, at_least=True)


def _robot(rng: Rng, names: tuple[str, ...]) -> str:
    """Draw a robot that shows these effects."""
    return str(rng.choice([robot for robot in ALL_ROBOTS if not HARDLY & {(robot, name) for name in names}]))


def _noise(rng: Rng) -> Noise:
    factor = float(np.exp(rng.uniform(np.log(0.7), np.log(1.5))))
    correlated, wild, spherical = rng.random(3) < (0.25, 0.3, 0.5)
    return Noise(factor, bool(correlated), 0.01 if wild else 0.0, spherical_claim=bool(spherical))


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


def _nothing(rng: Rng) -> Iterator[_Row]:
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


KINDS: MappingProxyType[str, Callable[[Rng], Iterator[_Row]]] = MappingProxyType(
    {
        "rest": _at_rest,
        "mixed": _mixed,
        "across": _across,
        "other_law": _other_law,
        "everywhere": _everywhere,
        "other_robot": _other_robot,
        "other_names": _other_names,
        "nothing_else": _nothing,
        "prismatic": _prismatic,
    }
)
