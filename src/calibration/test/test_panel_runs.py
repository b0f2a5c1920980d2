"""Runs that are begun at the panel: found late, broken, and under way while the panel ends."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import threading
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from panel_client import client, run

LATE = 4.0  # s, after which a sequencer is there as a whole


@contextlib.asynccontextmanager
async def in_control(panel: Any) -> AsyncIterator[Any]:
    """A page that has entered and has the control."""
    address, token = panel.where()
    async with client(address) as one:
        await one.enter(token)
        await one.ask("control_ask")
        yield one


def test_it_ends_while_a_run_that_was_begun_there_goes_on(
    panel: Any, spinning: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Nothing of the page is left behind, and whoever measures finds the one gone who would take the feedback."""
    from calibration_interfaces.action import RunPlan
    from rclpy.action import ActionServer

    begun, go_on = threading.Event(), threading.Event()

    def measure(handle: Any) -> Any:
        begun.set()
        go_on.wait(20.0)
        handle.succeed()
        return RunPlan.Result()

    other = type(spinning)(spinning.context)
    node = other.plain("sequencer")
    ActionServer(node, RunPlan, "sequencer/run", measure)
    other.start()
    (tmp_path / "plan.yaml").write_text("x", "utf-8")

    async def work() -> None:
        async with in_control(panel) as one:
            asked = {"plan": "plan.yaml", "session": "one", "resume": False}
            assert (await one.ask("run", **asked))[1] == {"done": True, "text": ""}

    run(work())
    try:
        assert begun.wait(10.0)
        panel.stop()
        gc.collect()
        assert "never" not in caplog.text
        assert "pending" not in caplog.text
    finally:
        go_on.set()
        other.stop()


@pytest.mark.parametrize("pages", [1, 3])
def test_it_ends_while_pages_are_open(panel: Any, caplog: pytest.LogCaptureFixture, pages: int) -> None:
    """A page that only looks gets nothing more: no task of a page is left when its loop ends."""

    async def work() -> None:
        address, token = panel.where()
        async with client(address) as one, contextlib.AsyncExitStack() as stack:
            await one.enter(token)
            for _ in range(pages):
                opened = one.http.ws_connect(f"{address}/pages", headers=one.headers())
                await (await stack.enter_async_context(opened)).receive_str()
            await asyncio.to_thread(panel.stop)

    run(work())
    gc.collect()
    assert [one.getMessage() for one in caplog.records if one.name == "asyncio"] == []


def test_work_that_was_begun_in_the_thread_has_ended_when_it_has(caplog: pytest.LogCaptureFixture) -> None:
    """A task ends with its loop, also one that takes a moment to end, and one that another task has begun."""
    from aiohttp import web

    from calibration.web.serving import Door, Serving, listening

    ended = []

    async def inner() -> None:
        try:
            await asyncio.sleep(3600.0)
        finally:
            await asyncio.sleep(0.05)  # what it holds is given back
            ended.append("inner")

    async def outer() -> None:
        held.append(asyncio.create_task(inner()))
        begun.set()
        await asyncio.sleep(3600.0)

    async def nothing() -> None:
        return

    held: list[Any] = []
    begun = threading.Event()
    serving = Serving(web.Application(), listening("127.0.0.1", 0), nothing, Door(print))
    serving.start()
    serving.do(lambda: serving.begin(outer()))
    assert begun.wait(5.0)
    serving.stop()
    assert ended == ["inner"]
    held.clear()
    gc.collect()
    assert [one.getMessage() for one in caplog.records if one.name == "asyncio"] == []


@contextlib.contextmanager
def sequencer(spinning: Any, after: float, measure: Any) -> Iterator[None]:
    """A sequencer of which the graph shows a part at once, and whose action answers some seconds later."""
    from calibration_interfaces.action import RunPlan
    from rclpy.action import ActionServer

    other = type(spinning)(spinning.context)
    node = other.plain("sequencer")
    part = "sequencer/run/_action/send_goal"
    first = node.create_service(RunPlan.Impl.SendGoalService, part, lambda _, answer: answer)

    def whole() -> None:
        later.cancel()
        node.destroy_service(first)
        ActionServer(node, RunPlan, "sequencer/run", measure)

    later = node.create_timer(after, whole)
    other.start()
    try:
        yield
    finally:
        other.stop()


def test_a_run_begins_where_the_sequencer_is_found_late(panel: Any, spinning: Any, tmp_path: Path) -> None:
    """On a busy computer a datagram of the discovery is lost, and sent again after some seconds.

    Who asks a second time meanwhile is told so, and begins no second run.
    """
    from calibration_interfaces.action import RunPlan

    runs = []

    def measure(handle: Any) -> Any:
        runs.append(handle.request.session)
        handle.succeed()
        return RunPlan.Result()

    (tmp_path / "plan.yaml").write_text("x", "utf-8")

    async def work() -> None:
        async with in_control(panel) as one:
            asked = {"plan": "plan.yaml", "session": "one", "resume": False}
            began = time.monotonic()
            assert (await one.ask("run", **asked))[1] == {"done": False, "text": "sequencer/run is not there"}
            assert time.monotonic() - began < LATE  # where no part of it is seen, nobody waits for the rest
            with sequencer(spinning, LATE, measure):
                await asyncio.sleep(0.5)
                first = asyncio.create_task(one.ask("run", **asked))
                await asyncio.sleep(0.5)
                assert (await one.ask("run", **asked))[1] == {"done": False, "text": "a run is being begun"}
                assert (await first)[1] == {"done": True, "text": ""}

    run(work())
    assert len(runs) == 1


def test_a_run_that_is_rejected_says_why(panel: Any, spinning: Any, tmp_path: Path) -> None:
    """A rejected goal carries no words; the sequencer's event of it does, and no other event is taken for it."""
    from calibration_interfaces.action import RunPlan
    from calibration_interfaces.msg import SessionEvent
    from rclpy.action import ActionServer, GoalResponse

    from calibration.topics import EVENT

    node = spinning.plain("sequencer")
    events = node.create_publisher(EVENT.message, EVENT.relative, EVENT.qos)

    def publish(kind: int, text: str) -> None:
        events.publish(SessionEvent(kind=kind, source="sequencer", text=text))

    def judge(request: Any) -> GoalResponse:
        if request.session.endswith("one"):
            publish(SessionEvent.REJECTED, "found a session")
        else:
            publish(SessionEvent.OPERATOR_ACTION, "nothing of this run")
        return GoalResponse.REJECT

    spinning.executor.create_task(
        lambda: ActionServer(node, RunPlan, "sequencer/run", lambda _: RunPlan.Result(), goal_callback=judge)
    )
    (tmp_path / "plan.yaml").write_text("x", "utf-8")

    async def work() -> None:
        async with in_control(panel) as one:
            while events.get_subscription_count() < 1:
                await asyncio.sleep(0.05)
            publish(SessionEvent.REJECTED, "an earlier run")
            for session, why in (("one", "found a session"), ("two", "the goal is rejected")):
                answer = await one.ask("run", plan="plan.yaml", session=session, resume=False)
                assert answer == (200, {"done": False, "text": why})

    run(asyncio.wait_for(work(), 30.0))


def test_what_fails_in_the_executor_is_answered(panel: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A request that cannot be carried out ends, and does not keep the page waiting for ever."""

    def broken(*_: Any, **__: Any) -> Any:
        raise RuntimeError("no client")

    monkeypatch.setattr("calibration.web.link.Server", broken)
    (tmp_path / "plan.yaml").write_text("x", "utf-8")

    async def work() -> None:
        async with in_control(panel) as one:
            asked = {"plan": "plan.yaml", "session": "one", "resume": False}
            for _ in range(2):
                answer = await asyncio.wait_for(one.ask("run", **asked), 10.0)
                assert answer == (200, {"done": False, "text": "RuntimeError: no client"})

    run(work())
