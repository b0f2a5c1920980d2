"""The shipped tree with its panel, hands that pull where the operator would, and a browser."""

from __future__ import annotations

import contextlib
import os
import shutil
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from calibration_interfaces.action import ApplyLoad
from calibration_interfaces.msg import Outcome, ProcedureState
from goals import GoalClient
from panel_client import printed
from stand_ins import unloaded
from tree_runner import TreeRunner

from calibration.process_tree import SIMULATED_CELL
from calibration.topics import PROCEDURE
from calibration_core.cell import load_cell
from calibration_core.files.yaml_file import yaml_text
from calibration_core.planning.feasible.loads import LoadRules
from calibration_core.planning.loaded import PlanningRules, make_plan
from calibration_core.planning.plans.plan_file import plan_text

CELL = Path(__file__).resolve().parents[3] / "config" / "cells" / "demo.cell.yaml"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
NOT_DONE = ("Not done", "Nicht ausgeführt")
TRIALS = 3  # a person presses a button as often as that before giving up
LONG = 240.0  # s of wall time, that a busy machine may take for anything whose time is not what is tested


def browser_path() -> str:
    """The browser of this machine; skips where there is none."""
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed: run make setup")
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip("there is no browser: apt-get install chromium")
    return str(found)


@contextlib.contextmanager
def browser(*, drawing: bool = False) -> Iterator[Any]:
    """A browser without a window; Debian's has no sandbox for the user root.

    Args:
        drawing: Whether it draws the robot: without a graphics card that costs more than everything else together.
    """
    path, more = browser_path(), [] if drawing else ["--disable-3d-apis"]
    from playwright.sync_api import sync_playwright

    arguments = ["--no-sandbox", "--disable-gpu-sandbox", *more]
    with contextlib.ExitStack() as stack:
        with contextlib.nullcontext() if drawing else first():
            playwright = stack.enter_context(sync_playwright())
            one = playwright.chromium.launch(executable_path=path, args=arguments)
        stack.callback(one.close)
        yield one


@contextlib.contextmanager
def first() -> Iterator[None]:
    """What is started inside goes before everything else, where that may be asked: a tablet has cores of its own."""
    usual = os.getpriority(os.PRIO_PROCESS, 0)
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, usual - 15)
    try:
        yield
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, usual)


def short_plan(root: Path, configurations: int, levels: tuple[float, ...] = (0.0, 0.5, 1.0)) -> Path:
    """Write a plan of some configurations, with the end of its start-up cycle alone, where the panel finds it."""
    rules = PlanningRules(load=LoadRules(levels=levels))
    content = yaml.safe_load(plan_text(make_plan(load_cell(CELL), rules=rules, seed=1)))
    content |= {"startup_cycle": content["startup_cycle"][-1:], "expected": None}
    content["configurations"] = content["configurations"][:configurations]
    path = root / "short" / "plan.yaml"
    path.parent.mkdir(parents=True)
    path.write_text(yaml_text(content), encoding="utf-8")
    return path


def wait(page: Any, condition: Any, seconds: float = LONG) -> None:
    """Look until something holds, as a person does."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, page.inner_text("body")
        page.wait_for_timeout(50)


def opened(
    browser: Any, address: str, token: str, name: str = "Ann", prepare: Any = lambda _page: None, **options: Any
) -> Any:
    """A page of a new device that has entered; errors of its scripts are kept in `page.errors`."""
    context = browser.new_context(**{"viewport": {"width": 1280, "height": 800}, "locale": "en-GB", **options})
    page = context.new_page()
    page.set_default_timeout(1e3 * LONG)
    page.errors = []
    page.on("pageerror", lambda error: page.errors.append(str(error)))
    page.on("console", lambda one: page.errors.append(one.text) if "Content Security" in one.text else None)
    prepare(page)
    page.goto(f"{address}/#{token}")
    page.fill("#name", name)
    page.click("#enter")
    page.wait_for_selector("#stop")
    return page


class Hands:
    """Pull as the sequencer wants it: what a person with a chain hoist does.

    Attributes:
        idle: While it is set, nobody pulls.
        share: Of the force that is wanted, which is brought on; 1: all of it.
    """

    def __init__(self, node: Any) -> None:
        self._node, self._client = node, GoalClient(node, ApplyLoad, "driver/apply_load")
        self._done: tuple[Any, ...] = ()
        self._lock = threading.Lock()
        self.idle, self.share = False, 1.0
        node.create_subscription(ProcedureState, PROCEDURE.relative, self._on_state, PROCEDURE.qos)

    def _on_state(self, state: ProcedureState) -> None:
        force = state.target.force
        wanted = (state.configuration, state.attempt, state.step, force.x, force.y, force.z, self.share)
        if self.idle or not state.load_awaited or state.waits_for != ProcedureState.OPERATOR or wanted == self._done:
            return
        self._done = wanted
        target = state.target
        for axis in "xyz":
            setattr(target.force, axis, self.share * getattr(force, axis))
        sent = self._client.send_goal_async(ApplyLoad.Goal(target=target, timeout=60.0))
        sent.add_done_callback(self._on_accept)

    def _on_accept(self, sent: Any) -> None:
        if sent.result().accepted:
            sent.result().get_result_async().add_done_callback(self._on_end)
        else:
            self._done = ()

    def _on_end(self, ended: Any) -> None:
        """Pull again where the load has not come about: a person sees it at the gauge."""
        if ended.result().result.outcome.code != Outcome.OK:
            self._done = ()


class Cell:
    """The simulated cell with its panel.

    Attributes:
        runner: Its processes.
        root: Folder of sessions and plans.
        hands: That pull.
    """

    def __init__(
        self,
        environment: dict[str, str],
        client: Any,
        root: Path,
        by: str,
        speed: float = 4.0,
        more: dict[str, dict[str, object]] | None = None,
        tracker: str = "stream",
    ) -> None:
        said = {"cell": CELL, "session": root / "session", "speed": speed, "port": 0, "tracker": tracker}
        self.root = root
        unloaded(root)
        environment = {**environment, "ROS_HOME": str(root)}
        self.runner = TreeRunner(
            SIMULATED_CELL, environment, root, more={"sequencer": {"load.by": by}, **(more or {})}, **said
        )
        self.hands = Hands(client)

    def where(self) -> tuple[str, str]:
        """Address and present token of the panel."""
        end = time.monotonic() + LONG
        while "http" not in (text := self.runner.log("panel")):
            assert time.monotonic() < end, text
            time.sleep(0.1)
        time.sleep(0.1)  # an entry prints the next one
        return printed(self.runner.log("panel"))

    def page(self, browser: Any, name: str = "Ann", **options: Any) -> Any:
        """A page of a new device that has entered; errors of its scripts are kept in `page.errors`."""
        return opened(browser, *self.where(), name, **options)


@contextlib.contextmanager
def running(
    spinning: Any, environment: dict[str, str], root: Path, by: str = "device", configurations: int = 3, **more: Any
) -> Iterator[Cell]:
    """The shipped tree; `more` are its speed, and parameters of single nodes."""
    browser_path()
    short_plan(root, configurations)
    one = Cell(environment, spinning.plain("hands"), root, by=by, **more)
    one.runner.start()
    try:
        yield one
    finally:
        one.runner.shutdown()


def put_right(page: Any) -> None:
    """Reset a guard that has latched before the run, as the page says: a busy machine halts the cell's clock."""
    latched = page.locator('#faults .fault[data-code="guard_latched"]')
    if latched.count():
        page.click("#tab_during")
        page.click("#reset")
        page.click("#sure_yes")
        wait(page, lambda: latched.count() == 0)
        page.click("#tab_before")


def begin(page: Any, session: str = "session") -> None:
    """Begin the short plan once everything is in order."""
    page.click("#tab_before")
    wait(page, lambda: page.locator("#checklist li").count() > 12 and not page.locator("body.stale").count())
    put_right(page)
    wait(page, lambda: page.locator("#checklist li").count() > 12
         and page.locator("#checklist li.no").count() == 0)  # fmt: skip
    wait(page, lambda: page.input_value("#plan") == "short/plan.yaml")
    page.fill("#session_name", session)
    press_begin(page)


def press_begin(page: Any) -> None:
    """Press the button until a run is shown; where the page says why not, look at the list again, as a person does."""
    said: list[str] = []
    while True:
        wait(page, lambda: page.locator("#checklist li.no").count() == 0 and not refusal(page))
        page.click("#begin")
        wait(page, lambda: page.locator("#during:visible, #after:visible").count() or refusal(page))
        if page.locator("#during:visible").count():
            return
        said.append(refusal(page) or page.inner_text("#ended"))
        assert len(said) < TRIALS, said
        page.click("#tab_before")


def refusal(page: Any) -> str:
    """What the page says of something that was asked for and not done; empty: nothing."""
    text = page.inner_text("#toast") if page.locator("#toast:visible").count() else ""
    return str(text) if text.startswith(NOT_DONE) else ""
