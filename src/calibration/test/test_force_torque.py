"""The node `force_torque`: what comes out is in SI units with the sign of recordings; tare and test."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.action import Measure
from calibration_interfaces.msg import Outcome, SampleCheck, TareEvent
from calibration_interfaces.srv import SelfTest, Tare
from geometry_msgs.msg import (
    Wrench,
    WrenchStamped,
)
from sensor_msgs.msg import JointState
from stand_ins import CELL, IRREGULAR, Feed, call, finish, measure, overrides, unloaded

from calibration.conversions import stamp_ns, to_header, to_wrench, wrench_values
from calibration.instruments.force_torque import ForceTorqueNode
from calibration_core.cell import load_cell
from calibration_core.identification.checks.sensor_test import gravity_in_sensor
from calibration_core.measurement.unloaded import LoadMemory

LOAD = np.array([100.0, -200.0, -1500.0, 10.0, 20.0, -30.0])


@pytest.mark.parametrize(
    ("kind", "sign", "unit"),
    [
        ("WrenchStamped", "applied_on_robot", "N"),
        ("WrenchStamped", "applied_by_robot", "kN"),
        ("Wrench", "applied_by_robot", "N"),
    ],
)
def test_the_wrench_comes_out_in_si_with_the_contracts_sign(
    spinning: Any, feeds: list[Feed], until: Callable[..., None], kind: str, sign: str, unit: str
) -> None:
    node = spinning.add(
        ForceTorqueNode(context=spinning.context, parameter_overrides=overrides(
            input_type=kind, sign=sign, force_unit=unit, output_frame="ft"))
    )  # fmt: skip
    client = spinning.plain()
    heard: list[WrenchStamped] = []
    client.create_subscription(WrenchStamped, "/force_torque/wrench", heard.append, 100)
    factor = -1.0 if sign == "applied_by_robot" else 1.0
    scale = np.repeat([1e-3 if unit == "kN" else 1.0, 1.0], 3)
    publisher = client.create_publisher(Wrench if kind == "Wrench" else WrenchStamped, "input/wrench", 100)

    def make(k: int) -> Any:
        wrench = to_wrench(factor * scale * (LOAD + 0.01 * (k % 7)))
        return wrench if kind == "Wrench" else WrenchStamped(header=to_header(node.now_ns(), "x"), wrench=wrench)

    feeds.append(Feed(publisher, make))
    until(lambda: len(heard) >= 10)
    rest = wrench_values(heard[-1].wrench) - LOAD
    assert 0.0 <= rest.min() <= rest.max() <= 0.0601
    assert heard[-1].header.frame_id == "ft"
    assert abs(stamp_ns(heard[-1].header.stamp) - node.now_ns()) < 5e9


def noisy(node: Any, level: np.ndarray, rng: np.random.Generator) -> WrenchStamped:
    wrench = to_wrench(level + 0.1 * rng.standard_normal(6))
    return WrenchStamped(header=to_header(node.now_ns(), "ft"), wrench=wrench)


@pytest.mark.parametrize("topic", ["input/wrench", "force_torque/wrench"])
def test_of_two_that_publish_the_wrench_none_is_read(
    spinning: Any, feeds: list[Feed], until: Callable[..., None], topic: str
) -> None:
    given = overrides(gap=IRREGULAR)
    node = spinning.add(ForceTorqueNode(context=spinning.context, parameter_overrides=given))
    first, second = (spinning.plain(name) for name in ("driver", "old_driver"))
    heard: list[SampleCheck] = []
    first.create_subscription(SampleCheck, "/calibration/sample_check", heard.append, 100)
    rng = np.random.default_rng(4)
    publisher = first.create_publisher(WrenchStamped, "input/wrench", 100)
    feeds.append(Feed(publisher, lambda _: noisy(node, LOAD, rng)))
    until(lambda: heard and heard[-1].problem == SampleCheck.FINE)
    second.create_publisher(WrenchStamped, topic, 100)
    until(lambda: heard[-1].problem == SampleCheck.TWO_SOURCES)
    result = measure(first, "/force_torque/measure", Measure.Goal())
    assert result.outcome.code == Outcome.NOT_AVAILABLE
    assert f"/{topic} is published by " in result.outcome.text
    assert "/old_driver" in result.outcome.text


def test_tare_is_subtracted_logged_and_taken_back(spinning: Any, feeds: list[Feed], until: Callable[..., None]) -> None:
    node = spinning.add(ForceTorqueNode(context=spinning.context, parameter_overrides=overrides()))
    client = spinning.plain()
    tares: list[TareEvent] = []
    client.create_subscription(TareEvent, "/calibration/tare", tares.append, 10)
    service = client.create_client(Tare, "/force_torque/tare")
    answer = call(service, Tare.Request(timeout=0.3))
    assert answer.outcome.code == Outcome.NO_DATA
    rng = np.random.default_rng(3)
    feeds.append(Feed(client.create_publisher(WrenchStamped, "input/wrench", 100), lambda _k: noisy(node, LOAD, rng)))
    answer = call(service, Tare.Request(requested_by="A. Operator", reason="start"))
    assert answer.outcome.code == Outcome.OK, answer.outcome.text
    assert answer.event.number == 1
    np.testing.assert_allclose(wrench_values(answer.event.bias), LOAD, atol=0.2)
    result = measure(client, "/force_torque/measure", Measure.Goal())
    np.testing.assert_allclose(result.averages[0].mean, np.zeros(6), atol=0.2)
    assert result.averages[0].tare == 1
    answer = call(service, Tare.Request(requested_by="A. Operator"))
    assert answer.outcome.code == Outcome.OK, answer.outcome.text
    np.testing.assert_allclose(wrench_values(answer.event.bias), LOAD, atol=0.2)  # of the raw wrench, not on top
    answer = call(service, Tare.Request(clear=True, requested_by="A. Operator"))
    assert (answer.outcome.code, answer.event.number) == (Outcome.OK, 0)
    result = measure(client, "/force_torque/measure", Measure.Goal())
    np.testing.assert_allclose(result.averages[0].mean, LOAD, atol=0.2)
    until(lambda: [one.number for one in tares] == [1, 2, 0])
    assert tares[0].requested_by == "A. Operator"


def test_a_tare_under_load_is_refused(
    spinning: Any, feeds: list[Feed], until: Callable[..., None], tmp_path: Path
) -> None:
    """By what was proven unloaded, and where that does not tell, by what is kept of the load; a name overrides."""
    memory = LoadMemory(unloaded(tmp_path))
    given = overrides(load_memory=str(memory.path))
    node = spinning.add(ForceTorqueNode(context=spinning.context, parameter_overrides=given))
    client = spinning.plain()
    rng, now = np.random.default_rng(3), {"load": LOAD}
    publisher = client.create_publisher(WrenchStamped, "input/wrench", 100)
    feeds.append(Feed(publisher, lambda _k: noisy(node, now["load"], rng)))
    service = client.create_client(Tare, "/force_torque/tare")
    memory.loading("configuration 3, step 1 of s1")
    answer = call(service, Tare.Request(requested_by="A. Smith"))
    assert answer.outcome.code == Outcome.NOT_REACHED
    assert answer.outcome.text.startswith("a load may be on since configuration 3, step 1 of s1; no tare is taken")
    memory.released()
    joints = client.create_publisher(JointState, "joint_states", 10)
    names = list(load_cell(CELL).robot.joints)
    feeds.append(Feed(joints, lambda _k: JointState(name=names, position=[0.1] * 6), 0.01))
    until(lambda: node.joints.latest is not None)
    answer = call(service, Tare.Request(requested_by="A. Smith"))
    assert answer.outcome.code == Outcome.NOT_REACHED
    assert re.match(r"15\d\d N pull at the tool in all, .*; no tare is taken under load", answer.outcome.text)
    assert call(service, Tare.Request(override=True)).outcome.code == Outcome.NOT_REACHED  # without a name
    answer = call(service, Tare.Request(override=True, requested_by="A. Smith", reason="another tool"))
    assert (answer.outcome.code, answer.event.number) == (Outcome.OK, 1)
    now["load"] = np.zeros(6)
    answer = call(service, Tare.Request(requested_by="A. Smith"))
    assert (answer.outcome.code, answer.event.number) == (Outcome.OK, 2)


def test_two_tares_at_once(spinning: Any, feeds: list[Feed]) -> None:
    node = spinning.add(ForceTorqueNode(context=spinning.context, parameter_overrides=overrides(window=0.5)))
    client = spinning.plain()
    rng = np.random.default_rng(4)
    feeds.append(Feed(client.create_publisher(WrenchStamped, "input/wrench", 100), lambda _k: noisy(node, LOAD, rng)))
    service = client.create_client(Tare, "/force_torque/tare")
    assert service.wait_for_service(15.0)
    both = [service.call_async(Tare.Request()) for _ in range(2)]
    codes = sorted(finish(one).outcome.code for one in both)
    assert codes == [Outcome.OK, Outcome.BUSY]


def test_a_stream_on_the_contracts_topic_cannot_be_tared(spinning: Any) -> None:
    spinning.add(ForceTorqueNode(context=spinning.context, parameter_overrides=overrides(topic="force_torque/wrench")))
    answer = call(spinning.plain().create_client(Tare, "/force_torque/tare"), Tare.Request())
    assert answer.outcome.code == Outcome.NOT_AVAILABLE


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_self_test(spinning: Any, feeds: list[Feed], until: Callable[..., None], sign: float) -> None:
    cell = load_cell(CELL)
    given = overrides(gap=IRREGULAR, min_samples=3)
    node = spinning.add(ForceTorqueNode(context=spinning.context, parameter_overrides=given))
    client = spinning.plain()
    service = client.create_client(SelfTest, "/force_torque/self_test")
    bias = np.array([5.0, -3.0, 10.0, 0.5, 0.2, -0.1])
    rng = np.random.default_rng(5)
    now: dict[str, np.ndarray] = {"q": np.zeros(6)}

    def wrench(_k: int) -> Any:
        force = sign * 20.0 * gravity_in_sensor(cell, now["q"])
        return noisy(node, np.concatenate([force, np.cross([0.0, 0.0, 0.1], force)]) + bias, rng)

    joints = client.create_publisher(JointState, "joint_states", 10)
    heard: list[WrenchStamped] = []
    client.create_subscription(WrenchStamped, "/force_torque/wrench", heard.append, 100)
    feeds.append(Feed(client.create_publisher(WrenchStamped, "input/wrench", 100), wrench))
    assert call(service, SelfTest.Request(command=SelfTest.Request.ADD)).outcome.code == Outcome.NO_DATA

    def state(_k: int) -> Any:
        now["q"] = now["q"] + now.get("turns", 0.0)
        header = to_header(node.now_ns())
        return JointState(header=header, name=list(cell.robot.joints), position=now["q"].tolist())

    feeds.append(Feed(joints, state, 0.01))
    for k, q in enumerate(np.random.default_rng(6).uniform(-1.5, 1.5, (4, 6))):
        now["q"] = q
        turned = node.now_ns()
        until(lambda q=q: np.array_equal(node.joints.latest, q))
        until(lambda turned=turned: sum(stamp_ns(one.header.stamp) > turned for one in heard[-9:]) > 1)
        answer = call(service, SelfTest.Request(command=SelfTest.Request.ADD))
        assert (answer.outcome.code, answer.orientations) == (Outcome.OK, k + 1), answer.outcome.text
    answer = call(service, SelfTest.Request(command=SelfTest.Request.EVALUATE, mass=20.0))
    assert answer.sign == sign
    assert answer.mass == pytest.approx(20.0, abs=0.05)
    np.testing.assert_allclose(answer.bias, bias, atol=0.3)
    assert answer.outcome.code == (Outcome.OK if sign > 0 else Outcome.TEST_FAILED)
    assert ("sign is reversed" in answer.outcome.text) is (sign < 0)
    now["turns"] = np.array([1e-3, 0.0, 0.0, 0.0, 0.0, 0.0])  # rad at a sample, about the vertical
    answer = call(service, SelfTest.Request(command=SelfTest.Request.ADD))
    assert (answer.outcome.code, answer.orientations) == (Outcome.NOT_SETTLED, 4)
    assert "joint_1 moved by " in answer.outcome.text
    answer = call(service, SelfTest.Request(command=SelfTest.Request.EVALUATE, mass=0.0))
    assert answer.outcome.code == Outcome.INPUT_UNUSABLE
    assert call(service, SelfTest.Request(command=9)).outcome.code == Outcome.INPUT_UNUSABLE
    assert call(service, SelfTest.Request(command=SelfTest.Request.CLEAR)).orientations == 0
    answer = call(service, SelfTest.Request(command=SelfTest.Request.EVALUATE, mass=20.0))
    assert answer.outcome.code == Outcome.NOT_IDENTIFIABLE
