"""Nodes in this process: the built messages are found, and every test has a context and a domain of its own."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import importlib.util
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[3]
INTERFACES = ROOT / "install" / "calibration_interfaces"
FOLDER = Path(tempfile.gettempdir()) / f"calibration-{os.getuid()}"  # locks of this user
DOMAINS = 100  # beyond 101 the ports of DDS meet those that the system gives away

# A shell ignores SIGINT in what it starts in its background, `nohup` SIGHUP; so would every process started here.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


class Domain:
    """A ROS domain that no other tests on this machine are in: it is locked while this process holds it.

    Attributes:
        number: 1 to 100.
    """

    def __init__(self, first: int) -> None:
        """Take the first free domain from a number on.

        Raises:
            OSError: All of them are taken.
        """
        FOLDER.mkdir(exist_ok=True)
        for number in (1 + (first - 1 + further) % DOMAINS for further in range(DOMAINS)):
            with contextlib.ExitStack() as stack:
                lock = stack.enter_context((FOLDER / f"test-domain-{number}.lock").open("ab"))
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    continue
                self.number, self._held = number, stack.pop_all()
                return
        raise OSError("every ROS domain of tests is taken on this machine")

    def leave(self) -> None:
        """Let others take it."""
        self._held.close()


# What nodes keep between runs is not this user's own.
HOME = tempfile.TemporaryDirectory(prefix="calibration-test-")
os.environ["ROS_HOME"] = HOME.name

# Whoever imports this module a second time takes a second domain, and what he starts hears nothing of the first.
OWN = Domain(1 + os.getpid() % DOMAINS)
DOMAIN = OWN.number


def _find_messages() -> None:
    """Do for this process what sourcing install/setup.bash does for one that is yet to start.

    The loader reads LD_LIBRARY_PATH at the start only; a library that is loaded already is found by its name.
    """
    python = f"python{sys.version_info.major}.{sys.version_info.minor}"
    sys.path[:0] = [str(INTERFACES / "lib" / python / "site-packages"), str(ROOT / "src" / "calibration")]
    sys.path.insert(0, str(Path(__file__).parent))  # stand_ins
    os.environ["AMENT_PREFIX_PATH"] = os.pathsep.join(
        [str(INTERFACES), *filter(None, [os.environ.get("AMENT_PREFIX_PATH")])]
    )
    left = sorted((INTERFACES / "lib").glob("*.so"))
    if not left or not importlib.util.find_spec("rclpy"):
        return  # the tests say so: see `ros` below
    import rclpy  # noqa: F401  # its libraries are what ours need

    for _ in range(len(left)):
        for library in list(left):
            with contextlib.suppress(OSError):  # one that it needs is not loaded yet
                ctypes.CDLL(str(library), ctypes.RTLD_GLOBAL)
                left.remove(library)


os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
os.environ.setdefault("RCUTILS_LOGGING_USE_STDOUT", "0")
if "calibration_interfaces" not in sys.modules:
    _find_messages()
if importlib.util.find_spec("calibration"):
    from calibration.transport import sockets_only

    sockets_only(os.environ)  # what is killed in a test leaves no shared memory behind


@pytest.fixture(autouse=True)
def home(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What nodes keep between runs is kept for one test alone."""
    path = tmp_path_factory.mktemp("ros")
    monkeypatch.setenv("ROS_HOME", str(path))
    return path


@pytest.fixture
def context() -> Iterator[Any]:
    """A private ROS context on this process's domain."""
    import rclpy
    from rclpy.context import Context

    one = Context()
    rclpy.init(context=one, domain_id=DOMAIN)
    yield one
    one.try_shutdown()


class Spinning:
    """Nodes that are spun in a thread until the test ends."""

    def __init__(self, context: Any) -> None:
        from rclpy.executors import SingleThreadedExecutor

        self.context = context
        self.executor = SingleThreadedExecutor(context=context)
        self.nodes: list[Any] = []
        self.errors: list[BaseException] = []
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def _spin(self) -> None:
        from rclpy.executors import ExternalShutdownException, ShutdownException

        try:
            while not self._ending.is_set():
                self.executor.spin_once()
        except (ExternalShutdownException, ShutdownException):
            return
        except BaseException as error:
            self.errors.append(error)
            raise

    def add(self, node: Any) -> Any:
        self.nodes.append(node)
        self.executor.add_node(node)
        return node

    def plain(self, name: str = "test_client") -> Any:
        """A node of the test itself."""
        import rclpy

        return self.add(rclpy.create_node(name, context=self.context))

    def stop(self) -> None:
        from rclpy.action import ActionClient, ActionServer

        for node in self.nodes:
            if hasattr(node, "stop"):
                node.stop()
        self._ending.set()
        self.executor.create_task(lambda: None)  # wakes it: an executor that is shut down while it spins breaks
        self._thread.join(2.0)
        self.executor.shutdown(timeout_sec=2.0)
        for node in self.nodes:
            for action in [one for one in node.waitables if isinstance(one, ActionClient | ActionServer)]:
                action.destroy()  # a node does not take its actions down: they would be found by the next test
            node.destroy_node()
        assert self.errors == []


@pytest.fixture
def spinning(context: Any) -> Iterator[Spinning]:
    """A place to put nodes: `spinning.add(Node(context=spinning.context, ...))`."""
    one = Spinning(context)
    one.start()
    yield one
    one.stop()


@pytest.fixture
def feeds() -> Iterator[list[Any]]:
    """Publishers of a test that are stopped at its end."""
    running: list[Any] = []
    yield running
    for one in running:
        one.stop()


@pytest.fixture
def until() -> Callable[..., None]:
    """Wait until a condition holds; fail if it does not within some seconds."""

    def wait(condition: Callable[[], object], timeout: float = 20.0, what: str = "") -> None:
        end = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < end, what or "the condition never came true"
            time.sleep(0.005)

    return wait


@pytest.fixture(scope="session")
def source_environment() -> dict[str, str]:
    """The environment of a process after sourcing install/setup.bash, on this process's domain."""
    import subprocess

    setup = ROOT / "install" / "setup.bash"
    if not setup.is_file():
        pytest.skip("the workspace is not built: run make setup")
    command = ["bash", "-c", 'source "$0" && env -0', str(setup)]
    answer = subprocess.run(command, capture_output=True, check=True, timeout=60)
    pairs = (item.split("=", 1) for item in answer.stdout.decode().split("\0") if "=" in item)
    return {**dict(pairs), "ROS_DOMAIN_ID": str(DOMAIN)}


@pytest.fixture
def panel(spinning: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Iterator[Any]:
    """A panel node of this process; `panel.where()` is its address and present token."""
    from panel_client import parameters, printed

    from calibration.panel import PanelNode

    given = parameters(
        cell=str(ROOT / "config" / "cells" / "demo.cell.yaml"), session=str(tmp_path / "session"), port=0
    )
    node = spinning.add(PanelNode(context=spinning.context, parameter_overrides=given))
    text = [capsys.readouterr().out]

    def where() -> tuple[str, str]:
        text.append(capsys.readouterr().out)
        return printed("".join(text))

    node.where = where
    return node
