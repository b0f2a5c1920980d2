"""The panel's server against what OWASP lists for WebSockets, and for requests that change something: real HTTP."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import socket
import time
from collections.abc import Iterator
from typing import Any

import aiohttp
import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from panel_client import Client, client, run


def test_the_address_is_of_this_machine_alone(panel: Any) -> None:
    address, token = panel.where()
    assert address.startswith("http://127.0.0.1:")
    assert len(token) >= 32
    assert panel._socket.getsockname()[0] == "127.0.0.1"


def test_without_a_session_nothing_is_shown_and_nothing_done(panel: Any) -> None:
    address, _ = panel.where()

    async def work() -> None:
        async with client(address) as one:
            for path in ("/api/me", "/api/folder", "/files/session/bag.tar"):
                assert (await one.http.get(address + path)).status == 401, path
            for path in ("/api/do/stop", "/api/leave", "/api/device"):
                assert (await one.post(path))[0] == 401, path
            with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
                await one.http.ws_connect(f"{address}/pages", headers=one.headers())
            assert caught.value.status == 401

    run(work())


def test_a_token_is_used_up_and_tries_are_counted(panel: Any) -> None:
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as one, client(address) as two:
            assert await one.enter(token) == 200
            assert await two.enter(token, "Eve") == 403
            found = [await two.enter("guess", "Eve") for _ in range(12)]
            assert found[0] == 403
            assert found[-1] == 429  # also for the right one, for a while
            assert await two.enter(panel.where()[1], "Eve") == 429

    run(work())


def test_the_cookie_is_strict_and_no_script_reads_it(panel: Any) -> None:
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as one:
            answer = await one.http.post(
                f"{address}/api/enter", json={"token": token, "name": "Ann"}, headers={"Origin": address}
            )
            cookie = answer.headers["Set-Cookie"]
            assert "HttpOnly" in cookie
            assert "SameSite=Strict" in cookie
            assert "Domain" not in cookie
            body = await answer.json()
            assert body["token"] not in cookie

    run(work())


def test_a_foreign_page_changes_nothing(panel: Any) -> None:
    """Cross-site request forgery: the browser sends the cookie, but another Origin and no token."""
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as one:
            await one.enter(token)
            for origin in ("http://evil.example", "null", address.replace("127.0.0.1", "localhost"), address + "1"):
                assert (await one.post("/api/do/control_ask", Origin=origin))[0] == 403, origin
            answer = await one.http.post(f"{address}/api/do/control_ask", json={}, headers={"X-Panel-Token": one.token})
            assert answer.status == 403  # no Origin at all
            assert (await one.post("/api/do/control_ask", **{"X-Panel-Token": ""}))[0] == 403
            assert (await one.post("/api/do/control_ask", **{"X-Panel-Token": "guess"}))[0] == 403
            form = await one.http.post(f"{address}/api/do/control_ask", data={"a": "b"}, headers=one.headers())
            assert form.status == 415
            got = await one.http.get(f"{address}/api/do/control_ask", headers=one.headers())
            assert got.status == 405
            for method in ("PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"):
                assert (await one.http.request(method, f"{address}/api/do/stop")).status == 405, method
            assert panel._control.holder is None
            assert (await one.ask("control_ask"))[1]["done"]

    run(work())


def test_a_foreign_name_is_not_served(panel: Any) -> None:
    """DNS rebinding: a stranger's name that points here."""
    address, _ = panel.where()

    async def work() -> None:
        async with client(address) as one:
            for host in ("evil.example", "evil.example:80", "127.0.0.1", "127.0.0.1:1"):
                for path in ("/", "/static/app.js", "/api/me", "/pages"):
                    assert (await one.http.get(address + path, headers={"Host": host})).status == 421, (host, path)

    run(work())


async def refused(one: Client, **headers: str) -> int:
    try:
        await one.http.ws_connect(f"{one.address}/pages", headers=one.headers(**headers))
    except aiohttp.WSServerHandshakeError as error:
        return int(error.status)
    raise AssertionError("the WebSocket was opened")


def test_a_foreign_page_opens_no_socket(panel: Any) -> None:
    """Cross-site WebSocket hijacking."""
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as one:
            await one.enter(token)
            for origin in ("http://evil.example", "null", address.replace("http", "https"), address + ".evil.example"):
                assert await refused(one, Origin=origin) == 403, origin
            headers = {"Host": "evil.example:1", "Origin": "http://evil.example:1"}
            assert await refused(one, **headers) == 421

    run(work())


async def closed_with(socket: Any) -> int:
    """Read until the server closes; the code."""
    end = time.monotonic() + 5.0
    while time.monotonic() < end:
        message = await socket.receive(timeout=5.0)
        if message.type in (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED, aiohttp.WSMsgType.CLOSING):
            return int(socket.close_code or 0)
    raise AssertionError("the socket stays open")


@pytest.mark.parametrize(("sent", "code"), [("x" * 300, 1009), ("1", 1008), (b"1", 1008)])
def test_a_message_of_a_page_ends_the_socket(panel: Any, sent: str | bytes, code: int) -> None:
    """A page has nothing to say there, and a message has a limit to its size."""
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as one:
            await one.enter(token)
            async with one.http.ws_connect(f"{address}/pages", headers=one.headers()) as socket:
                await (socket.send_str(sent) if isinstance(sent, str) else socket.send_bytes(sent))
                assert await closed_with(socket) == code

    run(work())


def test_sockets_are_counted(panel: Any) -> None:
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as one:
            await one.enter(token)
            many = [await one.http.ws_connect(f"{address}/pages", headers=one.headers()) for _ in range(4)]
            assert await refused(one) == 429
            for socket in many:
                assert socket.compress == 0
                await socket.close()

    run(work())


def test_a_session_that_leaves_takes_its_sockets_along(panel: Any) -> None:
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as one:
            await one.enter(token)
            async with one.http.ws_connect(f"{address}/pages", headers=one.headers()) as socket:
                assert (await one.post("/api/leave"))[0] == 200
                assert await closed_with(socket) == 1008
            assert await refused(one) == 401
            assert (await one.ask("stop"))[0] == 401

    run(work())


def test_requests_are_counted_and_bounded_and_a_stop_is_never_refused(panel: Any, spinning: Any) -> None:
    from std_srvs.srv import Trigger

    def stop(_: Any, response: Any) -> Any:
        stops.append(time.monotonic())
        response.success = True
        return response

    stops: list[float] = []
    spinning.plain("sequencer").create_service(Trigger, "sequencer/stop", stop)
    address, token = panel.where()

    async def work() -> None:
        async with client(address) as one:
            await one.enter(token)
            found = [(await one.ask("control_ask"))[0] for _ in range(60)]
            assert 429 in found
            taps = await asyncio.gather(*(one.ask("stop") for _ in range(20)))
            assert {status for status, _ in taps} == {200}  # a stop is never refused
            assert len(stops) in (2, 3)  # and whoever taps in between shares the next one
            assert {found["done"] for _, found in taps} == {True}
            large = {"condition": "a", "reason": "x" * 20_000}
            answer = await one.http.post(f"{address}/api/do/override_condition", json=large, headers=one.headers())
            assert answer.status in (413, 429)

    run(work())


# --- connections that show no session --------------------------------------------------------------------------------


@contextlib.contextmanager
def half_open(address: str, number: int) -> Iterator[list[socket.socket]]:
    """Connections of somebody without a token, each with the beginning of a header."""
    host, _, port = address.removeprefix("http://").partition(":")
    with contextlib.ExitStack() as stack:
        found = []
        for _ in range(number):
            one = stack.enter_context(socket.create_connection((host, int(port)), timeout=10.0))
            one.sendall(b"G")
            found.append(one)
        yield found


def ended(connections: list[socket.socket]) -> int:
    """How many the server has closed."""
    number = 0
    for one in connections:
        one.setblocking(False)
        try:
            number += one.recv(1) == b""
        except BlockingIOError:
            continue
        except ConnectionError:
            number += 1
    return number


def test_strangers_make_room_and_do_not_stay(
    panel: Any, until: Any, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Half-open connections: a page that is open, a reload and a stop work, the others are closed, with one line."""
    from calibration.web import serving

    for name, value in (("STRANGERS_OF_ADDRESS", 40), ("STRANGER", 2.0), ("LOOK", 0.2), ("REPORTED", 8.0)):
        monkeypatch.setattr(serving, name, value)
    address, token = panel.where()
    said: list[str] = []
    monkeypatch.setattr(panel._door, "_say", said.append)

    async def work() -> None:
        async with client(address) as one, client(address) as late:
            await one.enter(token)
            async with one.http.ws_connect(f"{address}/pages", headers=one.headers()) as socket_:
                await socket_.receive_str(timeout=5.0)
                with half_open(address, 150) as connections:
                    until(lambda: ended(connections) >= 110)
                    assert ended(connections[-40:]) == 0  # the newest ones have room
                    assert (await one.http.get(f"{address}/")).status == 200
                    assert (await one.ask("stop"))[0] == 200
                    assert await late.enter(panel.where()[1], "Bob") == 200  # another device, too
                    until(lambda: ended(connections) == 150)  # nobody stays who shows no session
                    for _ in range(3):
                        assert await socket_.receive_str(timeout=2.0)

    run(work())
    until(lambda: said)
    assert "connections that showed no session" in said[0]
    assert "from 127.0.0.1" in said[0]
    assert len(said) == 1
    assert [one.getMessage() for one in caplog.records if one.name == "asyncio"] == []


def test_a_body_that_does_not_come_is_not_waited_for(panel: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from calibration.web import server

    monkeypatch.setattr(server, "BODY", 0.3)
    address, _ = panel.where()
    one = http.client.HTTPConnection(address.split("/")[2], timeout=10.0)
    one.putrequest("POST", "/api/enter")
    for name, value in (("Origin", address), ("Content-Type", "application/json"), ("Content-Length", "100")):
        one.putheader(name, value)
    one.endheaders(b"{")
    assert one.getresponse().status == 408
    one.close()
