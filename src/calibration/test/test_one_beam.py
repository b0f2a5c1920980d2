"""A tracker with one beam: its drivers against a program of another process, and what is believed of what they say."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.action import Measure
from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import PointRequest
from geometry_msgs.msg import PointStamped
from goals import GoalClient
from sensor_msgs.msg import JointState
from stand_ins import CELL, Feed, finish, measure, overrides
from std_msgs.msg import String

from calibration.conversions import stamp_ns, to_header
from calibration.instruments.acquisition import MeasuringError
from calibration.instruments.drivers import Driver, DriverError, Wait
from calibration.instruments.drivers.line import Line, load_template
from calibration.instruments.drivers.written import Table, Typed
from calibration.instruments.one_beam import OneBeam
from calibration.instruments.stream import Stream
from calibration.instruments.tracker import TrackerNode
from calibration.motion.arrival import ArrivalRules, Joints
from calibration.node import ParameterError
from calibration_core.cell import load_cell
from calibration_core.errors import InputError
from calibration_core.measurement.aim import Aim
from calibration_core.observations.samples import Limits
from calibration_sim.living_cell.one_beam import SEARCH, BeamServer
from calibration_sim.living_cell.one_beam import OneBeam as SimulatedBeam

STAND_IN = Path(__file__).with_name("one_line.py")
PLACE = np.array([2.5, -1.25, 0.5])
Q = np.array([0.1, -0.9, 1.2, 0.3, 0.5, -0.2])
PATIENCE = 2.0  # s that a test gives an answer
ASIDE = np.array([0.0, 0.15, 0.0])  # m, from one reflector to the next


class LateError(Exception):
    """Nobody waits any longer."""


def patience(seconds: float = PATIENCE) -> Wait:
    end = time.monotonic() + seconds

    def wait() -> int:
        if time.monotonic() > end:
            raise LateError
        time.sleep(0.001)
        return time.time_ns()

    return wait


@pytest.fixture
def program() -> Iterator[Callable[..., int]]:
    """Starts the program of a tracker; returns its port."""
    running: list[subprocess.Popen[str]] = []

    def start(places: dict[str, Any] | None = None, faults: dict[str, str] | None = None) -> int:
        given = json.dumps({"places": places or {}, "faults": faults or {}})
        running.append(subprocess.Popen([sys.executable, STAND_IN, given], stdout=subprocess.PIPE, text=True))
        assert running[-1].stdout is not None
        return int(running[-1].stdout.readline())

    yield start
    for one in running:
        one.kill()
        one.communicate()


def line(port: int, template: str = "plain") -> Line:
    return Line(("127.0.0.1", port), load_template(template))


class Lived:
    """The simulated cell's tracker, ten times a second of a time that passes quickly."""

    def __init__(self) -> None:
        self.places = np.array([PLACE, PLACE + ASIDE])
        self.lock, self._over = threading.RLock(), threading.Event()
        self.beam, self.broken = SimulatedBeam(("mp1", "mp2"), lambda: self.places, self.lock), False
        self.server = BeamServer("127.0.0.1:0", self.beam)
        self._thread = threading.Thread(target=self._live)
        self._thread.start()

    def _live(self) -> None:
        for k in itertools.count(1):
            if self._over.wait(0.002):
                return
            with self.lock:
                self.beam.step(0.1 * k)
                if self.beam.target is not None:
                    self.beam.read(None if self.broken else self.places[self.beam.target])

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self.server.close()


@pytest.fixture
def lived() -> Iterator[Lived]:
    one = Lived()
    yield one
    one.close()


# --- line ---------------------------------------------------------------------------------------------------------


def test_a_program_is_asked_to_aim_and_to_measure(program: Callable[..., int]) -> None:
    driver = line(program())
    driver.aim("mp1", PLACE, patience())
    before = time.time_ns()
    found = driver.measure(0.05, patience())
    assert 1 <= len(found) <= 2
    np.testing.assert_allclose(found[0].place, PLACE, atol=1e-6)
    assert found[0].covariance is not None
    np.testing.assert_allclose(np.sqrt(np.diag(found[0].covariance)), [1e-5, 2e-5, 3e-5])
    assert before <= found[0].begin < found[-1].end
    assert found[-1].end - found[0].begin >= 5e7
    driver.close()


def test_the_simulated_tracker_speaks_as_the_template_says(lived: Lived) -> None:
    driver = line(lived.server.server_address[1])
    for name, place in zip(("mp2", "mp1"), lived.places[::-1], strict=True):
        driver.aim(name, place + 0.1 * ASIDE, patience())
        found = driver.measure(0.02, patience())
        np.testing.assert_allclose([one.place for one in found], [place] * len(found), atol=1e-9)
    with pytest.raises(DriverError, match=f"refuses: no reflector within {SEARCH:g} m"):
        driver.aim("mp1", PLACE - 2 * ASIDE, patience())
    with pytest.raises(DriverError, match="refuses: no reflector"):
        driver.aim("mp1", -PLACE, patience())
    with pytest.raises(DriverError, match="refuses: beam broken"):  # it looks at nothing
        driver.measure(0.02, patience())
    driver.aim("mp1", PLACE, patience())
    lived.broken = True
    with pytest.raises(DriverError, match="refuses: beam broken"):
        driver.measure(0.02, patience())
    for word in ("mp3", "mp1 mp1"):
        with pytest.raises(DriverError, match=r"refuses: found .AIM .*, expected AIM POINT X Y Z"):
            driver.aim(word, PLACE, patience())
    with pytest.raises(DriverError, match="refuses: there is no such direction"):
        driver.aim("mp1", 0.0 * PLACE, patience())
    with pytest.raises(InputError, match="expected host:port of this machine that is free"):
        BeamServer(f"127.0.0.1:{lived.server.server_address[1]}", lived.beam)


def test_what_measures_at_once_is_asked_until_the_window_is_over(program: Callable[..., int]) -> None:
    driver = line(program({"mp1": PLACE.tolist()}), "t2sa")
    driver.aim("mp1", PLACE, patience())
    found = driver.measure(0.05, patience())
    assert len(found) >= 2
    np.testing.assert_allclose([one.place for one in found], [PLACE] * len(found), atol=1e-9)
    assert all(a.end == b.begin for a, b in itertools.pairwise(found))
    assert found[0].covariance is None


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("cut", "was lost: it was closed by the other side, within 'POINT mp1 2.'"),
        ("gone", "was lost: it was closed by the other side$"),
        ("garbage", "says '.*what.', expected"),
        ("broken", "refuses: beam broken"),
        ("name", "the answer is about another point: 'POINT other"),
    ],
)
def test_what_is_no_answer_is_told_and_the_next_is_good(program: Callable[..., int], fault: str, words: str) -> None:
    driver = line(program(faults={"mp1": fault}))
    driver.aim("mp1", PLACE, patience())
    with pytest.raises(DriverError, match=words):
        driver.measure(0.01, patience())
    driver.aim("mp1", PLACE, patience())
    np.testing.assert_allclose(driver.measure(0.01, patience())[0].place, PLACE, atol=1e-6)


@pytest.mark.parametrize(("fault", "words"), [("mute", "does not answer"), ("half", "stops within 'POINT mp1 2.'")])
def test_no_answer_is_waited_for_no_longer_than_somebody_wants(
    program: Callable[..., int], fault: str, words: str
) -> None:
    port = program(faults={"mp1": fault})
    driver = line(port)
    driver.aim("mp1", PLACE, patience())
    with pytest.raises(LateError):
        driver.measure(0.01, patience(0.2))
    assert driver.awaited == f"127.0.0.1:{port} {words}"
    driver.aim("mp2", 2 * PLACE, patience())  # the late answer is not taken for this one's
    np.testing.assert_allclose(driver.measure(0.01, patience())[0].place, 2 * PLACE, atol=1e-6)


def test_an_answer_in_pieces_is_one(program: Callable[..., int]) -> None:
    driver = line(program(faults={"mp1": "slow"}))
    driver.aim("mp1", PLACE, patience())
    assert len(driver.measure(0.01, patience())) >= 1


def test_without_a_program_aiming_fails() -> None:
    with pytest.raises(DriverError, match=r"127\.0\.0\.1:1 cannot be reached: "):
        line(1).aim("mp1", PLACE, patience())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "found nothing|found None"),
        ("source: a\nunits: mm\n", "measure: found nothing, expected a value"),
        ("source: a\nunits: ft\nmeasure: {send: M, answer: 'x'}\n", "units: found 'ft', expected one of m, mm, inch"),
        ("source: a\nunits: mm\nmeasure: {send: M, answer: '(?P<x>.)'}\n", r"measure\.answer: .*groups x, y and z"),
        (
            "source: a\nunits: mm\nmeasure: {send: '{w}', answer: 'x'}\n",
            r"measure\.send: found '\{w\}', expected a line",
        ),
        ("source: a\nunits: mm\nmeasure: {send: M, answer: '('}\n", r"measure\.answer: .*a regular expression"),
        ("source: a\nunits: mm\nspeed: 1\nmeasure: {send: M, answer: '(?P<x>.)(?P<y>.)(?P<z>.)'}\n", "an unknown key"),
    ],
)
def test_a_template_without_sense_is_refused(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=words):
        load_template(str(file))


# --- file and manual ----------------------------------------------------------------------------------------------


def appended(file: Path, *texts: str) -> threading.Thread:
    def write() -> None:
        for text in texts:
            with file.open("a") as handle:
                handle.write(text)

    thread = threading.Timer(0.05, write)
    thread.start()
    return thread


@pytest.mark.parametrize(
    ("header", "row", "sigma"),
    [
        ("x,y,z", "2500.0, -1250, 500", None),
        ("point;x;y;z;sx;sy;sz", "mp1;2500,0;-1250,0;500,0;0,01;0,02;0,03", [1e-5, 2e-5, 3e-5]),
        ("z\ty\tx\tpoint\tday", "500\t-1250\t2500\tmp1\tMonday", None),
    ],
)
def test_rows_that_are_appended_are_read(tmp_path: Path, header: str, row: str, sigma: list[float] | None) -> None:
    file = tmp_path / "points.csv"
    old = row.replace("500", "900")
    file.write_text(f"{header}\n{old}\n{old[:5]}")
    driver = Table(file, 1e-3)
    driver.aim("mp1", PLACE, patience())
    thread = appended(file, "\n", row[:7], f"{row[7:]}\n")
    with pytest.raises(DriverError, match="expected "):  # half a row was there before
        driver.measure(0.01, patience())
    thread.join()
    driver.aim("mp1", PLACE, patience())
    thread = appended(file, row[:7], f"{row[7:]}\n")
    found = driver.measure(0.01, patience())
    thread.join()
    np.testing.assert_allclose([one.place for one in found], [PLACE])
    if sigma is not None:
        assert found[0].covariance is not None
        np.testing.assert_allclose(np.diag(found[0].covariance), np.square(sigma))
    with pytest.raises(LateError):
        driver.measure(0.01, patience(0.1))


def test_a_table_may_be_made_after_the_target_was_shown(tmp_path: Path) -> None:
    driver = Table(tmp_path / "points.csv", 1.0)
    driver.aim("mp1", PLACE, patience())
    thread = appended(tmp_path / "points.csv", "x y z\n", "2.5 -1.25 0.5\n")
    np.testing.assert_allclose(driver.measure(0.01, patience())[0].place, PLACE)
    thread.join()


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("mp2,1,2,3", "mp2 stands in .* where mp1 was to be measured"),
        ("mp1,1,two,3", "found 'two', expected a number"),
        ("mp1,1,2", "found 'mp1,1,2', expected point, x, y, z"),
    ],
)
def test_a_row_that_is_none_is_told(tmp_path: Path, row: str, words: str) -> None:
    file = tmp_path / "points.csv"
    file.write_text("point,x,y,z\n")
    driver = Table(file, 1.0)
    driver.aim("mp1", PLACE, patience())
    thread = appended(file, f"{row}\n")
    with pytest.raises(DriverError, match=words):
        driver.measure(0.01, patience())
    thread.join()


def test_a_table_that_was_shortened_is_told(tmp_path: Path) -> None:
    file = tmp_path / "points.csv"
    file.write_text("x,y,z\n1,2,3\n")
    driver = Table(file, 1.0)
    driver.aim("mp1", PLACE, patience())
    file.write_text("x,y,z\n")
    with pytest.raises(DriverError, match="has become shorter"):
        driver.measure(0.01, patience())


@pytest.mark.parametrize("text", ["2500 -1250 500", "mp1; 2500,0; -1250,0; 500,0", " mp1,2500,-1250,5e2\n"])
def test_an_operator_types_three_numbers(text: str) -> None:
    driver = Typed("/tracker/typed", 1e-3)
    assert driver.type("1 2 3") == ""
    driver.aim("mp1", PLACE, patience())  # what was typed before counts no more
    assert driver.type(text) == ""
    np.testing.assert_allclose([one.place for one in driver.measure(0.01, patience())], [PLACE])


@pytest.mark.parametrize("text", ["", "1 2", "2500,0 -1250,0 500,0", "1 2 nan", "mp1 1 2 3 4", "one two three"])
def test_what_is_no_place_is_told_to_who_typed_it(text: str) -> None:
    driver = Typed("/tracker/typed", 1.0)
    assert driver.type(text) == f"found {text!r}, expected three numbers, or a point and three numbers"
    driver.aim("mp1", PLACE, patience())
    with pytest.raises(LateError):
        driver.measure(0.01, patience(0.05))


# --- one point after the other ------------------------------------------------------------------------------------


def standing() -> Joints:
    """Joint states of a robot that stands, and go on."""
    joints = Joints(ArrivalRules())
    start = time.time_ns()
    for k in range(100):
        joints.add(start + k * 10_000_000, Q)
    return joints


def one_beam(driver: Driver, joints: Joints) -> OneBeam:
    return OneBeam(Aim(load_cell(CELL)), driver, joints, 6e-5, "tracker")


def streams(*names: str) -> list[Stream]:
    return [Stream(name, "beam", Limits(largest=(80.0,), gap=1e9), np.inf) for name in names]


def going_on(joints: Joints, seconds: float = PATIENCE) -> Callable[[], Wait]:
    """A turn in which joint states come."""

    def turn() -> Wait:
        wait = patience(seconds)

        def with_joints() -> int:
            joints.add(joints.until + 10_000_000, Q)
            return wait()

        return with_joints

    return turn


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("absent", "aiming at mp2 failed: .* refuses: no reflector found"),
        ("broken", "measuring at mp2 failed: .* refuses: beam broken"),
        ("other", "mp2: a reflector was found 0.30 m from its place, expected at most"),
        ("unit", "mp2 was measured at .* m: implausible"),
        ("nan", "mp2 was measured at .* m: not finite"),
    ],
)
def test_what_cannot_be_the_target_is_told_and_nothing_counts(
    program: Callable[..., int], fault: str, words: str
) -> None:
    joints = standing()
    beam = one_beam(line(program(faults={"mp2": fault})), joints)
    told: list[tuple[float, str]] = []
    asked = streams("mp1", "mp2", "mp3")
    with pytest.raises(MeasuringError, match=words):
        beam.measure(asked, 0.01, 0, going_on(joints), lambda *one: told.append(one))
    assert told == [(0.0, "measuring mp1, then mp2, mp3"), (1 / 3, "measuring mp2, then mp3")]
    means, samples = beam.measure(asked, 0.01, 0, going_on(joints), lambda *_: None)
    assert [mean.name for mean in means] == ["mp1", "mp2", "mp3"]
    assert {stream.name for stream, _ in samples} == {"mp1", "mp2", "mp3"}
    aim = Aim(load_cell(CELL))
    for mean in means:
        np.testing.assert_allclose(mean.average.mean, aim.place(mean.name, Q), atol=1e-6)
        np.testing.assert_allclose(np.diag(mean.average.covariance).max(), 9e-10, rtol=1e-6)
    assert all(a.end <= b.begin for a, b in itertools.pairwise(means))


def test_a_robot_that_moves_or_is_not_heard_is_not_aimed_at(program: Callable[..., int]) -> None:
    joints = standing()
    beam = one_beam(line(program()), joints)
    with pytest.raises(LateError):
        beam.measure(streams("mp1"), 0.01, 0, lambda: patience(0.05), lambda *_: None)
    assert beam.awaited == "no joint states come, and mp1 cannot be aimed at"
    joints.add(joints.until + 10_000_000, Q + 0.01)
    with pytest.raises(MeasuringError, match="mp1: the robot moves"):
        beam.measure(streams("mp1"), 0.01, 0, going_on(joints), lambda *_: None)


# --- the node -----------------------------------------------------------------------------------------------------


def moving(client: Any, node: TrackerNode, feeds: list[Feed]) -> dict[str, Any]:
    """Joint states of a robot that drives half a second, then stands in Q."""
    state: dict[str, Any] = {"from": node.now_ns()}

    def make(_k: int) -> JointState:
        now = node.now_ns()
        share = min((now - state["from"]) / 5e8, 1.0)
        return JointState(header=to_header(now), name=list(node.cell.robot.joints), position=(share * Q).tolist())

    feeds.append(Feed(client.create_publisher(JointState, "joint_states", 100), make, 0.01))
    return state


def test_the_node_measures_two_points_one_after_the_other(
    spinning: Any, feeds: list[Feed], until: Callable[..., None], program: Callable[..., int]
) -> None:
    port = program(faults={"mp2": "absent"})
    given = overrides(driver="line", address=f"127.0.0.1:{port}", timeout=15.0, window=0.15)
    node = spinning.add(TrackerNode(context=spinning.context, parameter_overrides=given))
    client = spinning.plain()
    heard: dict[str, list[PointStamped]] = {"mp1": [], "mp2": []}
    for name, list_of in heard.items():
        client.create_subscription(PointStamped, f"/tracker/{name}", list_of.append, 100)
    moving(client, node, feeds)
    until(lambda: node.joints.arrived(Q))
    asked = Measure.Goal(names=["mp1", "mp2"])
    result = measure(client, "/tracker/measure", asked)
    assert result.outcome.code == Outcome.FAULT
    assert "aiming at mp2 failed" in result.outcome.text
    assert heard == {"mp1": [], "mp2": []}
    goals = GoalClient(client, Measure, "/tracker/measure")
    assert goals.wait_for_server(15.0)
    told: list[str] = []
    handle = finish(goals.send_goal_async(asked, feedback_callback=lambda one: told.append(one.feedback.text)))
    result = finish(handle.get_result_async()).result
    assert result.outcome.code == Outcome.OK, result.outcome.text
    assert told == ["measuring mp1, then mp2", "measuring mp2"]
    aim = Aim(node.cell)
    for one in result.averages:
        np.testing.assert_allclose(one.mean, aim.place(one.name, Q), atol=1e-6)
    first, second = result.averages
    assert stamp_ns(first.end) - stamp_ns(first.begin) >= 150_000_000
    assert stamp_ns(first.end) <= stamp_ns(second.begin)
    until(lambda: all(heard.values()))
    for one in result.averages:
        stamps = [stamp_ns(message.header.stamp) for message in heard[one.name]]
        assert stamp_ns(one.begin) <= min(stamps) <= max(stamps) <= stamp_ns(one.end)


def test_an_operator_is_told_what_to_measure_and_types_it(
    spinning: Any, feeds: list[Feed], until: Callable[..., None]
) -> None:
    given = overrides(driver="manual", units="mm", window=0.1)
    node = spinning.add(TrackerNode(context=spinning.context, parameter_overrides=given))
    client = spinning.plain()
    moving(client, node, feeds)
    typed = client.create_publisher(String, "/tracker/typed", 10)
    until(lambda: node.joints.arrived(Q) and typed.get_subscription_count())
    goals = GoalClient(client, Measure, "/tracker/measure")
    assert goals.wait_for_server(15.0)
    told: list[str] = []
    goal = Measure.Goal(names=["mp3"])
    handle = finish(goals.send_goal_async(goal, feedback_callback=lambda one: told.append(one.feedback.text)))
    until(lambda: told == ["measuring mp3"])
    until(lambda: "nobody has written it" in node.beam.awaited)
    typed.publish(String(data="mp3 one two"))
    place = 1e3 * Aim(node.cell).place("mp3", Q)
    typed.publish(String(data=f"mp3 {place[0]:.4f} {place[1]:.4f} {place[2]:.4f}"))
    result = finish(handle.get_result_async()).result
    assert result.outcome.code == Outcome.OK, result.outcome.text
    np.testing.assert_allclose(result.averages[0].mean, place / 1e3, atol=1e-6)
    assert result.averages[0].samples == 1


def test_an_operator_changes_the_order_and_leaves_a_point_out(
    spinning: Any, feeds: list[Feed], until: Callable[..., None]
) -> None:
    node = spinning.add(
        TrackerNode(context=spinning.context, parameter_overrides=overrides(driver="manual", window=0.05, timeout=60.0))
    )
    client = spinning.plain()
    moving(client, node, feeds)
    typed = client.create_publisher(String, "/tracker/typed", 10)
    asking = client.create_client(PointRequest, "/tracker/point")
    assert asking.wait_for_service(15.0)
    until(lambda: node.joints.arrived(Q) and typed.get_subscription_count())
    skip, repeat, exclude = PointRequest.Request.SKIP, PointRequest.Request.REPEAT, PointRequest.Request.EXCLUDE

    def ask(what: int, point: str = "", name: str = "A. Smith", reason: str = "") -> str:
        request = PointRequest.Request(what=what, point=point, operator_name=name, reason=reason)
        return str(asking.call(request, timeout_sec=10.0).outcome.text)

    assert ask(skip) == "no point is being measured one after the other"
    goals = GoalClient(client, Measure, "/tracker/measure")
    assert goals.wait_for_server(15.0)
    aimed: list[tuple[str, list[str]]] = []

    def hear(message: Any) -> None:
        aimed.append((message.feedback.point, list(message.feedback.left)))

    names = ["mp1", "mp2", "mp3"]
    handle = finish(goals.send_goal_async(Measure.Goal(names=names), feedback_callback=hear))

    def measures(name: str, left: list[str]) -> None:
        until(lambda: aimed[-1:] == [(name, left)])
        until(lambda: node.beam.awaited.startswith(f"{name}: nobody has written it"))

    def write(name: str) -> None:
        typed.publish(String(data=" ".join(f"{one:.7f}" for one in Aim(node.cell).place(name, Q))))

    measures("mp1", ["mp2", "mp3"])
    write("mp1")
    measures("mp2", ["mp3"])
    assert ask(skip, name=" ") == "the name of who answers for it is missing"
    assert ask(exclude) == "the reason is missing: say why the point is left out"
    assert ask(skip, "mp1") == "mp1 is measured already"
    assert ask(skip, "mp4") == "mp4 is not measured in this reading"
    assert ask(skip) == ""
    measures("mp3", ["mp2"])
    assert ask(repeat, "mp1") == ""
    measures("mp1", ["mp3", "mp2"])
    assert ask(exclude, "mp2", reason="the cable hides it") == ""
    write("mp1")
    measures("mp3", [])
    assert ask(skip) == "mp3 is the last one that is left"
    write("mp3")
    result = finish(handle.get_result_async()).result
    assert result.outcome.code == Outcome.OK, result.outcome.text
    assert [one.name for one in result.averages] == ["mp1", "mp3"]
    assert (list(result.excluded), list(result.exclusions)) == (["mp2"], ["by A. Smith: the cable hides it"])
    handle = finish(goals.send_goal_async(Measure.Goal(names=["mp2", "mp3"], timeout=0.5), feedback_callback=hear))
    measures("mp2", ["mp3"])
    assert ask(exclude, reason="hidden") == ""
    assert ask(exclude, "mp3", reason="hidden").startswith("mp3 is the last point of this reading")
    result = finish(handle.get_result_async()).result
    assert (result.outcome.code, list(result.excluded)) == (Outcome.TIMED_OUT, ["mp2"])


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"driver": "radio"}, "driver: found 'radio', expected one of stream, line, emscon, file, manual"),
        ({"driver": "emscon", "address": "700"}, "address: found '700', expected host:port"),
        ({"driver": "line", "address": "here"}, "address: found 'here', expected host:port"),
        ({"driver": "line", "template": "none.yaml"}, "none.yaml: found No such file"),
    ],
)
def test_a_driver_that_cannot_be_made_is_refused(context: Any, values: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        TrackerNode(context=context, parameter_overrides=overrides(**values))
    assert issubclass(ParameterError, InputError)
