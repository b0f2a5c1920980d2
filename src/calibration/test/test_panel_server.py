"""What the panel's server answers: malformed requests, headers, files, control, and what it writes down."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import aiohttp
import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from panel_client import client, parameters, printed, run

CELL = Path(__file__).resolve().parents[3] / "config" / "cells" / "demo.cell.yaml"


def test_what_is_malformed_is_refused(panel: Any) -> None:
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as one:
            await one.enter(token)
            await one.ask("control_ask")
            assert (await one.ask("shutdown"))[0] == 400
            assert (await one.ask("stop", more=1))[0] == 400
            status, found = await one.ask("identify", what="stiffness", session="../x")
            assert status == 400
            assert "expected" in found["text"]
            headers = one.headers(**{"Content-Type": "application/json"})
            for body in (b"", b"{", b"[1]", b"nan", b'{"a":1e999}', b"\xff\xfe", b"[" * 5000):
                answer = await one.http.post(f"{address}/api/do/stop", data=body, headers=headers)
                assert answer.status == 400, body[:20]
            for path in (
                "/static/../panel.py",
                "/static/%2e%2e/server.py",
                "/files/..%2f/bag.tar",
                "/files/a/..%2f..%2fx",
            ):
                assert (await one.http.get(address + path)).status in (400, 404), path

    run(work())


def test_answers_carry_their_headers(panel: Any) -> None:
    address, _ = panel.where()

    async def work() -> None:
        async with client(address) as one:
            for path in ("/", "/static/app.js", "/api/me", "/nowhere"):
                answer = await one.http.get(address + path)
                policy = answer.headers["Content-Security-Policy"]
                assert "default-src 'none'" in policy
                assert "frame-ancestors 'none'" in policy
                assert "unsafe" not in policy
                assert answer.headers["X-Content-Type-Options"] == "nosniff"
                assert answer.headers["Referrer-Policy"] == "no-referrer"
                assert answer.headers["Cache-Control"] == "no-store"
                assert "Python" not in answer.headers["Server"]
                assert "Access-Control-Allow-Origin" not in answer.headers

    run(work())


def test_a_report_runs_in_a_sandbox(panel: Any, tmp_path: Path) -> None:
    folder = tmp_path / "session" / "identify"
    folder.mkdir(parents=True)
    (folder / "report.html").write_text("<script>1</script>", "utf-8")
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as one:
            await one.enter(token)
            answer = await one.http.get(f"{address}/files/session/identify/report.html")
            policy = answer.headers["Content-Security-Policy"]
            assert policy.startswith("sandbox allow-scripts;")
            assert "allow-same-origin" not in policy
            assert "connect-src" not in policy  # what default-src 'none' forbids stays forbidden
            taken = await one.http.get(f"{address}/files/session/identify/report.html?download")
            assert taken.headers["Content-Disposition"].startswith("attachment")

    run(work())


def test_only_who_holds_control_asks(panel: Any) -> None:
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as ann, client(address) as bob:
            await ann.enter(token)
            await bob.enter(panel.where()[1], "Bob")
            assert (await ann.ask("control_ask"))[1]["done"]
            assert (await bob.ask("pause"))[0] == 409
            assert (await bob.ask("stop"))[0] == 200  # heard by nobody here, and not refused for want of control
            async with ann.http.ws_connect(f"{address}/pages", headers=ann.headers()):
                assert not (await bob.ask("control_ask"))[1]["done"]
                assert (await ann.ask("control_answer", give=True))[1]["done"]
            assert (await ann.ask("pause"))[0] == 409
            assert (await bob.ask("pause"))[0] == 200

    run(work())


def test_confirming_without_a_click_ends_with_the_control_of_who_chose_it(panel: Any) -> None:
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as ann, client(address) as bob:
            await ann.enter(token)
            await bob.enter(panel.where()[1], "Bob")
            await ann.ask("control_ask")
            assert (await bob.ask("hold_time", seconds=2))[0] == 409
            assert (await ann.ask("hold_time", seconds=2))[1]["done"]
            await bob.listen(lambda shown: shown.get("hold") == 2.0)
            await ann.ask("control_release")
            await bob.ask("control_ask")
            await bob.listen(lambda shown: shown.get("hold") == 0.0)

    run(work())


def test_every_request_is_told_with_name_and_address(panel: Any, spinning: Any, until: Any) -> None:
    from calibration_interfaces.msg import SessionEvent

    from calibration.topics import EVENT

    heard: list[Any] = []
    spinning.plain("outside").create_subscription(SessionEvent, EVENT.relative, heard.append, EVENT.qos)
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as one, client(address) as eve:
            await one.enter(token, "Ann")
            await eve.enter("guess", "Eve")
            await one.ask("control_ask")
            await one.ask("stop")

    run(work())
    until(lambda: len(heard) >= 4)
    assert {one.kind for one in heard} == {SessionEvent.OPERATOR_ACTION}
    texts = [one.text for one in heard]
    assert texts[0] == "Ann has entered from 127.0.0.1"
    assert texts[1].startswith("127.0.0.1 was refused")
    assert "control_ask by Ann from 127.0.0.1" in texts[2]
    assert texts[3].startswith("stop by Ann from 127.0.0.1: refused: sequencer/stop is not there")


def test_behind_a_reverse_proxy_that_speaks_tls(
    spinning: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The proxy passes Host and Origin on: the page is told where it is found, and the cookie stays on TLS."""
    from calibration.panel import PanelNode

    given = parameters(cell=str(CELL), session=str(tmp_path / "session"), port=0, names=["https://cell.example"])
    panel = spinning.add(PanelNode(context=spinning.context, parameter_overrides=given))
    address, token = printed(capsys.readouterr().out)
    assert address == "https://cell.example"
    at = f"http://127.0.0.1:{panel._server.settings.port}"

    async def work() -> None:
        async with aiohttp.ClientSession() as http:
            for origin, status in ((at, 403), ("http://cell.example", 403), (address, 200)):
                answer = await http.post(
                    f"{at}/api/enter",
                    json={"token": token, "name": "Ann"},
                    headers={"Host": "cell.example", "Origin": origin},
                )
                assert answer.status == status
            assert "Secure" in answer.headers["Set-Cookie"]

    run(work())


def test_an_operator_hands_over_and_leaves(panel: Any, spinning: Any, until: Any) -> None:
    from calibration_interfaces.msg import SessionEvent

    from calibration.topics import EVENT

    heard: list[str] = []
    spinning.plain("outside").create_subscription(
        SessionEvent, EVENT.relative, lambda one: heard.append(one.text), EVENT.qos
    )
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as one:
            await one.enter(token, "Ann")
            await one.ask("control_ask")
            assert (await one.ask("operator", name=" "))[0] == 400
            assert (await one.ask("operator", name="Bob"))[1]["done"]
            await one.listen(lambda shown: shown.get("me", {}).get("name") == "Bob")
            assert not one.shown["me"]["control"]  # Bob has not asked for it
            await one.ask("stop")
            assert (await one.post("/api/leave"))[0] == 200
            assert (await one.http.get(f"{address}/api/me")).status == 401

    run(work())
    until(lambda: len(heard) >= 5)
    assert heard[2].startswith("operator (name Bob) by Ann from 127.0.0.1")
    assert "by Bob" in heard[3]
    assert heard[4] == "Bob has left at 127.0.0.1"


def test_a_device_stays_entered_when_the_panel_is_started_again(
    spinning: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from calibration.panel import PanelNode

    def start(port: int) -> Any:
        given = parameters(cell=str(CELL), session=str(tmp_path / "session"), port=port)
        return spinning.add(PanelNode(context=spinning.context, parameter_overrides=given))

    panel = start(0)
    address, token = printed(capsys.readouterr().out)

    async def work() -> None:
        async with client(address) as one:
            await one.enter(token)
            await one.ask("control_ask")
            await asyncio.to_thread(panel.stop)
            again = await asyncio.to_thread(start, int(address.rpartition(":")[2]))
            assert (await (await one.http.get(f"{address}/api/me")).json())["name"] == "Ann"
            assert (await one.ask("stop"))[0] == 200
            assert (await one.ask("pause"))[0] == 409  # control is asked for anew
            assert (await one.post("/api/leave"))[0] == 200
            await asyncio.to_thread(again.stop)
            (kept,) = tmp_path.glob(".panel-*.json")
            kept.write_text("[damaged", "utf-8")
            await asyncio.to_thread(start, int(address.rpartition(":")[2]))
            assert (await one.http.get(f"{address}/api/me")).status == 401

    run(work())


def test_a_condition_is_overridden_for_the_next_run(panel: Any, spinning: Any, tmp_path: Path) -> None:
    """Before a run the sequencer takes no override: it goes along with the goal."""
    from calibration_interfaces.action import RunPlan
    from calibration_interfaces.msg import Outcome
    from calibration_interfaces.srv import OverrideCondition
    from rclpy.action import ActionServer

    given: list[list[tuple[str, ...]]] = []

    def refuse(_: Any, response: Any) -> Any:
        response.outcome.code, response.outcome.text = Outcome.INPUT_UNUSABLE, "no plan is being measured"
        return response

    def measure(handle: Any) -> Any:
        given.append([(one.condition, one.operator_name, one.reason) for one in handle.request.overrides])
        handle.succeed()
        return RunPlan.Result()

    node = spinning.plain("sequencer")
    node.create_service(OverrideCondition, "sequencer/override_condition", refuse)
    spinning.executor.create_task(lambda: ActionServer(node, RunPlan, "sequencer/run", measure))
    (tmp_path / "plan.yaml").write_text("x", "utf-8")
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as one:
            await one.enter(token)
            await one.ask("control_ask")
            asked = {"condition": "temperature", "reason": "the hall is warm"}
            assert "next run" in (await one.ask("override_condition", **asked))[1]["text"]
            await one.listen(lambda shown: shown.get("overrides") == ["temperature"])
            for session in ("one", "two"):
                assert (await one.ask("run", plan="plan.yaml", session=session, resume=False))[1]["done"]
            await one.listen(lambda shown: shown.get("overrides") == [])

    run(work())
    assert given == [[("temperature", "Ann", "the hall is warm")], []]


def test_a_panel_that_has_ended_serves_nothing(panel: Any) -> None:
    address, _ = panel.where()
    panel.stop()

    async def gone() -> None:
        async with client(address) as one:
            with pytest.raises(aiohttp.ClientError):
                await one.http.get(address)

    run(gone())


def test_a_message_for_all_pages_is_small(panel: Any) -> None:
    """A page that is told nothing new is told little: tablets and their networks are slow."""
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as one:
            await one.enter(token)
            async with one.http.ws_connect(f"{address}/pages", headers=one.headers()) as socket:
                first = json.loads(await socket.receive_str(timeout=2.0))
                assert {"cell", "me"} <= first.keys()
                await asyncio.sleep(1.0)
                later = [await socket.receive_str(timeout=2.0) for _ in range(3)]
                assert later[-1] == "{}"

    run(work())
