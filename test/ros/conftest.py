"""The suite as it is installed: real processes, real DDS, real bags, driven from outside."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from calibration_core.files.yaml_file import yaml_text

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(Path(__file__).parent))  # live_tree, middleman
CELL = ROOT / "config" / "cells" / "demo.cell.yaml"
FAST = ROOT / "config" / "simulation.yaml"
SPEED = 20.0  # times real time
FIRST = 3  # configurations of the short plan
LONG = 60.0  # s of wall time, that a process may take to appear on a busy machine
PACKAGES = {"simulated_cell": "calibration_sim"}

# Cells that run at the same time do not take each other's cores.
LANE = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
LANES = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[LANE::LANES])

# Contexts, nodes that spin, and the environment of processes are those of the nodes' own tests.
_specification = importlib.util.spec_from_file_location(
    "of_nodes", ROOT / "src" / "calibration" / "test" / "conftest.py"
)
assert _specification is not None
assert _specification.loader is not None
_of_nodes = importlib.util.module_from_spec(_specification)
_specification.loader.exec_module(_of_nodes)
STEP = 33  # from the domain of one test to that of the next
context, spinning, until = _of_nodes.context, _of_nodes.spinning, _of_nodes.until
source_environment = _of_nodes.source_environment


MARK = "CALIBRATION_TEST"  # in the environment of processes that must not be left behind


def marked(mark: str) -> dict[int, str]:
    """Process ids and command lines of the processes that inherited a mark and still run."""
    found = {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            inherited = f"{MARK}={mark}".encode() in (path / "environ").read_bytes().split(b"\0")
            words = (path / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:  # it ended meanwhile, or is another user's
            continue
        if inherited and words:
            found[int(path.name)] = words
    return found


def left(mark: str) -> list[str]:
    """Command lines of the processes that inherited a mark and still run."""
    return list(marked(mark).values())


class Suite:
    """Processes of one cell, and a client's view of them."""

    def __init__(self, environment: dict[str, str], client: Any, directory: Path, namespace: str = "") -> None:
        self.namespace = namespace
        self.mark = str(uuid.uuid4())
        own = {"ROS_DOMAIN_ID": str(_of_nodes.DOMAIN), MARK: self.mark, "ROS_HOME": str(directory / "ros")}
        self.environment, self.client, self.directory = {**environment, **own}, client, directory
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.given: dict[str, list[str]] = {}
        self.runs: Any = None  # the client that runs are asked for with

    # --- processes ---------------------------------------------------------------------------------------------------

    def start(self, name: str, *files: Path, **parameters: object) -> None:
        """Start an executable of install/ with parameter files and parameters (`__` for dots)."""
        package = PACKAGES.get(name, "calibration")
        command = [str(ROOT / "install" / package / "lib" / package / name), "--ros-args"]
        for file in files:
            command += ["--params-file", str(file)]
        if self.namespace:
            command += ["-r", f"__ns:={self.namespace}", "-r", "/clock:=clock"]
        for key, value in ({"cell": CELL} | parameters).items():
            text = value if isinstance(value, str | Path) else json.dumps(value)
            command += ["-p", f"{key.replace('__', '.')}:={text}"]
        self.given[name] = command
        self.again(name)

    def start_tree(self, tree: Any, more: dict[str, dict[str, object]] | None = None, **said: object) -> None:
        """Start a shipped tree of processes, as launch does; `more` are parameters of single nodes."""
        from tree_runner import TreeRunner

        said = {"cell": CELL, "session": self.session, **said}
        runner = TreeRunner(tree, self.environment, self.directory, more=more, **said)
        for process in tree.processes:
            self.given[process.name] = runner.command(process)
            self.again(process.name)

    def start_fast(
        self,
        speed: float = SPEED,
        seed: int = 1,
        simulated_cell: Mapping[str, object] | None = None,
        tracker: Mapping[str, object] | None = None,
        **sequencer: object,
    ) -> None:
        """Start everything that a measurement needs, faster than life; three nodes with more parameters."""
        more = {"motion_log": self.directory / "motion.log"} | dict(simulated_cell or {})
        self.start("simulated_cell", FAST, speed=speed, seed=seed, **more)
        for name in ("guard", "force_torque"):
            self.start(name, FAST)
        self.start("tracker", FAST, **(tracker or {}))
        self.start("sequencer", FAST, **sequencer)
        self.start("recorder", FAST, out=self.bag)

    def again(self, name: str) -> None:
        """Start an executable as before."""
        with (self.directory / f"{name}.log").open("ab") as log:
            self.processes[name] = subprocess.Popen(
                self.given[name], env=self.environment, stdout=log, stderr=subprocess.STDOUT
            )

    def end(self, name: str, how: signal.Signals = signal.SIGINT) -> tuple[int, float]:
        """End a process; return its exit code and how long that took, s."""
        process = self.processes.pop(name)
        began = time.monotonic()
        process.send_signal(how)
        try:
            return process.wait(LONG), time.monotonic() - began
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            raise

    def stop(self) -> dict[str, int]:
        """End whatever still runs; return the exit codes."""
        for process in self.processes.values():
            process.send_signal(signal.SIGINT)
        codes = {}
        for name, process in self.processes.items():
            try:
                codes[name] = process.wait(LONG)
            except subprocess.TimeoutExpired:
                process.kill()
                codes[name] = process.wait()
        self.processes.clear()
        return codes

    def log(self, name: str) -> str:
        """What a process said."""
        path = self.directory / f"{name}.log"
        return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""

    # --- conversation ------------------------------------------------------------------------------------------------

    def call(self, service: Any, place: str, /, patience: float = 5.0, **fields: Any) -> Any:
        """Call a service, again after `patience` s, for its server may just have been restarted; return the answer."""
        client, missed = self.client.create_client(service, place), 0
        asked: list[Any] = []  # an answer may come late: none is thrown away
        try:
            end = time.monotonic() + LONG
            while time.monotonic() < end:
                if not client.wait_for_service(1.0):
                    missed += 1
                    continue
                asked.append(client.call_async(service.Request(**fields)))
                again = time.monotonic() + patience
                while time.monotonic() < again:
                    for one in asked:
                        if one.done():
                            return one.result()
                    time.sleep(0.005)
        finally:
            self.client.destroy_client(client)
        said = self.log(place.partition("/")[0])[-2000:]
        raise AssertionError(f"{place}: asked {len(asked)} times without an answer, not seen {missed} times\n{said}")

    def fault(self, text: str) -> None:
        """Have the simulated cell misbehave: `KIND [VALUE [POINT]]`, or `NONE` to end all."""
        from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
        from rcl_interfaces.srv import SetParameters

        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text)
        asked = [Parameter(name="fault", value=value)]
        (answer,) = self.call(SetParameters, "simulated_cell/set_parameters", parameters=asked).results
        assert answer.successful, answer.reason

    def run(
        self,
        plan: Path,
        *,
        resume: bool = False,
        session: Path | None = None,
        feedback: Callable[[Any], None] | None = None,
    ) -> Run:
        """Have a plan measured."""
        from calibration_interfaces.action import RunPlan
        from goals import GoalClient

        self.runs = client = self.runs or GoalClient(self.client, RunPlan, "sequencer/run")
        assert client.wait_for_server(LONG), self.log("sequencer")
        self._knock(client)
        goal = RunPlan.Goal(plan=str(plan), session=str(session or self.session), resume=resume)
        end = time.monotonic() + LONG
        sent: list[Any] = []  # an answer may come late: no goal is forgotten
        while time.monotonic() < end:  # a server that was killed looks alive for 20 s, and goals to it are lost
            sent.append(client.send_goal_async(goal, feedback_callback=feedback))
            again = time.monotonic() + 3.0
            while time.monotonic() < again:
                for accepted in sent:
                    if accepted.done() and accepted.result().accepted:
                        return Run(accepted.result(), self)
                time.sleep(0.01)
        raise AssertionError(f"the plan is not accepted\n{self.log('sequencer')[-1500:]}")

    def _knock(self, client: Any) -> None:
        """Ask for a plan that does not exist until that is answered.

        A server that has not found its client yet begins a run and cannot say so ("client will not receive response"):
        a goal that is rejected leaves nothing behind when its answer is lost.
        """
        from calibration_interfaces.action import RunPlan

        asked: list[Any] = []
        end = time.monotonic() + LONG
        while time.monotonic() < end:
            asked.append(client.send_goal_async(RunPlan.Goal(plan=str(self.session / "no plan"))))
            again = time.monotonic() + 1.0
            while time.monotonic() < again:
                if any(one.done() for one in asked):
                    return
                time.sleep(0.01)
        raise AssertionError(f"the sequencer does not answer\n{self.log('sequencer')[-1500:]}")

    def rejected(self, plan: Path) -> str:
        """Send a goal that is not accepted; return the words that are told of it."""
        from calibration_interfaces.action import RunPlan
        from calibration_interfaces.msg import SessionEvent
        from goals import GoalClient

        told: list[str] = []

        def take(event: Any) -> None:
            if event.kind == SessionEvent.REJECTED:
                told.append(event.text)

        listening = self.client.create_subscription(SessionEvent, "calibration/event", take, 1000)
        client = GoalClient(self.client, RunPlan, "sequencer/run")
        assert client.wait_for_server(LONG), self.log("sequencer")
        end = time.monotonic() + LONG
        while not self.client.count_publishers("calibration/event"):
            assert time.monotonic() < end
            time.sleep(0.01)
        answer = client.send_goal_async(RunPlan.Goal(plan=str(plan), session=str(self.session)))
        while not (answer.done() and told):
            assert time.monotonic() < end, self.log("sequencer")
            time.sleep(0.01)
        assert not answer.result().accepted
        client.destroy()
        self.client.destroy_subscription(listening)
        return told[-1]

    @property
    def session(self) -> Path:
        """Directory of the session."""
        return self.directory / "session"

    @property
    def bag(self) -> Path:
        """The bag of the session."""
        return self.session / "bag"


class Run:
    """A plan that is being measured."""

    def __init__(self, handle: Any, suite: Suite) -> None:
        self._handle, self._suite, self._result = handle, suite, handle.get_result_async()

    def result(self, timeout: float) -> Any:
        """Wait for the end; return the result."""
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            if self._result.done():
                return self._result.result().result
            time.sleep(0.01)
        said = "\n".join(f"{name}:\n{self._suite.log(name)[-1500:]}" for name in self._suite.processes)
        raise AssertionError(f"no result within {timeout:.0f} s\n{said}")

    @property
    def over(self) -> bool:
        """Whether there is a result."""
        return bool(self._result.done())

    def cancel(self) -> Any:
        """Cancel it; return the future answer."""
        return self._handle.cancel_goal_async()


@pytest.fixture(autouse=True)
def another_domain() -> None:
    """Be in another domain than the test before: who was killed there is found in the graph for 20 s."""
    before = _of_nodes.OWN
    _of_nodes.OWN = _of_nodes.Domain(1 + (before.number + STEP) % _of_nodes.DOMAINS)
    _of_nodes.DOMAIN = _of_nodes.OWN.number
    before.leave()


@pytest.fixture
def still_running() -> Callable[[str], list[str]]:
    """Processes with a mark."""
    return left


@pytest.fixture
def marked_processes() -> Callable[[str], dict[int, str]]:
    """Processes with a mark, by their ids."""
    return marked


@pytest.fixture
def suite(source_environment: dict[str, str], spinning: Any, tmp_path: Path) -> Iterator[Suite]:
    """No process yet; none is left behind."""
    one = Suite(source_environment, spinning.plain("outside"), tmp_path)
    with contextlib.ExitStack() as ending:
        ending.callback(one.stop)
        yield one
    end = time.monotonic() + LONG
    while remaining := left(one.mark):
        assert time.monotonic() < end, remaining
        time.sleep(0.1)


@pytest.fixture(scope="session")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """18 configurations with four load steps each, start-up cycle, reference and spares."""
    from calibration_core.cell import load_cell
    from calibration_core.planning.feasible.loads import LoadRules
    from calibration_core.planning.loaded import PlanningRules, make_plan
    from calibration_core.planning.plans.plan_file import plan_text

    rules = PlanningRules(load=LoadRules(levels=(0.0, 1 / 3, 2 / 3, 1.0)))
    path = tmp_path_factory.mktemp("plan") / "plan.yaml"
    path.write_text(plan_text(make_plan(load_cell(CELL), rules=rules, seed=1)), encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def brisk_plan(plan: Path) -> Path:
    """The plan with the end of its start-up cycle alone."""
    return changed(plan, "brisk")


@pytest.fixture(scope="session")
def short_plan(plan: Path) -> Path:
    """The first configurations of the plan, with the end of its start-up cycle alone."""
    return changed(plan, "short", configurations=FIRST, expected=None)


def changed(plan: Path, name: str, configurations: int | None = None, **other: Any) -> Path:
    """Write a plan with so many configurations and a short start-up cycle beside another one."""
    content = yaml.safe_load(plan.read_text(encoding="utf-8"))
    content |= {"startup_cycle": content["startup_cycle"][-1:], **other}
    content["configurations"] = content["configurations"][:configurations]
    path = plan.parent / f"{name}.yaml"
    path.write_text(yaml_text(content), encoding="utf-8")
    return path
