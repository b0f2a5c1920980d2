"""An effect at a place, with its parameters: one hypothesis about what the model leaves out."""

from __future__ import annotations

import dataclasses
import enum
import functools
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np

from calibration_core.files.yaml_file import read_yaml
from calibration_core.model.effects.state import State
from calibration_core.model.parameters import AppliedEffect
from calibration_core.timeseries import Float2D, Float3D


class Trait(enum.Enum):
    """A property that an effect has or lacks."""

    OF_LARGEST_TORQUE = "its law refers to the largest torque of the recording, which a model keeps with it"
    SPRING = "it acts on its joint with a torque of its own (`Candidate.torques`), which laws of that joint feel"
    MEMORY = "what happened before shows in it, so that it goes on in time"
    LAG = "under changing loads its joint lags, and so it does on the way to a posture"
    DRIFT = "it grows with time, as noise that lasts does"
    HISTORY = "a posture alone does not tell it: from where, when or how warm it was reached does"
    PATH = "it means nothing for places that are no path"
    FRAMES = "where absolute positions fix the frames of the measurement, these take it up and are refitted"
    GEOMETRY = "where absolute positions fix the geometry of the robot, this takes it up and is refitted"
    ACTS_IN_USE = "it moves the robot in production, too, where nothing is measured"
    DAMAGE = "a robot that has it, unlike others of its type, may be damaged"
    BY_WEIGHT = "in positions at rest the robot's own weight drives it, and its size is relative to what that is"


OF_A_FAMILY: Mapping[str, frozenset[Trait]] = MappingProxyType({
    "structure": frozenset({Trait.ACTS_IN_USE, Trait.DAMAGE, Trait.BY_WEIGHT}),
    "joint law": frozenset({Trait.ACTS_IN_USE, Trait.DAMAGE, Trait.BY_WEIGHT}),
    "absolute": frozenset({Trait.ACTS_IN_USE}),
    "load chain": frozenset(),
    "point chain": frozenset(),
})  # fmt: skip
"""What all effects of a family have, without saying it."""


def link_name(index: int) -> str:
    """Return the name of a link by its index: 0 is what the first joint carries."""
    return f"link_{index + 1}"


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One number that an effect has.

    Attributes:
        name: As in result.json.
        unit: Its unit.
        typical: Size that is typical for a robot of this class; the prior is normal about zero with three times this.
        positive: Whether physics allows no negative value; the prior is then the positive half of the normal.
        reach: How many times the candidate's first parameter it may be at most: beyond, the law is no longer linear in
            it, and another variant is offered there.
        most: Largest size that physics allows.
    """

    name: str
    unit: str
    typical: float
    positive: bool = False
    reach: float = math.inf
    most: float = math.inf

    @property
    def bounded(self) -> bool:
        """Whether it may not be of any size."""
        return math.isfinite(self.reach) or math.isfinite(self.most)


def along_axes(name: str, unit: str, size: float, *, positive: bool = False) -> tuple[Parameter, ...]:
    """Return one parameter of a typical size for each of x, y and z."""
    return tuple(Parameter(f"{name}_{axis}", unit, size, positive) for axis in "xyz")


@dataclasses.dataclass(frozen=True, eq=False)
class Candidate:
    """One hypothesis.

    Attributes:
        location: For example {"joint": "joint_2"}.
        variant: Which form of the effect's law or which choice of axes; part of the hypothesis, not of its name.
        parameters: k of them.
        columns: State -> (m, 3, k) m, movement of every reading's point per unit of every parameter, base axes.
        chances: State -> (m, 3, c) m, movements per standard deviation of what is a matter of chance in each
            configuration and no property of the robot, for example where friction stood on arrival; None: nothing is.
            Candidates with the same function share them.
        row_by_row: Whether a reading's movement depends on its own posture and load alone (`State.of_rows`).
        turns: State -> (m, k) rad per unit of every parameter, by which it turns its joint, where it does nothing else;
            None: it may do more.
        torques: State -> (m, k) N*m per unit of every parameter, with which it acts on its joint beside load and
            weight; None: with none.
        shape: What of the form is a value, which `variant` only says in words: the order of a wave, the triangle of a
            spring, the position of a step; None: nothing needs it.
    """

    effect: str
    family: str
    location: Mapping[str, str | tuple[str, ...]]
    variant: str
    parameters: tuple[Parameter, ...]
    columns: Callable[[State], Float3D]
    chances: Callable[[State], Float3D] | None = None
    row_by_row: bool = False
    turns: Callable[[State], Float2D] | None = None
    torques: Callable[[State], Float2D] | None = None
    shape: object = None

    def __post_init__(self) -> None:
        """Freeze the location."""
        object.__setattr__(self, "location", MappingProxyType(dict(self.location)))

    @property
    def key(self) -> tuple[str, tuple[tuple[str, str | tuple[str, ...]], ...], str]:
        """What tells it from all others."""
        return self.effect, tuple(sorted(self.location.items())), self.variant

    @property
    def place(self) -> tuple[str, tuple[tuple[str, str | tuple[str, ...]], ...]]:
        """Effect and location, whatever the variant."""
        return self.key[:2]


class _Formed(Protocol):
    """A hypothesis, of one candidate or of several."""

    @property
    def effect(self) -> str: ...
    @property
    def shape(self) -> object: ...


def number_of(one: _Formed) -> int:
    """Return the whole number that is the form of a hypothesis: the order of a wave, the position of a step.

    Raises:
        TypeError: Its form is no number.
    """
    if isinstance(one.shape, int):
        return one.shape
    raise TypeError(f"the form of {one.effect} is no number")


@dataclasses.dataclass(frozen=True)
class Effect:
    """An entry of the catalogue.

    Attributes:
        equation: The law, in one line.
        source: Where it comes from.
        reveal: The measurement that would show it best.
        candidates: State -> hypotheses that this recording could test, with priors for this robot.
        loaded: Whether it can show in loaded-minus-unloaded data.
        absolute: Whether it can show in absolute positions.
        forms: State -> every form that can be evaluated, offered to a search or not; None: those that are offered.
        restore: Description in a model file -> its hypothesis, None where there is none; for effects with more forms
            than can be listed.
        sentence: What a report says of it, `{place}` standing for where; empty: its name and place.
        traits: What it has besides that which all of its family have (`traits.OF_A_FAMILY`).
        stated: Value of the cell file, as in `frames.tracker`, whose error it looks like; empty: none.
        stated_otherwise: Another value of the cell file, and when it is that one instead; empty: never.
    """

    name: str
    family: str
    equation: str
    source: str
    reveal: str
    candidates: Callable[[State], Iterator[Candidate]]
    loaded: bool = True
    absolute: bool = True
    forms: Callable[[State], Iterator[Candidate]] | None = None
    restore: Callable[[AppliedEffect, State], Candidate | None] | None = None
    sentence: str = ""
    traits: frozenset[Trait] = frozenset()
    stated: str = ""
    stated_otherwise: str = ""

    def has(self, trait: Trait) -> bool:
        """Say whether it has a property, of its own or by its family."""
        return trait in self.traits or trait in OF_A_FAMILY[self.family]

    def restored(self, described: AppliedEffect, state: State) -> Candidate | None:
        """Return the hypothesis that a description means; None where this recording or effect has no such form."""
        if self.restore is not None:
            return self.restore(described, state)
        key = (self.name, tuple(sorted(described.location.items())), described.variant)
        offered = (self.forms or self.candidates)(state)
        return next((found for found in offered if found.key == key), None)


SMALL, LARGE = 10.0, 240.0  # kg
MAX_BYTES = 1 << 20
FILE = Path(__file__).with_name("priors.yaml")


@functools.cache
def typical(name: str, rated_load: float) -> float:
    """Return the typical magnitude of a parameter for a robot of this rated load (kg)."""
    entry = _table()[name]
    share = np.clip(np.log(rated_load / SMALL) / np.log(LARGE / SMALL), 0.0, 1.0)
    return float(np.exp((1 - share) * np.log(entry["small"]) + share * np.log(entry["large"])))


@functools.cache
def _table() -> dict[str, dict[str, Any]]:
    table: dict[str, dict[str, Any]] = read_yaml(FILE, MAX_BYTES, "table of typical magnitudes (YAML)").data
    return table
