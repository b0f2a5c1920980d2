"""The processes that the suite consists of: one table, without ROS.

The launch files read it, and so does whoever starts the suite where there is no `launch`.  When a tree is ended, every
process gets SIGINT at once; one that has not ended is sent SIGTERM, then SIGKILL, after the times of its row.  No
process is ended because another one has ended: the others say what they miss, and go on when it is back.  A node that
crashed or was killed is started again; one that was told to end, or refuses what it is given, is not.
"""

from __future__ import annotations

import dataclasses
import os
import signal
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FrameType, MappingProxyType
from typing import Any

from calibration.robot_state import NAMES as ADAPTERS
from calibration_core.cell import load_cell
from calibration_core.errors import InputError, quoted

Scalar = bool | int | float | str

SIGTERM_AFTER = 10.0  # s, from SIGINT; launch gives 5 s by itself, in which a busy computer does not close a bag
SIGKILL_AFTER = 5.0  # s, from SIGTERM
STANDSTILL = 10.0  # s, that whoever stops the robot waits for it to stand, whatever signals say meanwhile
AGAIN_AFTER = 2.0  # s, from the end of a node to its next start: one that crashes at once leaves the others their time
DONE, UNUSABLE = 0, 2  # exit codes: told to end; what was given cannot be used
OUTLIVES = STANDSTILL + 5.0  # s, from SIGINT to SIGTERM, of a process that waits for standstill


@dataclasses.dataclass(frozen=True)
class Argument:
    """What is said when a tree is started.

    Attributes:
        name: Name.
        description: One sentence.
        default: Value if nothing is said; None: it must be said.
        type: Of the value as a parameter.
        choices: The values allowed; empty: any.
        path: What it is the path of, and must be there: a "file", or a "file or directory"; empty: it is no such path.
    """

    name: str
    description: str
    default: str | None = None
    type: type[Scalar] = str
    choices: tuple[str, ...] = ()
    path: str = ""


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
        respawned: Whether it is started again after a crash.
    """

    name: str
    parameters: Mapping[str, Value]
    package: str = "calibration"
    sigterm_after: float = SIGTERM_AFTER
    sigkill_after: float = SIGKILL_AFTER
    respawned: bool = True

    def again(self, code: int) -> bool:
        """Tell whether it is started again after it has ended with an exit code; that of a signal is negative."""
        return self.respawned and code not in (DONE, UNUSABLE)

    @property
    def enclave(self) -> str:
        """Where SROS2 finds what the node may do and who it is; without security it is a name and no more."""
        return f"/calibration/{self.name}"


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
        remappings: Of every node: name, and what it stands for in the cell's namespace.
    """

    arguments: tuple[Argument, ...]
    processes: tuple[Process, ...]
    tools: tuple[Tool, ...] = ()
    remappings: Mapping[str, str] = dataclasses.field(default_factory=lambda: MappingProxyType({}))


STARTED_BY = "CALIBRATION_STARTED_BY"  # in the environment of a node: the process that started it with others
FASTER = "config/simulation.yaml"  # where the cell lives faster than life; in the share folder of `calibration`
CELL = Argument("cell", "The cell file.", path="file")
SESSION = Argument("session", "Directory of the session; one that is there is continued.")
PARAMETERS_FILE = Argument("params_file", "Parameters that differ from their defaults; empty: none.", "", path="file")
NAMESPACE = Argument("namespace", "Namespace of the cell.", "")
BACKENDS = ("follow_joint_trajectory", "joint_trajectory_topic", "external", "simulated")
BACKEND = Argument("backend", "How the robot is moved, and stopped.", "follow_joint_trajectory", choices=BACKENDS)
INTERFACE = Argument("interface", "Action or topic that moves the robot; empty: the back end's usual one.", "")
ADAPTER = Argument("adapter", "How the controller's state is understood.", "industrial", choices=ADAPTERS)
LEVELS = ("debug", "info", "warn", "error", "fatal")
LOG_LEVEL = Argument("log_level", "From which level on the nodes log.", "info", choices=LEVELS)
RATE = Argument("rate", "Multiple of real time.", "1.0", type=float)
SPEED = Argument("speed", "Multiple of real time; above 1, config/simulation.yaml holds.", "1.0", type=float)

SWITCH = ("true", "false")
USE_SIM_TIME = Argument("use_sim_time", "Whether time comes from /clock.", "false", type=bool, choices=SWITCH)
RVIZ = Argument("rviz", "Whether RViz is started, where it is installed.", "false", choices=SWITCH)
TRANSFORMS = "Whether robot_state_publisher is started, where it is installed"
OF_DRIVER = Argument("transforms", f"{TRANSFORMS}; the drivers of most robots bring it.", "false", choices=SWITCH)
OF_US = Argument("transforms", f"{TRANSFORMS}.", "true", choices=SWITCH)

TRACKER = Argument("tracker", "The simulated tracker: one beam, or a stream of all points.", "line",
                   choices=("line", "stream"))  # fmt: skip
ADDRESS = Argument("tracker_address", "Where the one beam is asked: host:port, each cell its own.", "127.0.0.1:7000")

HOST = Argument("host", "Address at which the operator's panel is served; 0.0.0.0: at every one of this machine.",
                "127.0.0.1")  # fmt: skip
PORT = Argument("port", "Its port, or the next one that is free; 0: any.", "8420", type=int)
CELL_FILE = {"cell": Given("cell")}
BAG = {"recording": Given("session", "bag")}


def _suite(everywhere: Mapping[str, Value], motion: Mapping[str, Value], adapter: Value, load: Mapping[str, Value],
           tracker: Mapping[str, Value]) -> tuple[Process, ...]:  # fmt: skip
    """Return the nodes of a cell: who moves the robot and who stops it are told the same way to it."""
    return (
        Process("recorder", {**everywhere, "out": Given("session", "bag")}),
        Process("tracker", {**everywhere, **tracker}),
        Process("force_torque", everywhere),
        Process("guard", {**everywhere, **motion, "robot_state.adapter": adapter}, sigterm_after=OUTLIVES),
        Process("sequencer", {**everywhere, **motion, **load}),
        Process("identification", {**CELL_FILE, **BAG}),
        Process("compensation", CELL_FILE),
        Process("manager", everywhere),
        Process("panel", {**everywhere, "session": Given("session"), "host": Given("host"), "port": Given("port")}),
    )


REAL_CELL = Tree(
    (CELL, SESSION, PARAMETERS_FILE, NAMESPACE, LOG_LEVEL, USE_SIM_TIME, BACKEND, INTERFACE, ADAPTER, HOST,
     PORT, RVIZ, OF_DRIVER),
    _suite({**CELL_FILE, "use_sim_time": Given("use_sim_time")},
           {"motion.backend": Given("backend"), "motion.interface": Given("interface")}, Given("adapter"), {}, {}),
)  # fmt: skip
SIMULATED_CELL = Tree(
    (
        CELL,
        SESSION,
        PARAMETERS_FILE,
        NAMESPACE,
        LOG_LEVEL,
        SPEED,
        Argument("seed", "Of the hidden truth and of the noise.", "1", type=int),
        TRACKER,
        ADDRESS,
        HOST,
        PORT,
        RVIZ,
        OF_US,
    ),
    (
        Process(
            "simulated_cell",
            {
                **CELL_FILE,
                "clock": True,
                "speed": Given("speed"),
                "seed": Given("seed"),
                "tracker": Given("tracker"),
                "tracker_address": Given("tracker_address"),
            },
            package="calibration_sim",
            sigterm_after=OUTLIVES,
            respawned=False,  # it stands for the robot, and its clock would begin anew
        ),
        *_suite(
            {**CELL_FILE, "use_sim_time": True},
            {"motion.backend": "simulated"},
            "native",
            {"load.by": "device"},
            {"driver": Given("tracker"), "address": Given("tracker_address")},
        ),
    ),
    remappings=MappingProxyType({"/clock": "clock"}),  # each cell has its own
)
REPLAY = Tree(
    (
        CELL,
        Argument("recording", "The bag.", path="file or directory"),
        PARAMETERS_FILE,
        NAMESPACE,
        LOG_LEVEL,
        RATE,
        RVIZ,
        OF_US,
    ),
    (Process("identification", {**CELL_FILE, "recording": Given("recording")}),),
    (Tool(("ros2", "bag", "play", Given("recording"), "--clock", "--rate", Given("rate"))),),
)


@dataclasses.dataclass(frozen=True)
class Parent:
    """The process that has started this one with others, and ends it with them: a launch.

    Attributes:
        process: Its number; 0: the node was started by hand, and outlives whoever started it.
        nearest: The parent of this process at its start: the launch, or what it has put in between.
    """

    process: int
    nearest: int

    @classmethod
    def of(cls, environment: Mapping[str, str]) -> Parent:
        """Return the parent that an environment names."""
        text = environment.get(STARTED_BY, "")
        return cls(int(text) if text.isdecimal() else 0, os.getppid())

    def gone(self) -> str:
        """Say that it has ended; empty: it lives, or there is none."""
        if not self.process or (os.getppid() == self.nearest and Path(f"/proc/{self.process}").exists()):
            return ""
        return f"process {self.process}, which started this node, has ended: the node ends what it does, and itself"


def on_end(handler: Callable[[int, FrameType | None], None]) -> dict[int, Any]:
    """Have a function called by every signal that ends a process; return what was called before, by signal.

    A process that was started to outlive its terminal (`nohup`) goes on without it.
    """
    ends = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        ends.append(signal.SIGHUP)
    return {int(number): signal.signal(number, handler) for number in ends}


def values_of(tree: Tree, asked: Mapping[str, str]) -> dict[str, str]:
    """Return the values of a tree's arguments, what is not said by default.

    Args:
        tree: The tree.
        asked: Values by name, in place of the defaults.

    Raises:
        InputError: One that must be said is not, is none of the choices or no number, its file is not there, or the
            cell file cannot be used.
    """
    values = {}
    for argument in tree.arguments:
        value = asked.get(argument.name, argument.default)
        found, expected = _fault(argument, value)
        if value is None or found:
            raise InputError("arguments", argument.name, found, expected)
        values[argument.name] = value
    if CELL.name in values:
        load_cell(values[CELL.name], live=True)  # what is wrong in it is said once, and not by every node
    return values


def _fault(argument: Argument, value: str | None) -> tuple[str, str]:
    """Return what is wrong with a value and what was expected; nothing is found if nothing is wrong."""
    usage = f"{argument.description} Say {argument.name}:=VALUE"
    if value is None or (value == "" and argument.default is None):
        return "nothing", usage
    if argument.choices and value not in argument.choices:
        return quoted(value), f"one of {', '.join(argument.choices)}"
    if argument.type in (int, float):
        try:
            argument.type(value)
        except ValueError:
            return quoted(value), f"a number: {usage}"
    if argument.path and value and not Path(value).exists():
        return f"no {argument.path} {value}", usage
    if argument.path == "file" and value and not Path(value).is_file():
        return f"a directory, {value}", f"a file: {usage}"
    return "", ""


def files_of(values: Mapping[str, str], share: str) -> tuple[str, ...]:
    """Return the parameter files of every node, later ones overrule earlier ones.

    Args:
        values: Of the tree's arguments.
        share: The share folder of the package `calibration`.
    """
    fast = SPEED.name in values and float(values[SPEED.name]) > 1.0
    own = values[PARAMETERS_FILE.name]
    return (*([f"{share}/{FASTER}"] if fast else []), *([own] if own else []))


def parameters_of(tree: Tree, process: Process, values: Mapping[str, str]) -> dict[str, Scalar]:
    """Return the parameters of a process, given the values of its tree's arguments."""
    types = {argument.name: argument.type for argument in tree.arguments}
    found: dict[str, Scalar] = {}
    for name, value in process.parameters.items():
        if isinstance(value, Given):
            asked = values[value.argument]
            found[name] = f"{asked}/{value.inside}" if value.inside else _typed(asked, types[value.argument])
        else:
            found[name] = value
    return found


def _typed(asked: str, kind: type[Scalar]) -> Scalar:
    return asked == SWITCH[0] if kind is bool else kind(asked)
