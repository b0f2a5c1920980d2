"""The processes that the suite consists of: one table, without ROS.

The launch files read it, and so does whoever starts the suite where there is no `launch`.  When a tree is ended, every
process gets SIGINT at once; one that has not ended is sent SIGTERM, then SIGKILL, after the times of its row.  No
process is ended because another one has ended: the others say what they miss, and go on when it is back.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

Scalar = bool | int | float | str

SIGTERM_AFTER = 5.0  # s, from SIGINT; as launch does it by itself
SIGKILL_AFTER = 5.0  # s, from SIGTERM
STANDSTILL = 10.0  # s, that whoever stops the robot waits for it to stand, whatever signals say meanwhile
OUTLIVES = STANDSTILL + 5.0  # s, from SIGINT to SIGTERM, of a process that waits for standstill


@dataclasses.dataclass(frozen=True)
class Argument:
    """What is said when a tree is started.

    Attributes:
        name: Name.
        description: One sentence.
        default: Value if nothing is said; None: it must be said.
        shared: Whether the default is a file in the share folder of the package `calibration`.
        type: Of the value as a parameter.
        choices: The values allowed; empty: any.
    """

    name: str
    description: str
    default: str | None = None
    shared: bool = False
    type: type[Scalar] = str
    choices: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Given:
    """The value of an argument; `inside` is a path below it, where it is a directory."""

    argument: str
    inside: str = ""


Value = Scalar | Given


@dataclasses.dataclass(frozen=True)
class Process:
    """One node of the suite, as a process.

    Attributes:
        name: Of its executable and of the node.
        parameters: What it is given besides the parameter file.
        package: Where the executable is.
        sigterm_after: s, from SIGINT to SIGTERM.
        sigkill_after: s, from SIGTERM to SIGKILL.
    """

    name: str
    parameters: Mapping[str, Value]
    package: str = "calibration"
    sigterm_after: float = SIGTERM_AFTER
    sigkill_after: float = SIGKILL_AFTER


@dataclasses.dataclass(frozen=True)
class Tool:
    """A process of somebody else: the words of its command."""

    words: tuple[str | Given, ...]


@dataclasses.dataclass(frozen=True)
class Tree:
    """Processes that belong together, in the order in which they are started.

    Attributes:
        arguments: What may be said when it is started.
        processes: The nodes.
        tools: What else is started.
    """

    arguments: tuple[Argument, ...]
    processes: tuple[Process, ...]
    tools: tuple[Tool, ...] = ()


CELL = Argument("cell", "The cell file.")
SESSION = Argument("session", "Directory of the session; one that is there is continued.")
PARAMETERS_FILE = Argument("params_file", "Parameters of the nodes.", "config/ros.yaml", shared=True)
NAMESPACE = Argument("namespace", "Namespace of the cell.", "")
BACKENDS = ("follow_joint_trajectory", "joint_trajectory_topic", "external", "simulated")
BACKEND = Argument("backend", "How the robot is moved, and stopped.", "follow_joint_trajectory", choices=BACKENDS)
INTERFACE = Argument("interface", "Action or topic that moves the robot; empty: the back end's usual one.", "")
ADAPTER = Argument("adapter", "How the controller's state is understood.", "industrial")
RATE = Argument("rate", "Multiple of real time.", "1.0")

CELL_FILE = {"cell": Given("cell")}
BAG = {"recording": Given("session", "bag")}


def _suite(everywhere: Mapping[str, Value], motion: Mapping[str, Value], adapter: Value, load: Mapping[str, Value]
           ) -> tuple[Process, ...]:  # fmt: skip
    """Return the nodes of a cell: who moves the robot and who stops it are told the same way to it."""
    return (
        Process("recorder", {**everywhere, "out": Given("session", "bag")}),
        Process("tracker", everywhere),
        Process("force_torque", everywhere),
        Process("guard", {**everywhere, **motion, "robot_state.adapter": adapter}, sigterm_after=OUTLIVES),
        Process("sequencer", {**everywhere, **motion, **load, **BAG}),
        Process("identification", {**CELL_FILE, **BAG}),
    )


REAL_CELL = Tree(
    (CELL, SESSION, PARAMETERS_FILE, NAMESPACE, BACKEND, INTERFACE, ADAPTER),
    _suite(CELL_FILE, {"motion.backend": Given("backend"), "motion.interface": Given("interface")},
           Given("adapter"), {}),
)  # fmt: skip
SIMULATED_CELL = Tree(
    (
        CELL,
        SESSION,
        PARAMETERS_FILE,
        NAMESPACE,
        Argument("speed", "Multiple of real time.", "1.0", type=float),
        Argument("seed", "Of the hidden truth and of the noise.", "1", type=int),
    ),
    (
        Process(
            "simulated_cell",
            {**CELL_FILE, "use_sim_time": True, "clock": True, "speed": Given("speed"), "seed": Given("seed")},
            package="calibration_sim",
            sigterm_after=OUTLIVES,
        ),
        *_suite({**CELL_FILE, "use_sim_time": True}, {"motion.backend": "simulated"}, "native", {"load.by": "device"}),
    ),
)
REPLAY = Tree(
    (CELL, Argument("recording", "The bag."), PARAMETERS_FILE, NAMESPACE, RATE),
    (Process("identification", {**CELL_FILE, "recording": Given("recording")}),),
    (Tool(("ros2", "bag", "play", Given("recording"), "--clock", "--rate", Given("rate"))),),
)


def said_or_default(tree: Tree, said: Mapping[str, str], share: str) -> dict[str, str]:
    """Return the values of a tree's arguments.

    Args:
        tree: The tree.
        said: Values by name, in place of the defaults.
        share: The share folder of the package `calibration`.

    Raises:
        KeyError: One that must be said is not.
    """
    values = {}
    for argument in tree.arguments:
        default = argument.default
        if argument.name in said:
            values[argument.name] = said[argument.name]
        elif default is None:
            raise KeyError(argument.name)
        else:
            values[argument.name] = f"{share}/{default}" if argument.shared else default
    return values


def parameters_of(tree: Tree, process: Process, values: Mapping[str, str]) -> dict[str, Scalar]:
    """Return the parameters of a process, given the values of its tree's arguments."""
    types = {argument.name: argument.type for argument in tree.arguments}
    found: dict[str, Scalar] = {}
    for name, value in process.parameters.items():
        if isinstance(value, Given):
            said = values[value.argument]
            found[name] = f"{said}/{value.inside}" if value.inside else types[value.argument](said)
        else:
            found[name] = value
    return found
