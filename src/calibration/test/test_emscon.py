"""Driver `emscon` against a stand-in of another process, which was laid out by itself after the vendor's header."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.action import Measure
from calibration_interfaces.msg import Outcome
from geometry_msgs.msg import PointStamped
from stand_ins import Feed, measure, overrides
from test_one_beam import PLACE, LateError, Q, going_on, moving, one_beam, patience, standing, streams
from tpi_tracker import COVARIANCES, SIGMA, result

from calibration.instruments.acquisition import MeasuringError
from calibration.instruments.drivers import DriverError
from calibration.instruments.drivers.emscon import Emscon, reason
from calibration.instruments.tracker import TrackerNode
from calibration_core.measurement.aim import Aim

STAND_IN = Path(__file__).with_name("tpi_tracker.py")
WINDOW = 0.02
AIM, START, STOP = "55", "49", "52"


def number(packet: str) -> str:
    return packet if packet == "closed" else str(int.from_bytes(bytes.fromhex(packet)[8:12], "little"))


class Tracker:
    """The stand-in, and the packets that it has got so far."""

    def __init__(self, faults: dict[str, str] | None = None, **state: int) -> None:
        given = json.dumps({"faults": faults or {}, "state": state})
        self.process = subprocess.Popen([sys.executable, STAND_IN, given], stdout=subprocess.PIPE, text=True)
        self.port = int(self.next())

    def next(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    def until(self, end: str) -> list[str]:
        """Return the numbers of the commands before one, or before the connection was closed."""
        return [] if (one := number(self.next())) == end else [one, *self.until(end)]

    def driver(self) -> Emscon:
        return Emscon(("127.0.0.1", self.port))


@pytest.fixture
def tracker() -> Iterator[Callable[..., Tracker]]:
    running: list[Tracker] = []

    def start(*given: Any, **state: int) -> Tracker:
        running.append(Tracker(*given, **state))
        return running[-1]

    yield start
    for one in running:
        one.process.kill()
        one.process.communicate()


def measured(driver: Emscon) -> np.ndarray:
    driver.aim("mp1", PLACE, patience())
    (seen,) = driver.measure(WINDOW, patience())
    return seen.place


# --- what it says and does ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("piece", [0, 1, 7])
def test_whatever_was_set_before_a_place_is_one_of_the_tracker_in_metres(
    tracker: Callable[..., Tracker], piece: int
) -> None:
    stand_in = tracker(piece=piece)
    driver = stand_in.driver()
    driver.aim("mp1", PLACE, patience())
    before = time.time_ns()
    (seen,) = driver.measure(0.1, patience())
    np.testing.assert_array_equal(seen.place, PLACE)
    assert before <= seen.begin < seen.end <= time.time_ns()
    assert seen.end - seen.begin >= 1e8  # as long as was asked
    xy, xz, yz = COVARIANCES
    expected = np.diag(np.square(SIGMA)) + np.array([[0, xy, xz], [xy, 0, yz], [xz, yz, 0]])
    assert seen.covariance is not None
    np.testing.assert_allclose(seen.covariance, expected, rtol=1e-12)
    np.testing.assert_array_equal(measured(driver), PLACE)
    driver.close()
    commands = stand_in.until("closed")
    assert STOP not in commands
    first, second = (commands[a + 1 :] for a, one in enumerate(commands) if one == AIM)
    assert {"5", "26", "47", "24", "80"} & {*first, *second} == set()  # what is right is not set again
    assert first.count("28") == 2  # two windows


@pytest.mark.parametrize(
    ("fault", "sigma"), [("plain", True), ("first", True)], ids=["without covariances", "before its acknowledgement"]
)
def test_a_result_of_either_kind_and_in_either_order_is_read(
    tracker: Callable[..., Tracker], fault: str, sigma: bool
) -> None:
    driver = tracker({START: fault}).driver()
    driver.aim("mp1", PLACE, patience())
    (seen,) = driver.measure(WINDOW, patience())
    np.testing.assert_array_equal(seen.place, PLACE)
    assert seen.covariance is not None
    np.testing.assert_allclose(np.sqrt(np.diag(seen.covariance)), SIGMA)
    assert (seen.covariance[0, 1] == 0.0) == (fault == "plain")  # errors of pointing are no covariances
    np.testing.assert_array_equal(measured(driver), PLACE)


def test_the_bytes_are_those_of_the_vendors_structures(tracker: Callable[..., Tracker]) -> None:
    """As a C compiler lays out GoPositionCT and the results of TPI V3.6, for x86 and with 4-byte long."""
    stand_in = tracker()
    driver = stand_in.driver()
    driver.aim("mp1", PLACE, patience())
    driver.close()
    packets = iter(stand_in.next, "closed")
    assert "2800000000000000370000000000000000000440000000000000f4bf000000000000e03f01000000" in packets
    assert result([1.0, 2.0, 3.0])[:28].hex() == "cc00000009000000000000000000000000000000000000000000f03f"
    assert result([1.0, 2.0, 3.0], extended=False)[:12].hex() == "9c0000000200000000000000"


# --- what is refused ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ({"processor": 4}, "is not initialized: do that with its own program"),
        ({"processor": 0}, "is not initialized"),
        ({"laser": 2}, "warms up its laser: wait"),
    ],
)
def test_a_tracker_that_is_not_ready_is_told(
    tracker: Callable[..., Tracker], state: dict[str, int], words: str
) -> None:
    stand_in = tracker(**state)
    with pytest.raises(DriverError, match=words):
        stand_in.driver().aim("mp1", PLACE, patience())
    assert stand_in.until("closed") == ["1"]  # nothing was set, and it did not move


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ({AIM: "absent"}, "refuses to look for a reflector there: status 1234 of the tracker's list; look at beam and"),
        ({AIM: "1"}, "refuses to look for a reflector there: it is busy with another command"),
        ({"1": "38"}, "refuses to state how it is: no tracker is connected to its controller"),
        ({"5": "kept"}, r"keeps its units: found \[1, 1, 1, 3, 0\], expected \[0, 0, 0, 3, 0\]"),
        ({"26": "kept"}, r"keeps its coordinate system: found \[7\], expected \[0\]"),
        ({"47": "kept"}, r"keeps its system settings: found \[2, 1, 1, 1, 0, 1, 1, 1, 0\], expected \[2, 0, 0, 1, 1,"),
        ({"24": "2"}, "refuses to set its measurement mode: status 2"),
        ({"6": "short"}, "answers 32 bytes when asked to state its units: another version"),
    ],
)
def test_what_cannot_be_aimed_is_told_and_the_next_is_good(
    tracker: Callable[..., Tracker], faults: dict[str, str], words: str
) -> None:
    driver = tracker(faults).driver()
    with pytest.raises(DriverError, match=words):
        driver.aim("mp1", PLACE, patience())
    np.testing.assert_array_equal(measured(driver), PLACE)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("10012", "does not measure: it is not warmed up"),
        ("broken", "says: the beam is broken, or the tracker is not ready"),
        ("error", "does not measure: status 1234 of the tracker's list; look at beam and reflector"),
        ("none", "does not measure: there is no result: the beam was broken, or the target moved"),
        ("status", "does not measure: there is no result"),
        ("closing", "says: it is being shut down"),
        ("sixd", "measures in mode 6, expected 0"),
        ("longer", "states a result of 212 bytes, expected 204: another version"),
        ("shorter", "states a result of 196 bytes, expected 204: another version"),
        ("odd", "states deviations and covariances that cannot be"),
        ("units", "another program changed the units of .* meanwhile"),
        ("cut", "was lost: it was closed by the other side, within a packet, after 100 bytes"),
        ("gone", "was lost: it was closed by the other side$"),
        ("negative", "sends a packet of -5 bytes: it does not speak as an emScon server"),
        ("huge", "sends a packet of 2147483647 bytes"),
        ("tiny", "sends a packet of 8 bytes"),
        ("big-endian", "sends a packet of -872415232 bytes"),
        ("text", "sends a packet of 1330795077 bytes"),
    ],
)
def test_what_is_no_result_is_told_and_the_next_is_good(
    tracker: Callable[..., Tracker], fault: str, words: str
) -> None:
    stand_in = tracker({START: fault})
    driver = stand_in.driver()
    driver.aim("mp1", PLACE, patience())
    with pytest.raises(DriverError, match=words) as caught:
        driver.measure(WINDOW, patience())
    assert "\n" not in str(caught.value)
    np.testing.assert_array_equal(measured(driver), PLACE)  # by a new connection


@pytest.mark.parametrize("fault", ["mute", "flood"])
def test_what_nobody_waits_for_any_longer_is_ended(tracker: Callable[..., Tracker], fault: str) -> None:
    stand_in = tracker({START: fault})
    driver = stand_in.driver()
    driver.aim("mp1", PLACE, patience())
    with pytest.raises(LateError):
        driver.measure(WINDOW, patience(0.3))
    assert driver.awaited == f"127.0.0.1:{stand_in.port} states no result"
    stand_in.until(STOP)
    stand_in.until("closed")
    np.testing.assert_array_equal(measured(driver), PLACE)


def test_an_error_that_nobody_asked_for_is_told_while_the_answer_is_missing(tracker: Callable[..., Tracker]) -> None:
    driver = tracker({AIM: "silent"}).driver()
    with pytest.raises(LateError):
        driver.aim("mp1", PLACE, patience(0.3))
    assert driver.awaited == f"{driver.name} does not answer, but says: {reason(1234)}"
    np.testing.assert_array_equal(measured(driver), PLACE)


def test_without_a_tracker_aiming_fails() -> None:
    with pytest.raises(DriverError, match=r"127\.0\.0\.1:1 cannot be reached: "):
        Emscon(("127.0.0.1", 1)).aim("mp1", PLACE, patience())


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ({AIM: "absent"}, "aiming at mp1 failed: .* refuses to look for a reflector there"),
        ({START: "other"}, "mp1: a reflector was found 0.30 m from its place, expected at most"),
        ({START: "unit"}, "mp1 was measured at .* m: implausible"),
        ({START: "nan"}, "mp1 was measured at .* m: not finite"),
    ],
)
def test_what_cannot_be_the_target_does_not_count(
    tracker: Callable[..., Tracker], faults: dict[str, str], words: str
) -> None:
    joints = standing()
    beam = one_beam(tracker(faults).driver(), joints)
    with pytest.raises(MeasuringError, match=words):
        beam.measure(streams("mp1", "mp2"), WINDOW, 0, going_on(joints), lambda *_: None)
    means, samples = beam.measure(streams("mp1", "mp2"), WINDOW, 0, going_on(joints), lambda *_: None)
    assert [mean.name for mean in means] == ["mp1", "mp2"]
    assert len(samples) == 2
    for mean in means:
        np.testing.assert_allclose(np.sqrt(np.diag(mean.average.covariance)), SIGMA, rtol=1e-9)


# --- the node -----------------------------------------------------------------------------------------------------


def test_the_node_measures_by_the_trackers_own_interface(
    spinning: Any, feeds: list[Feed], until: Callable[..., None], tracker: Callable[..., Tracker]
) -> None:
    stand_in = tracker({START: "broken"})
    given = overrides(driver="emscon", address=f"127.0.0.1:{stand_in.port}", timeout=15.0, window=0.15)
    node = spinning.add(TrackerNode(context=spinning.context, parameter_overrides=given))
    client = spinning.plain()
    heard: list[PointStamped] = []
    client.create_subscription(PointStamped, "/tracker/mp1", heard.append, 100)
    moving(client, node, feeds)
    until(lambda: node.joints.arrived(Q))
    asked = Measure.Goal(names=["mp1", "mp2"])
    refused = measure(client, "/tracker/measure", asked)
    assert refused.outcome.code == Outcome.FAULT
    assert "measuring at mp1 failed: " in refused.outcome.text
    assert "the beam is broken" in refused.outcome.text
    assert heard == []
    done = measure(client, "/tracker/measure", asked)
    assert done.outcome.code == Outcome.OK, done.outcome.text
    aim = Aim(node.cell)
    for one in done.averages:
        np.testing.assert_allclose(one.mean, aim.place(one.name, Q), atol=1e-6)
    until(lambda: len(heard) == 1)
    node.on_end()
    stand_in.until("closed")  # of the broken beam
    assert STOP not in stand_in.until("closed")  # the node's end
