"""The panel in a terminal: what it shows of a state, and that its keys ask what they say."""

from __future__ import annotations

import asyncio
import math
import time
from typing import Any

import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.msg import Fault, Permission, ProcedureState, SessionEvent, State
from calibration_interfaces.srv import LoadApplied
from panel_client import run
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger
from textual.widgets import Static

from calibration.topics import EVENT, STATE
from calibration.web import terminal
from calibration.web.terminal import Terminal


def loading() -> State:
    """A state in which the operator is to pull, and pulls too little."""
    procedure = ProcedureState(
        state=ProcedureState.LOADING, waits_for=ProcedureState.OPERATOR, configuration=7, step=1, steps=4,
        configurations_total=18, configurations_done=6, load_awaited=True, load_felt_known=True, band_force=25.0,
        band_angle=0.1, share_done=0.33, seconds_left=math.nan, load_fault="force: wanted, found: pull harder",
    )  # fmt: skip
    procedure.target.force.z, procedure.load_felt.force.z = -1000.0, -900.0
    permission = Permission(permitted=True, speed=0.0, speed_limit=0.25, speed_point="flange")
    fault = Fault(level=Fault.WARN, code="suspicious", source="configuration 5", text="[5] is odd", remedy="again")
    return State(
        procedure=procedure, procedure_known=True, permission=permission, permission_known=True, faults=[fault],
        text="load of configuration 7", waiting="operator: pull",
    )  # fmt: skip


def test_a_load_is_told_with_what_is_felt() -> None:
    state = loading()
    assert "load: pull with 1000 N, felt: 900 N. force: wanted, found: pull harder" in terminal.described(state)
    state.procedure_known = False
    assert "felt: not known" in terminal.described(state)
    state.procedure.load_awaited = False
    assert "load" not in terminal.described(state).partition("\n")[2]
    state.procedure.load_left = "It was left on by a1."
    assert "It was left on by a1." in terminal.described(state)


def test_the_keys_ask_what_they_say(spinning: Any, until: Any) -> None:
    node, cell = spinning.plain("panel_terminal"), spinning.plain("cell")
    stopped: list[Any] = []
    loads: list[Any] = []
    events: list[Any] = []

    def on_stop(request: Any, response: Any) -> Any:
        stopped.append(request)
        response.success = True
        return response

    def on_load(request: Any, response: Any) -> Any:
        loads.append(request)
        response.outcome.code, response.outcome.text = response.outcome.NOT_REACHED, "pull harder"
        return response

    cell.create_service(Trigger, "sequencer/stop", on_stop)
    cell.create_service(LoadApplied, "sequencer/load_applied", on_load)
    cell.create_subscription(SessionEvent, EVENT.relative, events.append, QoSProfile(depth=10))
    publisher = cell.create_publisher(STATE.message, STATE.relative, STATE.qos)

    async def work() -> None:
        app = Terminal(node, "Ann")
        async with app.run_test() as pilot:

            def said(place: str) -> str:
                return str(app.query_one(f"#{place}", Static).render())

            for _ in range(200):
                publisher.publish(loading())
                await pilot.pause(0.1)
                if "configuration 7" in said("state"):
                    break
            assert "6 of 18" in said("state")
            assert "[5] is odd" in said("state")  # as it came, no markup
            assert said("permission") == "The robot may move"
            assert app.query_one("#permission").has_class("yes")
            await pilot.pause(1.0)
            assert (said("state"), said("permission")) == ("", terminal.SILENT)  # nothing has come for a while
            assert not app.query_one("#permission").has_class("yes")
            for key, found in (("s", stopped), ("c", loads)):
                for _ in range(50):
                    await pilot.press(key)
                    await pilot.pause(0.2)
                    if found:
                        break
                assert found, key
            assert (loads[0].operator_name, loads[0].configuration, loads[0].step) == ("Ann", 7, 1)
            assert "pull harder" in said("answer")

    run(work())
    until(lambda: any("stop by Ann at a terminal" in one.text for one in events))


def test_states_that_arrive_while_it_ends_do_no_harm(spinning: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is shown is taken down in several steps, between which a look and an answer may fall."""
    monkeypatch.setattr(terminal, "LOOK", 0.0005)
    node = spinning.plain("panel_terminal")

    async def work() -> None:
        for _ in range(10):
            app = Terminal(node, "Ann")
            async with app.run_test() as pilot:
                while "configuration 7" not in str(app.query_one("#state", Static).render()):
                    app.cell_shown, app.cell_heard = loading(), time.monotonic()
                    await pilot.pause(0.02)
                asking = asyncio.create_task(app.action_do("stop"))
            await asking

    run(work())
