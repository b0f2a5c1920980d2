"""The whole suite at work: a simulated cell with a concealed fault is measured, identified live, replayed, diagnosed.
A second robot, of which only unloaded postures are known, hides another fault and is diagnosed, too.

    source install/setup.bash && .venv/bin/python .ci/demo.py OUT

Starts the installed executables, has a plan measured, asks the identification service, identifies the recorded bag
once more without ROS, compares the two to the bit, and lets the diagnosis look for what was concealed, of which it
is told nothing.  At its end stands how the cell file's simulation of the
plan becomes the recording, step by step.  No process is left behind, however it ends.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import rclpy
from calibration_interfaces.action import RunPlan
from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import IdentifyStiffness
from rclpy.action import ActionClient
from rclpy.signals import SignalHandlerOptions
from tqdm import tqdm

from calibration.topics import PERMISSION
from calibration.transport import sockets_only
from calibration_core.measurement.messages import RunState
from calibration_core.measurement.session import Session
from calibration_core.timeseries import NANOSECONDS
from calibration_sim.proving.writing import folder_of, open_labels, write_recordings
from calibration_sim.scenarios.grid import grid

ROOT = Path(__file__).resolve().parents[1]
CELL = ROOT / "config" / "cells" / "demo.cell.yaml"
PARAMETERS = ROOT / "config" / "simulation.yaml"
NODES = ("guard", "tracker", "force_torque", "sequencer", "recorder", "identification")
SPEED = 25.0  # times real time, if the machine can
# Concealed: a bearing that tilts, rad/(N*m), of a joint that the plan distinguishes from its neighbours.
EFFECT, JOINT, COMPLIANCE = "off_axis_compliance", "joint_3", 3.0e-7
CHOSEN = ("besides", "heavy", "transmission_error")  # concealed in the second robot: group, robot and effect
CHOSEN_SEED = 1  # by whose lot it has its joint and size
PATIENCE = 300.0  # s
HELD = 30.0  # s, the measurement may wait for a permission; longer than the proof of the stop takes
GRACE = 10.0  # s, a process may take to end
LEVELS = (0.0, 0.333, 0.667, 1.0)  # shares of the full pull, per step
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class DemonstrationError(Exception):
    """The demonstration cannot go on."""


@contextlib.contextmanager
def signals_wait() -> Iterator[None]:
    """Have signals wait for the end of a block; a process that starts in it does not inherit that."""
    arrived: list[int] = []
    before = {number: signal.signal(number, lambda one, _: arrived.append(one)) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for number in arrived:
        signal.raise_signal(number)


def free_port() -> int:
    """Return a port of this machine that nobody serves."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port: int = one.getsockname()[1]
        return port


class Processes:
    """Whatever was started; each in a group of its own, so that what it starts ends with it."""

    def __init__(self) -> None:
        """Nothing is started yet."""
        self._running: list[subprocess.Popen[str]] = []

    def start(self, command: list[str], **streams: Any) -> subprocess.Popen[str]:
        """Start one; a signal that ends the demonstration meanwhile finds it on the list of what has to end."""
        with signals_wait():
            process = subprocess.Popen(command, start_new_session=True, text=True, **streams)
            self._running.append(process)
        return process

    def run(self, command: list[str]) -> str:
        """Run one to its end; return what it prints."""
        process = self.start(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        told, faults = process.communicate()
        self._running.remove(process)
        if process.returncode:
            raise DemonstrationError(f"{' '.join(command)}: {faults.strip()}")
        return told

    def stop(self) -> None:
        """End all, and wait for them; signals have no effect meanwhile."""
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        for process in self._running:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGINT)
        end = time.monotonic() + GRACE
        for process in self._running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(max(0.0, end - time.monotonic()))
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # what is left of its group
            process.wait()
        self._running.clear()


class Cell:
    """The suite's processes, and a node to talk to them."""

    def __init__(self, out: Path, processes: Processes) -> None:
        """Start them."""
        self._out, self._processes = out, processes
        self.session, self.bag = out / "session", out / "session" / "bag"
        concealed = {"speed": SPEED, "concealed_joint": JOINT, "concealed_compliance": COMPLIANCE}
        address = f"127.0.0.1:{free_port()}"
        self._start("calibration_sim", "simulated_cell", concealed | {"tracker": "line", "tracker_address": address})
        own: dict[str, dict[str, object]] = {
            "tracker": {"driver": "line", "address": address},
            "recorder": {"out": self.bag},
            "identification": {"recording": self.bag},
        }
        for name in NODES:
            self._start("calibration", name, own.get(name, {}))
        self._node = rclpy.create_node("demo")
        self._node.create_subscription(PERMISSION.message, PERMISSION.name, self._hear, PERMISSION.qos)
        self._refusal = ""
        self._went_on = time.monotonic()

    def _start(self, package: str, name: str, own: dict[str, object]) -> None:
        command = [str(ROOT / "install" / package / "lib" / package / name), "--ros-args"]
        command += ["--params-file", str(PARAMETERS)]
        for key, value in ({"cell": CELL} | own).items():
            command += ["-p", f"{key}:={value}"]
        with (self._out / f"{name}.log").open("w", encoding="utf-8") as log:
            self._processes.start(command, stdout=log, stderr=subprocess.STDOUT)

    def _hear(self, message: Any) -> None:
        self._refusal = "" if message.permitted else message.text
        if message.latched:
            self._went_on = -math.inf  # what is latched waits for an operator, whom a demonstration does not have

    def _check_held(self) -> None:
        """Raise where the measurement waits for what a demonstration does not have."""
        if time.monotonic() - self._went_on > HELD:
            raise DemonstrationError(
                f"the measurement waits for an operator: {self._refusal or 'motion has to be resumed'}. The simulated "
                f"cell lives up to {SPEED:.0f} times faster than life; other programs may keep this machine too busy "
                "for it. Run the demonstration again when they have ended."
            )

    def _wait(self, future: Any, what: str, check: Callable[[], None] = lambda: None) -> Any:
        end = time.monotonic() + PATIENCE
        while not future.done():
            check()
            if time.monotonic() > end:
                raise DemonstrationError(f"{what}: no answer within {PATIENCE:.0f} s; see {self._out / what}.log")
            rclpy.spin_once(self._node, timeout_sec=0.05)
        return future.result()

    def measure(self, plan: Path) -> Any:
        """Have the plan measured, with a progress bar."""
        client = ActionClient(self._node, RunPlan, "sequencer/run")
        if not client.wait_for_server(60.0):
            raise DemonstrationError(f"the sequencer does not come up: see {self._out / 'sequencer.log'}")
        with tqdm(total=100, desc="measuring", bar_format="{l_bar}{bar}| [{elapsed}{postfix}]") as bar:

            def on_feedback(message: Any) -> None:
                feedback = message.feedback
                if RunState.READY.value not in feedback.text:
                    self._went_on = time.monotonic()
                bar.n = round(100 * feedback.share_done)
                bar.set_postfix_str(f"configuration {feedback.configuration}, step {feedback.step}")

            goal = RunPlan.Goal(plan=str(plan), session=str(self.session))
            self._went_on = time.monotonic()
            handle = self._wait(client.send_goal_async(goal, feedback_callback=on_feedback), "sequencer")
            result = self._wait(handle.get_result_async(), "sequencer", self._check_held).result
            if result.outcome.code != Outcome.OK:
                raise DemonstrationError(result.outcome.text)
            bar.n = 100
            bar.set_postfix_str("")
        return result

    def identify(self, out: Path) -> Any:
        """Ask the service for the joint stiffness."""
        client = self._node.create_client(IdentifyStiffness, "identification/identify_stiffness")
        if not client.wait_for_service(30.0):
            raise DemonstrationError(f"the identification does not come up: see {self._out / 'identification.log'}")
        request = IdentifyStiffness.Request(cell=str(CELL), out=str(out))
        answer = self._wait(client.call_async(request), "identification")
        if answer.outcome.code != Outcome.OK:
            raise DemonstrationError(answer.outcome.text)
        return answer


@contextlib.contextmanager
def stage(what: str) -> Iterator[None]:
    """Say what is being done, and how long it took."""
    print(f"{what} ...", end=" ", flush=True)
    began = time.monotonic()
    yield
    print(f"{time.monotonic() - began:.1f} s", flush=True)


def program(processes: Processes, out: Path, *arguments: object, cell: Path = CELL) -> tuple[str, dict[str, Any]]:
    """Run the program `calibration`, which needs no ROS; return what it prints, and its result."""
    command = [str(Path(sys.executable).parent / "calibration"), *map(str, arguments)]
    told = processes.run([*command, "--cell", str(cell), "--out", str(out)])
    return told, dict(json.loads((out / "result.json").read_text(encoding="utf-8")))


def cell_seconds(session: Path) -> float:
    """Return how long a measurement took by the cell's clock, s."""
    with Session.look(session) as found:
        times = [event.time for event in found.events]
    return (max(times) - min(times)) / NANOSECONDS


def named(found: dict[str, Any], effect: str, joint: str) -> bool:
    """Whether the diagnosis names what was concealed, first."""
    first = next(iter(found["findings"]), {"effect": "", "location": {}})
    return (first["effect"], first["location"]) == (effect, {"joint": joint})


def closes(found: dict[str, Any]) -> bool:
    """Whether the improved simulation leaves what the last step promises, to a tenth."""
    compared = found["comparison"]
    return bool(compared["improved"]["rms"] <= 1.1 * compared["steps"][-1]["rms"])


def show(told: str) -> None:
    """Print what a diagnosis says, less the place of its report."""
    print("".join(f"  {line}\n" for line in told.splitlines() if not line.startswith("report:")), end="")


def unloaded(out: Path, processes: Processes) -> bool:
    """Conceal a fault in a robot of which only postures without load are measured; return whether it is named."""
    scenarios = grid(CHOSEN_SEED)
    hiding = (s for s in scenarios if (s.group, s.robot, s.planned[0].name if s.planned else "") == CHOSEN)
    print("a second robot, postures without load, in which something is concealed", flush=True)
    (name,), digest = write_recordings([next(hiding)], len(scenarios), out, jobs=1)
    print(f"SHA-256 of the label: {digest}")
    folder = folder_of(out, name)
    with stage("diagnosing it, blind"):
        told, found = program(
            processes, out / "diagnose", "diagnose", folder / "measurements.csv", cell=folder / "cell.yaml"
        )
    show(told)
    (truth,) = open_labels(out, digest)[name]["effects"]
    joint, sizes = truth["location"]["joint"], truth["parameters"]
    waves = ", ".join(f"{1e3 * size:.2f} mrad {key.split('_')[1]} times a turn" for key, size in sizes.items())
    print(f"what was concealed: a gear error of {joint} ({truth['effect']}, {waves})")
    right = named(found, truth["effect"], joint)
    print(f"the diagnosis {'names it' if right else 'does NOT name it'}")
    return right


def demonstrate(out: Path, processes: Processes) -> bool:
    """Run everything; return whether live and replayed results are the same and the concealed effects are named."""
    with stage("planning"):
        program(processes, out / "plan", "plan", "--load-levels", *LEVELS)
    cell = Cell(out, processes)
    began = time.monotonic()
    result = cell.measure(out / "plan" / "plan.yaml")
    factor = cell_seconds(cell.session) / (time.monotonic() - began)
    print(f"{result.outcome.text}, {result.readings} readings; {factor:.0f} times faster than life")
    with stage("identifying, by the service"):
        answer = cell.identify(out / "identify")
    for joint, value, std in zip(answer.joints, answer.stiffness, answer.std, strict=True):
        print(f"  {joint:10s} {value / 1e6:8.3f} ± {1.96 * std / 1e6:.3f} 10⁶ N·m/rad (95 %)")
    with stage("identifying the recorded bag, without ROS"):
        _, replayed = program(processes, out / "replay", "identify", cell.bag, "--no-report")
    live = json.loads(answer.result_json)
    same = all(live[key] == replayed[key] for key in live if key != "recording")
    print(f"live and replayed results are {'the same to the bit' if same else 'DIFFERENT'}")
    with stage("simulating the same plan, by the cell file's model"):
        program(processes, out / "simulate", "simulate", "--plan", out / "plan" / "plan.yaml", "--no-report")
    simulation = out / "simulate" / "measurements.csv"
    with stage("diagnosing the recorded bag beside this simulation, blind"):
        told, found = program(processes, out / "diagnose", "diagnose", cell.bag, "--simulation", simulation)
    print(f"what was concealed: a bearing of {JOINT} that tilts ({EFFECT}, {COMPLIANCE:g} rad/(N·m))")
    right = named(found, EFFECT, JOINT)
    print(f"the diagnosis {'names it' if right else 'does NOT name it'}")
    closed = closes(found)
    second = unloaded(out / "second", processes)
    report = Path(answer.report_path)
    end = time.monotonic() + PATIENCE
    while not report.exists():  # drawn after the answer
        if time.monotonic() > end:
            raise DemonstrationError(f"{report} is not drawn; see {out / 'identification.log'}")
        time.sleep(0.1)
    reports = (("plan", out / "plan"), ("stiffness", report.parent), ("second robot", out / "second" / "diagnose"))
    for what, path in reports:
        print(f"report, {what}: {path / 'report.html'}")
    print("the first robot, from its simulation to the noise:")
    show(told)
    print(f"open {out / 'diagnose' / 'report.html'}")
    return same and right and second and closed


def leave(number: int, _frame: object) -> None:
    """End by a signal, in order."""
    raise SystemExit(128 + number)


def main() -> int:
    """Run the demonstration; 0 if live and replayed results are the same to the bit and both diagnoses are right."""
    parser = argparse.ArgumentParser(description="Measure a simulated cell with everything that a real one needs.")
    parser.add_argument("out", type=Path, help="directory, replaced")
    out = parser.parse_args().out.resolve()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ["ROS_HOME"] = str(out / "ros")  # what nodes keep between runs
    sockets_only(os.environ)
    for number in SIGNALS:
        signal.signal(number, leave)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    processes = Processes()
    try:
        return 0 if demonstrate(out, processes) else 1
    except DemonstrationError as failure:
        print(f"\n{failure}", file=sys.stderr)
        return 1
    finally:
        processes.stop()
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
