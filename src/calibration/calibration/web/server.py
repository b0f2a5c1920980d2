"""The server of the panel: pages in, requests out, and nothing that does not come from a page of ours.

Every request is held against the Host names that are served; every one that changes something is a POST from a page of
the same origin, with the cookie and the token of a session that has entered.
"""

from __future__ import annotations

import asyncio
import dataclasses
import hmac
import mimetypes
import time
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

from aiohttp import WSCloseCode, web

from calibration.web.access import (
    Access,
    Control,
    Rate,
    Session,
    host_allowed,
    origin_allowed,
    page_token,
    write_private,
)
from calibration.web.folder import Folder
from calibration.web.hub import BEAT, Hub, Page
from calibration.web.link import Answer
from calibration.web.request_table import KINDS, OPERATOR, Field, RequestError, read
from calibration.web.serving import Door
from calibration_core.report.view3d import script

STATIC = Path(__file__).parent / "static"
LARGEST = 8192  # bytes of a request
BODY = 5.0  # s of wall time, in which a request has to be there as a whole
BLOCK = 1 << 20  # bytes of a file handed out at once
LARGEST_MESSAGE = 256  # bytes of a message from a page
PAGES_OF_SESSION = 4
PAGES = 24
ENTRIES = (0.2, 8.0)  # a second, and at once, from one address
KEPT = 600.0  # s between two writings of the sessions that are in use
CSP = (
    "default-src 'none'; "
    "script-src 'self'; "
    "style-src 'self'; "
    "img-src 'self' data:; "
    "connect-src 'self'; "
    "frame-src 'self'; "
    "base-uri 'none'; "
    "form-action 'none'; "
    "frame-ancestors 'none'; "
    "require-trusted-types-for 'script'; "
    "trusted-types 'none'"
)
# A report is a document of its own with scripts and styles inside it: it runs in a sandbox without our origin, and
# can neither ask the panel for anything nor anybody else.
REPORT_CSP = (
    "sandbox allow-scripts; "
    "default-src 'none'; "
    "script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; "
    "img-src data:; "
    "font-src data:; "
    "base-uri 'none'; "
    "form-action 'none'; "
    "frame-ancestors 'self'"
)
HEADERS = {
    "Content-Security-Policy": CSP,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=(), usb=(), serial=()",
    "Cache-Control": "no-store",
}


Do = Callable[[str, dict[str, Any], Session], Awaitable[Answer]]
"""Does what a session asks for: name of the request, its fields, the session."""


@dataclasses.dataclass(frozen=True)
class Settings:
    """Where and how the server listens.

    Attributes:
        origins: Of our own pages.
        port: Where it listens.
        address: Under which pages find it, `http://HOST:PORT`, or as the reverse proxy before it serves it.
    """

    origins: frozenset[str]
    port: int
    address: str

    @property
    def cookie(self) -> str:
        """Name of the cookie: cookies know no ports, and two panels on one machine must not disturb each other."""
        return f"panel_{self.port}"


class Server:
    """The server; everything in it is done by one thread.

    Attributes:
        access: Who has entered, and the present token.
        settings: Where and how it listens.
    """

    def __init__(
        self,
        settings: Settings,
        folder: Folder,
        hub: Hub,
        control: Control,
        do: Do,
        entered: Callable[[Session | None, str], None],
        scene: Callable[[], dict[str, Any]],
        door: Door,
    ) -> None:
        """Prepare.

        Args:
            settings: Where and how it listens.
            folder: Where sessions and plans are.
            hub: What is shown.
            control: Who holds control.
            do: Does what is asked for.
            entered: Called when somebody has entered, or was refused (None), with words about it.
            scene: Returns the cell in space, as `view3d` draws it; called in another thread.
            door: Is told which connections have shown a session.
        """
        self.settings, self._folder, self._hub, self._do, self._entered = settings, folder, hub, do, entered
        self._scene, self._door = scene, door
        self.access, self._control = Access(time.monotonic()), control
        self._entries = Rate(*ENTRIES)
        self._requests, self._reads = Rate(10.0, 30), Rate(5.0, 20)
        self._kept, self._keeping, self._written = folder.root / f".panel-{settings.port}.json", asyncio.Lock(), 0.0
        self._restore()
        self._files: Mapping[str, tuple[str, bytes]] = {
            **_files(STATIC),
            "scene.js": ("text/javascript", script().encode("utf-8")),
        }

    def application(self) -> web.Application:
        """Return what is served."""
        app = web.Application(middlewares=[self._gate], client_max_size=LARGEST)
        app.on_response_prepare.append(on_prepare)
        app.router.add_get("/", self._on_page)
        app.router.add_get("/static/{path:[a-z0-9_./-]+}", self._on_static)
        app.router.add_post("/api/enter", self._on_enter)
        app.router.add_get("/api/me", self._on_me)
        app.router.add_post("/api/leave", self._on_leave)
        app.router.add_post("/api/device", self._on_device)
        app.router.add_get("/api/folder", self._on_folder)
        app.router.add_get("/api/scene", self._on_scene)
        app.router.add_post("/api/do/{name:[a-z_]+}", self._on_request)
        app.router.add_get("/files/{session}/{file:[a-z0-9_./-]+}", self._on_file)
        app.router.add_get("/pages", self._on_socket)
        return app

    # --- the gate ----------------------------------------------------------------------------------------------------

    @web.middleware
    async def _gate(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        """Refuse what is not from a page of ours, before anything else looks at it."""
        if not host_allowed(request.headers.get("Host"), self.settings.origins):
            return refused(421, "this host is not served here")
        if request.method not in ("GET", "HEAD", "POST"):
            return refused(405, "GET or POST")
        if request.method == "POST":
            if not self._from_own_page(request):
                return refused(403, "the request comes from another page")
            if request.content_type != "application/json":
                return refused(415, "application/json")
        if self._session(request) is not None:
            self._door.known(request.transport)
        try:
            await asyncio.wait_for(request.read(), BODY)
        except TimeoutError:
            return refused(408, "the request does not come to its end")
        return await handler(request)

    def _from_own_page(self, request: web.Request) -> bool:
        return origin_allowed(request.headers.get("Origin"), request.host, self.settings.origins)

    def _cookie(self, request: web.Request) -> str:
        return request.cookies.get(self.settings.cookie, "")

    def _session(self, request: web.Request) -> Session | None:
        return self.access.find(self._cookie(request), time.monotonic())

    def _changing(self, request: web.Request) -> Session:
        """Return the session of a request that changes something.

        Raises:
            HTTPException: It has none, or its token is not the session's.
        """
        session = self._session(request)
        if session is None:
            raise web.HTTPUnauthorized(text='{"text":"enter first"}', content_type="application/json")
        given = request.headers.get("X-Panel-Token", "")
        if not hmac.compare_digest(given.encode(), page_token(self._cookie(request)).encode()):
            raise web.HTTPForbidden(text='{"text":"the token is missing"}', content_type="application/json")
        return session

    # --- entering ----------------------------------------------------------------------------------------------------

    async def _on_enter(self, request: web.Request) -> web.StreamResponse:
        address = request.remote or "unknown"
        if not self._entries.take(address, time.monotonic()):
            return refused(429, f"too many tries: one is free every {1.0 / ENTRIES[0]:.0f} s")
        try:
            given = await request.json()
            name = str(OPERATOR.read("enter", "name", given.get("name")))
            token = str(Field(low=1, high=100).read("enter", "token", given.get("token")))
        except (ValueError, RecursionError, AttributeError, RequestError) as error:
            return refused(400, str(error))
        found = self.access.enter(token, name, address, time.monotonic())
        if found is None:
            self._entered(None, f"{address} was refused: the token is not the present one")
            return refused(403, "this token is not good any more: take the one that the terminal shows now")
        cookie, session = found
        self._entered(session, f"{name} has entered from {address}")
        await self._keep()
        answer = web.json_response({"token": page_token(cookie), "name": name})
        secure = request.headers["Origin"].lower().startswith("https:")  # which the gate has looked at
        answer.set_cookie(self.settings.cookie, cookie, httponly=True, samesite="Strict", secure=secure, path="/")
        return answer

    # --- sessions outlive the process --------------------------------------------------------------------------------

    def _restore(self) -> None:
        try:
            self.access.restore(self._kept.read_text("utf-8"), time.monotonic(), time.time())
        except FileNotFoundError:
            return  # nobody has entered yet
        except (OSError, ValueError) as error:
            self._entered(None, f"{self._kept} cannot be used, every device has to enter anew: {error}")

    async def _keep(self) -> None:
        async with self._keeping:
            self._written = time.monotonic()
            try:
                await asyncio.to_thread(write_private, self._kept, self.access.kept(self._written, time.time()))
            except OSError as error:
                self._entered(None, f"sessions do not outlive a restart of the panel: {error}")

    async def keep_used(self) -> None:
        """Write down now and then that sessions are in use."""
        if time.monotonic() - self._written > KEPT and self.access.sessions:
            await self._keep()

    # --- who is here -------------------------------------------------------------------------------------------------

    async def _on_me(self, request: web.Request) -> web.StreamResponse:
        session = self._session(request)
        if session is None:
            return refused(401, "enter first")
        return web.json_response({"token": page_token(self._cookie(request)), "name": session.name})

    async def _on_leave(self, request: web.Request) -> web.StreamResponse:
        session = self._changing(request)
        self._control.release(session)
        self.access.leave(session)
        self._entered(None, f"{session.name} has left at {session.address}")
        self._hub.wake()
        await self._keep()
        answer = web.json_response({"done": True})
        answer.del_cookie(self.settings.cookie, path="/")
        return answer

    async def _on_device(self, request: web.Request) -> web.StreamResponse:
        """Show a page that has entered how another device enters."""
        import segno

        self._changing(request)
        url = f"{self.settings.address}/#{self.access.token}"
        return web.json_response({"url": url, "image": segno.make(url, error="m").svg_data_uri(scale=6)})

    # --- asking ------------------------------------------------------------------------------------------------------

    async def _on_request(self, request: web.Request) -> web.StreamResponse:
        session = self._changing(request)
        name = request.match_info["name"]
        if name != "stop" and not self._requests.take(session.key, time.monotonic()):
            return refused(429, "too many requests: wait a second")
        try:
            values = read(name, await request.json())
        except (ValueError, RecursionError, RequestError) as error:
            return refused(400, str(error))
        if KINDS[name].control and self._control.holder is not session:
            return refused(409, "this page does not hold control")
        answer = await self._do(name, values, session)
        self._hub.wake()
        if name == "operator":
            await self._keep()
        heard = {"heard": answer.message is not None} if name == "stop" else {}
        return web.json_response({"done": answer.done, "text": answer.text, **heard})

    async def _on_folder(self, request: web.Request) -> web.StreamResponse:
        session = self._session(request)
        if session is None:
            return refused(401, "enter first")
        if not self._reads.take(session.key, time.monotonic()):
            return refused(429, "too many requests: wait a second")
        plans = list(await asyncio.to_thread(self._folder.plans))
        sessions = await asyncio.to_thread(self._folder.sessions)
        return web.json_response({"plans": plans, "sessions": sessions})

    async def _on_scene(self, request: web.Request) -> web.StreamResponse:
        if self._session(request) is None:
            return refused(401, "enter first")
        return web.json_response(await asyncio.to_thread(self._scene))

    async def _on_file(self, request: web.Request) -> web.StreamResponse:
        if self._session(request) is None:
            return refused(401, "enter first")
        session, name = request.match_info["session"], request.match_info["file"]
        try:
            path = self._folder.files(session).get(name)
        except RequestError as error:
            return refused(400, str(error))
        if path is None:
            return refused(404, "there is no such file")
        if path.is_dir():
            return await _streamed(request, path, f"{session}-{name}")
        shown = name.endswith("report.html") and "download" not in request.query
        headers = {"Content-Disposition": f'attachment; filename="{session}-{path.name}"'}
        return web.FileResponse(path, headers={"Content-Security-Policy": REPORT_CSP} if shown else headers)

    # --- showing -----------------------------------------------------------------------------------------------------

    async def _on_page(self, _request: web.Request) -> web.StreamResponse:
        kind, content = self._files["index.html"]
        return web.Response(body=content, content_type=kind, charset="utf-8")

    async def _on_static(self, request: web.Request) -> web.StreamResponse:
        found = self._files.get(request.match_info["path"])
        if found is None:
            return refused(404, "there is no such file")
        return web.Response(body=found[1], content_type=found[0], charset="utf-8")

    async def _on_socket(self, request: web.Request) -> web.StreamResponse:
        if not self._from_own_page(request):
            return refused(403, "the request comes from another page")
        session = self._session(request)
        if session is None:
            return refused(401, "enter first")
        if session.pages >= PAGES_OF_SESSION or len(self._hub.pages) >= PAGES:
            return refused(429, "too many pages are open")
        socket = web.WebSocketResponse(max_msg_size=LARGEST_MESSAGE, compress=False, heartbeat=5.0)
        await socket.prepare(request)
        page = Page(session)
        self._hub.pages.add(page)
        session.pages += 1
        sending = asyncio.get_running_loop().create_task(self._send(socket, page))
        try:
            async for _ in socket:  # a page tells nothing here
                await socket.close(code=WSCloseCode.POLICY_VIOLATION, message=b"nothing is taken here")
        finally:
            sending.cancel()
            self._hub.pages.discard(page)
            session.pages -= 1
            session.left = time.monotonic()
            await asyncio.wait({sending})  # it ends with the page, also where the server ends
        return socket

    async def _send(self, socket: web.WebSocketResponse, page: Page) -> None:
        session = page.session
        while not socket.closed:
            if self.access.used(session, time.monotonic()) is None:
                await socket.close(code=WSCloseCode.POLICY_VIOLATION, message=b"the session has ended")
                return
            await socket.send_str(self._hub.news(page, self._own(session)))
            page.changed.clear()
            try:
                await asyncio.wait_for(page.changed.wait(), BEAT)
            except TimeoutError:
                continue
            await asyncio.sleep(0.02)  # what changes meanwhile goes with it

    def _own(self, session: Session) -> dict[str, Any]:
        holder, asking = self._control.holder, self._control.asking
        return {
            "name": session.name,
            "control": holder is session,
            "holder": "" if holder is None else holder.name,
            "asked_by": "" if asking is None else asking.name,
            "asking": asking is session,
        }


def _files(folder: Path) -> dict[str, tuple[str, bytes]]:
    """Return the files of a folder by their paths in it: content type and content."""
    found = {}
    for path in sorted(one for one in folder.rglob("*") if one.is_file()):
        kind = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
        found[path.relative_to(folder).as_posix()] = (kind, path.read_bytes())
    return found


async def on_prepare(_request: web.Request, response: web.StreamResponse) -> None:
    """Put the headers on an answer, unless it brings its own."""
    for name, value in HEADERS.items():
        response.headers.setdefault(name, value)
    response.headers["Server"] = "calibration"


def refused(status: int, text: str) -> web.Response:
    """Return an answer that says why a request is refused."""
    return web.json_response({"done": False, "text": text}, status=status)


async def _streamed(request: web.Request, directory: Path, name: str) -> web.StreamResponse:
    headers = {"Content-Disposition": f'attachment; filename="{name}"', "Content-Type": "application/x-tar"}
    answer = web.StreamResponse(headers=headers)
    await answer.prepare(request)
    process = await asyncio.create_subprocess_exec(
        "tar", "-C", str(directory.parent), "-cf", "-", directory.name, stdout=asyncio.subprocess.PIPE
    )
    assert process.stdout is not None  # noqa: S101 - it was asked for
    try:
        while piece := await process.stdout.read(BLOCK):
            await answer.write(piece)
        await answer.write_eof()
    finally:  # also where the browser has gone
        if process.returncode is None:
            process.kill()
        await process.wait()
    return answer
