"""A page without a browser: enters, asks, and listens, as the page's modules do."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import time
from collections.abc import AsyncIterator
from typing import Any

import aiohttp

ADDRESS = re.compile(r"(https?://\S+)/#(\S+)")


class Client:
    """One device.

    Attributes:
        address: Of the server.
        http: The session with its cookies.
        token: Of the session, once it has entered.
        shown: What the WebSocket has told so far.
    """

    def __init__(self, address: str, http: aiohttp.ClientSession) -> None:
        self.address, self.http, self.token = address, http, ""
        self.shown: dict[str, Any] = {}

    def headers(self, **more: str) -> dict[str, str]:
        """Headers of a request from our own page."""
        return {"Origin": self.address, "X-Panel-Token": self.token, **more}

    async def post(self, path: str, body: Any = None, **more: str) -> tuple[int, dict[str, Any]]:
        """Post; return status and answer."""
        answer = await self.http.post(
            self.address + path, json={} if body is None else body, headers=self.headers(**more)
        )
        return answer.status, json.loads(await answer.text())

    async def enter(self, token: str, name: str = "Ann") -> int:
        """Enter; return the status."""
        status, found = await self.post("/api/enter", {"token": token, "name": name})
        self.token = found.get("token", "")
        return status

    async def ask(self, request: str, /, **fields: Any) -> tuple[int, dict[str, Any]]:
        """Ask for something."""
        return await self.post(f"/api/do/{request}", fields)

    async def listen(self, until: Any, timeout: float = 20.0) -> None:
        """Listen until something is shown."""
        async with self.http.ws_connect(f"{self.address}/pages", headers=self.headers()) as socket:
            end = time.monotonic() + timeout
            while not until(self.shown):
                assert time.monotonic() < end, self.shown
                self.shown |= json.loads(await socket.receive_str(timeout=2.0))


@contextlib.asynccontextmanager
async def client(address: str) -> AsyncIterator[Client]:
    """A device that has not entered."""
    jar = aiohttp.CookieJar(unsafe=True)  # addresses are numbers here
    async with aiohttp.ClientSession(cookie_jar=jar) as http:
        yield Client(address, http)


def printed(text: str) -> tuple[str, str]:
    """Address and token that were printed last."""
    found = ADDRESS.findall(text)
    assert found, text
    return str(found[-1][0]), str(found[-1][1])


def parameters(**values: Any) -> list[Any]:
    """Parameters of a node."""
    from rclpy.parameter import Parameter

    return [Parameter(name, value=value) for name, value in values.items()]


def run(work: Any) -> Any:
    """Run a coroutine of a test."""
    return asyncio.run(work)
