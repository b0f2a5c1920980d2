"""How the page behaves in a browser, by states that the test tells: no cell, one node, some seconds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.msg import Condition, Conditions, Fault, Permission, ProcedureState, State
from panel_cell import CELL, browser, opened
from panel_cell import wait as patiently
from panel_client import parameters

from calibration.topics import STATE

SESSION = "today"
OFTEN = 0.2  # s between two states
PATIENCE = 20.0  # s, that a page may take to show what it was sent
SLOW_SOCKET = """
const Quick = window.WebSocket;
window.WebSocket = class extends Quick {
  addEventListener(kind, heard) {
    super.addEventListener(kind, kind === "message" ? (event) => setTimeout(() => heard(event), 600) : heard);
  }
};"""
COVERED = """() => {
  const one = document.activeElement, [top, foot] = ["top", "foot"].map((id) => document.getElementById(id));
  if (!one || one === document.body || top.contains(one) || foot.contains(one)) return null;
  const seen = one.getBoundingClientRect(), high = top.getBoundingClientRect().bottom;
  const low = foot.getBoundingClientRect().top;
  const fits = seen.height <= low - high;
  const covered = fits ? seen.top < high || seen.bottom > low : seen.bottom <= high || seen.top >= low;
  return covered ? `${one.id}: ${seen.top} to ${seen.bottom} of ${high} to ${low}` : null;
}"""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """One browser for the file."""
    with browser() as one:
        yield one


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Folder of plans and sessions, with one plan."""
    (tmp_path / "plan.yaml").write_text("x", "utf-8")
    return tmp_path


@pytest.fixture
def page_of(chromium: Any, folder: Path, spinning: Any) -> Iterator[Callable[..., Any]]:
    """Pages of a panel that was started with the session `today`; each is of a device of its own."""
    from calibration.panel import PanelNode

    given = parameters(cell=str(CELL), session=str(folder / SESSION), port=0)
    panel = spinning.add(PanelNode(context=spinning.context, parameter_overrides=given))
    pages = []

    def make(prepare: Callable[[Any], object] = lambda _: None, **options: Any) -> Any:
        server = panel._server
        pages.append(opened(chromium, server.settings.address, server.access.token, prepare=prepare, **options))
        pages[-1].set_default_timeout(1e3 * PATIENCE)
        return pages[-1]

    yield make
    for page in pages:
        assert page.errors == []
        page.context.close()


@pytest.fixture
def state(spinning: Any) -> State:
    """A state that is published again and again; the test changes it."""
    procedure = ProcedureState(seconds_left=math.nan, averaged=math.nan, band_force=math.nan, band_angle=math.nan)
    one = State(procedure=procedure, procedure_known=True, permission_known=True)
    one.permission = Permission(permitted=True, speed=0.0, speed_limit=0.25)
    node = spinning.plain("cell")
    publisher = node.create_publisher(STATE.message, STATE.relative, STATE.qos)
    node.create_timer(OFTEN, lambda: publisher.publish(one))
    return one


def wait(page: Any, condition: Callable[[], Any]) -> None:
    patiently(page, condition, PATIENCE)


def measured(folder: Path, name: str) -> None:
    """Leave a session in the folder."""
    (folder / name).mkdir()
    (folder / name / "session.db").write_text("x", "utf-8")


def control(page: Any) -> None:
    page.click("#control")
    wait(page, lambda: "main" not in (page.get_attribute("#control", "class") or ""))


# --- the name of the session -----------------------------------------------------------------------------------------


def slow_socket(page: Any) -> None:
    page.add_init_script(SLOW_SOCKET)


def slow_folder(page: Any) -> None:
    page.add_init_script(
        "const quick = window.fetch; window.fetch = async (...all) => { const found = await quick(...all);"
        'if (String(all[0]).includes("folder")) await new Promise((go) => setTimeout(go, 1500)); return found; };'
    )


@pytest.mark.parametrize("prepare", [slow_socket, pytest.param(slow_folder, marks=pytest.mark.slow)])
def test_the_session_of_the_launch_file_is_proposed_whatever_comes_first(
    page_of: Callable[..., Any], state: State, prepare: Callable[[Any], None]
) -> None:
    page = page_of(prepare)
    wait(page, lambda: page.input_value("#session_name") == SESSION)


@pytest.mark.parametrize("prepare", [slow_socket, pytest.param(slow_folder, marks=pytest.mark.slow)])
def test_what_the_operator_has_typed_stays(
    page_of: Callable[..., Any], state: State, prepare: Callable[[Any], None]
) -> None:
    page = page_of(prepare)
    page.fill("#session_name", "mine")
    wait(page, lambda: page.locator("#plan option").count() == 1 and page.inner_text("#now") != "")
    page.click("#tab_after")
    page.click("#tab_before")
    page.wait_for_timeout(500)
    assert page.input_value("#session_name") == "mine"
    page.fill("#session_name", "")
    page.wait_for_timeout(500)
    assert page.input_value("#session_name") == ""


def test_a_name_that_is_used_is_not_proposed_again(
    page_of: Callable[..., Any], state: State, folder: Path, spinning: Any
) -> None:
    from calibration_interfaces.action import RunPlan
    from rclpy.action import ActionServer

    runs = []

    def measure(handle: Any) -> Any:
        runs.append(Path(handle.request.session).name)
        measured(folder, runs[-1])
        handle.succeed()
        return RunPlan.Result()

    node = spinning.plain("sequencer")
    spinning.executor.create_task(lambda: ActionServer(node, RunPlan, "sequencer/run", measure))
    page = page_of()
    control(page)
    for name in (SESSION, f"{SESSION}-2", f"{SESSION}-3"):
        page.click("#tab_before")
        wait(page, lambda name=name: page.input_value("#session_name") == name)
        if name == f"{SESSION}-2":
            page.fill("#session_name", "mine")
            name = "mine"
            measured(folder, f"{SESSION}-2")
        wait(page, lambda: page.locator("#begin").is_enabled())
        page.click("#begin")
        wait(page, lambda: page.locator("#during:visible").count() == 1)
        wait(page, lambda name=name: runs[-1:] == [name])
    assert runs == [SESSION, "mine", f"{SESSION}-3"]


# --- how a run stands ------------------------------------------------------------------------------------------------


def test_the_time_left_is_shown_while_there_is_any(page_of: Callable[..., Any], state: State) -> None:
    state.procedure.state, state.procedure.seconds_left = ProcedureState.READING, 2160.0
    state.procedure.configurations_skipped = 1
    page = page_of()
    wait(page, lambda: page.inner_text("#left") == "Time left: 36 min · 1 left out")
    state.procedure.state, state.procedure.seconds_left = ProcedureState.FINISHED, 0.0
    wait(page, lambda: "over" in page.inner_text("#now"))
    page.click("#tab_during")
    wait(page, lambda: page.inner_text("#left") == "1 left out")


@pytest.mark.parametrize(("held", "shown", "hidden"), [(False, "resume", "resume_motion"),
                                                       (True, "resume_motion", "resume")])  # fmt: skip
@pytest.mark.parametrize("doing", [ProcedureState.READY, pytest.param(ProcedureState.LOADING, marks=pytest.mark.slow)])
def test_one_button_goes_on_after_a_pause(
    page_of: Callable[..., Any], state: State, held: bool, shown: str, hidden: str, doing: int
) -> None:
    state.procedure.state, state.procedure.waits_for = doing, ProcedureState.OPERATOR
    state.procedure.paused, state.procedure.held = True, held
    page = page_of()
    wait(page, lambda: page.locator(f"#{shown}:visible").count() == 1)
    assert page.locator(f"#{hidden}:visible").count() == 0
    assert page.locator("#pause:visible").count() == 0


# --- questions -------------------------------------------------------------------------------------------------------


def asked(page_of: Callable[..., Any], state: State, spinning: Any) -> tuple[Any, list[str]]:
    """A page where the guard has latched and a load is awaited, and the requests that reach the cell."""
    from calibration_interfaces.srv import LoadApplied, ResetGuard

    requests: list[str] = []

    def answer(name: str) -> Callable[[Any, Any], Any]:
        return lambda _, response: (requests.append(name), response)[1]

    node = spinning.plain("others")
    node.create_service(ResetGuard, "guard/reset", answer("reset"))
    node.create_service(LoadApplied, "sequencer/load_applied", answer("load_applied"))
    state.permission.permitted, state.permission.latched = False, True
    state.procedure.state, state.procedure.waits_for = ProcedureState.LOADING, ProcedureState.OPERATOR
    state.procedure.load_awaited = state.procedure.load_felt_known = True
    state.procedure.target.force.z, state.procedure.load_felt.force.z, state.procedure.band_force = -900.0, -500.0, 25.0
    page = page_of()
    control(page)
    wait(page, lambda: page.locator("#reset:visible:enabled").count() == 1)
    return page, requests


def focused(page: Any) -> str:
    return str(page.evaluate("document.activeElement.id"))


def test_a_question_begins_at_the_answer_that_does_nothing(
    page_of: Callable[..., Any], state: State, spinning: Any
) -> None:
    page, requests = asked(page_of, state, spinning)
    page.focus("#reset")
    for press in ("Enter", "Escape"):  # on the answer that has the focus, and wherever it is
        page.keyboard.press("Enter")
        wait(page, lambda: page.locator("#sure:visible").count() == 1)
        assert focused(page) == "sure_no"
        page.keyboard.press(press)
        wait(page, lambda: page.locator("#sure").count() == 0)
        assert focused(page) == "reset"
    page.click("#reset")
    page.focus("#tab_during")
    page.keyboard.press("Escape")
    wait(page, lambda: page.locator("#sure").count() == 0)
    assert focused(page) == "tab_during"  # who has gone elsewhere stays there
    page.click("#reset")
    page.click("#sure_yes")
    wait(page, lambda: requests == ["reset"])


def test_a_reason_is_asked_for_and_no_reason_does_nothing(
    page_of: Callable[..., Any], state: State, spinning: Any
) -> None:
    page, requests = asked(page_of, state, spinning)
    page.click("#override")
    assert focused(page) == "sure_reason"
    page.keyboard.type("the sensor is off")
    page.keyboard.press("Escape")
    wait(page, lambda: page.locator("#sure").count() == 0)
    page.click("#override")
    page.click("#reset")  # another question: the first one is answered with no
    assert page.locator("#sure").count() == 1
    assert focused(page) == "sure_no"
    page.keyboard.press("Escape")
    page.click("#override")
    page.keyboard.type("the sensor is off")
    page.click("#sure_yes")
    wait(page, lambda: requests == ["load_applied"])


# --- by keyboard -----------------------------------------------------------------------------------------------------


def crowded(state: State) -> None:
    """Have much to show: faults, reasons, conditions."""
    state.faults = [
        Fault(level=Fault.WARN, code="suspicious", source=f"configuration {k}", text=f"[{k}] is odd", remedy="again")
        for k in range(3)
    ]
    state.conditions = Conditions(
        conditions=[Condition(name=f"c{k}", requirement="as it should be", verdict=Condition.MET) for k in range(12)]
    )


@pytest.mark.parametrize(("size", "key"), [
    ((600, 700), "Tab"), ((1280, 700), "Shift+Tab"),
    *(pytest.param(size, key, marks=pytest.mark.slow) for size, key in
      (((600, 700), "Shift+Tab"), ((1280, 700), "Tab"), ((800, 900), "Tab"), ((800, 900), "Shift+Tab"))),
])  # fmt: skip
def test_what_has_the_focus_is_never_covered(
    page_of: Callable[..., Any], state: State, spinning: Any, folder: Path, size: tuple[int, int], key: str
) -> None:
    crowded(state)
    measured(folder, "old")
    page, _ = asked(page_of, state, spinning)
    page.set_viewport_size({"width": size[0], "height": size[1]})
    found = []
    for part in ("before", "during", "after"):
        page.click(f"#tab_{part}")
        for message in (False, True):
            page.evaluate(f"document.getElementById('toast').textContent = 'Not done: {'a reason ' * 20}'")
            page.evaluate(f"document.getElementById('toast').hidden = {str(not message).lower()}")
            page.evaluate("document.activeElement.blur()")
            for _ in range(30):
                page.keyboard.press(key)
                page.wait_for_timeout(10)
                found.append(page.evaluate(COVERED))
    assert [one for one in found if one] == []


def test_what_has_the_focus_comes_out_from_under_a_message(
    page_of: Callable[..., Any], state: State, spinning: Any
) -> None:
    crowded(state)
    page, _ = asked(page_of, state, spinning)
    page.set_viewport_size({"width": 800, "height": 700})
    page.click("#tab_before")
    wait(page, lambda: page.locator("#toast:visible").count() == 0)
    page.focus("#plan_name")
    page.evaluate("document.getElementById('toast').textContent = 'Not done: a reason'")
    page.evaluate("""const low = document.getElementById("foot").getBoundingClientRect().top;
        window.scrollBy(0, document.activeElement.getBoundingClientRect().bottom - low + 2);
        document.getElementById("toast").hidden = false""")
    page.wait_for_timeout(100)
    assert page.evaluate(COVERED) is None
    assert page.evaluate("document.activeElement.getBoundingClientRect().bottom") > 400  # it has not gone elsewhere
