"""What an effect is: a place where it takes hold of the simulated cell, and the label that says what it was.

Every hook does nothing here; an effect overrides those through which it acts.  Randomness inside an effect (friction's
unknown start, a slipping target) comes from a seed of its own, so that a cell played with and without it differs by it
alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D
from calibration_sim.cell.sensors import Sensors
from calibration_sim.cell.truth import Truth
from calibration_sim.mechanics.chain import Chain
from calibration_sim.mechanics.mjcf import Spring
from calibration_sim.mechanics.statics import Push, SideTorque

Location = Mapping[str, Any]
ON_ROBOT = (  # hooks through which an effect moves the robot; through the others it acts on instruments and frames
    "springs", "change_chain", "temperature", "growth", "pushes", "side_torques",
    "begin", "arrive", "deflect", "settle",
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Label:
    """What the diagnosis should have said.

    Attributes:
        family: Of the vocabulary, or `anomaly`, or `outside`.
        effect: Of the vocabulary, or a word of ours for what is outside.
        location: For example {"joint": "joint_2"}.
        amplitude: In units of the typical magnitude.
        parameters: True values, SI units, by name.
        equivalent: Exact aliases: [{"effect": ..., "location": ...}, ...].
        same_law: Whether the diagnosis knows this very law, so that its parameters can be compared with these.
        configurations: Numbers of the configurations concerned; empty: all.
        kinds: Of a law in another shape than the catalogue's: the effects that say its kind; else empty.
    """

    family: str
    effect: str
    location: Location
    amplitude: float = 1.0
    parameters: Mapping[str, float] = dataclasses.field(default_factory=dict)
    equivalent: tuple[Mapping[str, Any], ...] = ()
    same_law: bool = False
    configurations: tuple[int, ...] = ()
    kinds: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        kinds = {"kinds": list(self.kinds)} if self.kinds else {}
        return kinds | {
            "family": self.family,
            "effect": self.effect,
            "location": dict(self.location),
            "amplitude": self.amplitude,
            "parameters": dict(self.parameters),
            "equivalent": [dict(item) for item in self.equivalent],
            "same_law": self.same_law,
            "configurations": list(self.configurations),
        }


@dataclasses.dataclass(frozen=True, eq=False)
class At:
    """Where a session stands at one step.

    Attributes:
        index: Of the configuration, from 0.
        number: Of the configuration, as in the recording.
        step: From 0.
        time: s since the session began.
        temperature: Degrees Celsius.
        q: (n,) rad, commanded.
        approach: (n,) sign of the last motion of every joint, zeros before the first.
        compliance: (n,) rad/(N*m), true.
        places: (links, 3) m, origins of all links in the base frame at rest in step 0; None before that.
    """

    index: int
    number: int
    step: int
    time: float
    temperature: float
    q: Float1D
    approach: Float1D
    compliance: Float1D
    places: Float2D | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Session:
    """All steps of a played protocol, for what happens between the robot and the recording.

    Attributes:
        configuration: (s,) numbers.
        step: (s,).
        time: (s,) s.
        temperature: (s,) degrees Celsius.
        q: (s, n) rad.
        axes: (s, 3, 3) flange axes in the tracker frame, columns.
        load: (s,) size of the external force, N.
    """

    configuration: Int1D
    step: Int1D
    time: Float1D
    temperature: Float1D
    q: Float2D
    axes: Float3D
    load: Float1D

    @property
    def numbers(self) -> list[int]:
        """Numbers of the configurations in the order of time."""
        return list(dict.fromkeys(self.configuration.tolist()))

    def since(self, index: int) -> npt.NDArray[np.bool_]:
        """Return which steps (s,) belong to a configuration (index) or a later one."""
        return np.isin(self.configuration, self.numbers[index:])

    def from_step(self, index: int, step: int) -> npt.NDArray[np.bool_]:
        """Return which steps (s,) of a configuration (index) are this one or a later one."""
        return (self.configuration == self.numbers[index]) & (self.step >= step)


@dataclasses.dataclass(frozen=True, eq=False)
class Effect:
    """Nothing; the root of all effects.

    Attributes:
        label: What it is.
    """

    label: Label

    @property
    def moves_robot(self) -> bool:
        """Whether it acts on the robot itself; what it changes in the truth is seen there."""
        return any(map(self.acts_through, ON_ROBOT))

    def acts_through(self, hook: str) -> bool:
        """Say whether it does anything through one of the hooks below, of which the name is given."""
        return hook in vars(self) or getattr(type(self), hook) is not getattr(Effect, hook)

    def springs(self, chain: Chain) -> tuple[Spring, ...]:
        """Return what gives way besides the joints."""
        return ()

    def change_chain(self, chain: Chain) -> Chain:
        """Return the robot with other masses."""
        return chain

    def change_truth(self, truth: Truth) -> Truth:
        """Return the truth with other stiffnesses, frames, points or geometry."""
        return truth

    def change_sensors(self, sensors: Sensors) -> Sensors:
        """Return other instruments."""
        return sensors

    def change_file(self, cell: dict[str, Any]) -> dict[str, Any]:
        """Return another cell file for the diagnosis to read."""
        return cell

    def temperature(self, time: Float1D) -> Float1D:
        """Return how far (s,) the cell is warmer than usual, K."""
        return np.zeros(len(time))

    def growth(self, at: At) -> float:
        """Return by what share the links are longer than at 20 degrees."""
        return 0.0

    def pushes(self, at: At) -> tuple[Push, ...]:
        """Return forces on links that the sensor does not see."""
        return ()

    def side_torques(self, at: At) -> tuple[SideTorque, ...]:
        """Return torques beside the drives."""
        return ()

    def begin(self, joints: int) -> Any:
        """Return what the effect remembers before the session; None: nothing, ever."""
        return None

    def arrive(self, memory: Any, at: At) -> Any:
        """Return what it remembers on arrival in a configuration."""
        return memory

    def deflect(self, memory: Any, torque: Float1D, at: At) -> Float1D | None:
        """Return by how much (n,) rad the joints stand off besides torque (n,) N*m over stiffness; None: not at all."""
        return None

    def settle(self, memory: Any, torque: Float1D, at: At) -> Any:
        """Return what it remembers once the step is at rest."""
        return memory

    def report(self, wrench: Float2D, session: Session) -> Float2D:
        """Return the wrenches (s, 6) that a sensor without noise shows, sensor axes at the sensor."""
        return wrench

    def see(self, points: Float3D, session: Session) -> Float3D:
        """Return the points (s, p, 3), tracker frame, m, that a tracker without noise shows."""
        return points


@dataclasses.dataclass(frozen=True, eq=False)
class Acting(Effect):
    """An effect that remembers nothing: what it does through each hook is given as a function.

    Attributes:
        hooks: Name of the hook -> what it does.
    """

    hooks: Mapping[str, Callable[..., Any]]

    def __post_init__(self) -> None:
        vars(self).update(self.hooks)


def moving(label: Label, law: Callable[[Float1D, At], Mapping[int, float]]) -> Effect:
    """Return an effect by which joints (index) stand off (rad), as a function of all torques (n,) N*m and of where."""

    def deflect(memory: None, torque: Float1D, at: At) -> Float1D:
        result = np.zeros(len(torque))
        for joint, angle in law(torque, at).items():
            result[joint] = angle
        return result

    return Acting(label, {"deflect": deflect})


def modulated(label: Label, joint: int, wave: Callable[[Float1D], float]) -> Effect:
    """Return a joint's compliance that varies by a share, as a function of all angles (n,) rad."""
    return moving(label, lambda torque, at: {joint: wave(at.q) * at.compliance[joint] * torque[joint]})


def seen(label: Label, change: Callable[[Float3D, Session], Float3D]) -> Effect:
    """Return an effect on what the tracker shows."""
    return Acting(label, {"see": change})


def otherwise(label: Label, change: Callable[[Truth], Mapping[str, Any]]) -> Effect:
    """Return an effect by which parts of the truth, by name, are other ones."""
    return Acting(label, {"change_truth": lambda truth: dataclasses.replace(truth, **change(truth))})
