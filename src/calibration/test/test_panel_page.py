"""How the page behaves in a browser, by states that the test tells: no cell, one node, some seconds."""

from __future__ import annotations

import math
import threading
import time
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
OFTEN = 0.1  # s between two states
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
def quiet() -> threading.Event:
    """While it is set, no state is published: the manager is silent."""
    return threading.Event()


@pytest.fixture
def state(spinning: Any, quiet: threading.Event) -> State:
    """A state that is published again and again; the test changes it."""
    procedure = ProcedureState(seconds_left=math.nan, averaged=math.nan, band_force=math.nan, band_angle=math.nan)
    one = State(procedure=procedure, procedure_known=True, permission_known=True)
    one.permission = Permission(permitted=True, speed=0.0, speed_limit=0.25)
    node = spinning.plain("cell")
    publisher = node.create_publisher(STATE.message, STATE.relative, STATE.qos)
    node.create_timer(OFTEN, lambda: None if quiet.is_set() else publisher.publish(one))
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


def test_what_is_done_and_a_pause_at_a_load_step_are_shown(page_of: Callable[..., Any], state: State) -> None:
    state.procedure.state, state.procedure.waits_for = ProcedureState.LOADING, ProcedureState.OPERATOR
    page = page_of()
    wait(page, lambda: page.inner_text("#now").startswith("Load of configuration"))
    state.procedure.paused = True
    wait(page, lambda: page.inner_text("#now").endswith("Paused: nothing moves after this"))
    state.procedure.state, state.procedure.kind, state.procedure.paused = ProcedureState.MOVING, "startup", False
    wait(page, lambda: page.inner_text("#now") == "Start-up cycle: Move")


def test_a_load_that_was_left_on_is_told_at_the_top_of_every_part(page_of: Callable[..., Any], state: State) -> None:
    one = state.procedure
    one.state, one.load_left, one.load_felt_known = ProcedureState.FINISHED, "a load may be on since a1", True
    one.load_felt.force.z = -1176.0
    page = page_of()
    for part in ("before", "during", "after"):
        page.click(f"#tab_{part}")
        wait(page, lambda: page.inner_text("#load_left").startswith("1,176 N pull at the tool: release the load."))
    one.load_left = ""
    wait(page, lambda: page.locator("#load_left:visible").count() == 0)


def test_after_a_stop_one_button_goes_on_with_the_session(
    page_of: Callable[..., Any], state: State, folder: Path, spinning: Any
) -> None:
    from calibration_interfaces.action import RunPlan
    from rclpy.action import ActionServer

    goals = []

    def measure(handle: Any) -> Any:
        goals.append((Path(handle.request.plan).name, Path(handle.request.session).name, handle.request.resume))
        handle.succeed()
        return RunPlan.Result()

    node = spinning.plain("sequencer")
    spinning.executor.create_task(lambda: ActionServer(node, RunPlan, "sequencer/run", measure))
    measured(folder, "a1")
    one = state.procedure
    one.state, one.configurations_done, one.configurations_total = ProcedureState.READING, 1, 3
    one.session, one.plan = str(folder / "a1"), str(folder / "plan.yaml")
    page = page_of()
    control(page)
    wait(page, lambda: "being read" in page.inner_text("#now"))
    assert page.locator("#go_on:visible").count() == 0
    one.state, one.session = ProcedureState.NO_RUN, ""  # the sequencer was killed, and is there again
    wait(page, lambda: page.locator("#go_on:visible").count() == 1)
    assert page.inner_text("#go_on") == "Go on with a1"
    page.dblclick("#go_on")
    wait(page, lambda: goals == [("plan.yaml", "a1", True)])


# --- what is old -----------------------------------------------------------------------------------------------------

OLD = """() => new MutationObserver(() => {
  const [shown, against] = ["permit", "against"].map((id) => document.getElementById(id));
  const told = document.body.classList.contains("stale") && shown.textContent.includes("not known")
    && getComputedStyle(against).visibility === "hidden";
  if (told && !window.old) window.old = Date.now();
}).observe(document.body, { attributes: true, childList: true, subtree: true, characterData: true })"""
GREY = 1.0  # s, after which nothing is shown as current that was told before


def test_nothing_of_a_silent_manager_is_shown_as_current(
    page_of: Callable[..., Any], state: State, quiet: threading.Event, folder: Path, spinning: Any
) -> None:
    page, _ = asked(page_of, state, spinning)
    state.permission.permitted, state.permission.latched = True, False
    wait(page, lambda: page.inner_text("#against").startswith("Pull harder."))
    state.procedure.state = ProcedureState.FINISHED  # or the button is dashed anyway
    page.click("#tab_before")
    wait(page, lambda: page.locator("#begin").is_enabled())
    assert "not known" not in page.inner_text("#checked")
    page.click("#tab_during")
    wait(page, lambda: page.inner_text("#permit").startswith("The robot may move"))
    page.evaluate(OLD)
    quiet.set()
    cut = time.time()
    wait(page, lambda: page.evaluate("window.old"))
    print(f"silent manager: grey after {page.evaluate('window.old') / 1e3 - cut:.2f} s")
    assert page.evaluate("window.old") / 1e3 - cut <= GREY + OFTEN
    assert "The manager is silent" in page.inner_text("#lost")
    page.click("#tab_before")
    wait(page, lambda: page.inner_text("#begin_why") == "Not now: the state of the cell is not known.")
    assert page.inner_text("#checked") == "It is not known whether everything is in order."
    quiet.clear()
    wait(page, lambda: page.locator("#begin").is_enabled() and not page.locator("body.stale").count())


# --- a hand ----------------------------------------------------------------------------------------------------------


def test_a_load_may_confirm_itself_while_somebody_looks_and_a_release_never_does(
    page_of: Callable[..., Any], state: State, spinning: Any
) -> None:
    page, requests = asked(page_of, state, spinning)
    page.click("#tab_before")
    page.select_option("#hold", "1")
    one = state.procedure
    one.load_felt.force.z, one.load_fault, one.band_force = -900.0, "", math.nan  # what is not checked
    page.wait_for_timeout(1500)
    one.load_felt_known, one.band_force = False, 25.0  # what is not felt
    page.wait_for_timeout(1500)
    one.load_felt_known, one.target.force.z, one.load_felt.force.z = True, 0.0, 0.0  # a release
    page.click("#tab_during")
    wait(page, lambda: page.locator("#confirm:enabled").count() == 1)
    page.wait_for_timeout(1500)
    assert requests == []
    assert page.inner_text("#confirm") == "The load is released"
    page.dblclick("#confirm")
    wait(page, lambda: requests == ["load_applied"])
    wait(page, lambda: page.inner_text("#toast") == "The load is released.")
    one.step, one.target.force.z, one.load_felt.force.z = 1, -900.0, -900.0
    page.goto("about:blank")  # nobody looks
    page.wait_for_timeout(2000)
    assert len(requests) == 1
    page.go_back()
    wait(page, lambda: len(requests) == 2)


def test_two_quick_taps_are_one(page_of: Callable[..., Any], state: State) -> None:
    page = page_of()
    wait(page, lambda: page.inner_text("#begin_why") == "Take control first.")
    page.dblclick("#control")
    wait(page, lambda: page.inner_text("#control") == "Give control back")
    page.wait_for_timeout(1100)
    assert page.inner_text("#control") == "Give control back"
    page.click("#control")
    wait(page, lambda: page.inner_text("#control") == "Take control")


def test_without_a_session_the_page_says_that_there_is_no_stop(page_of: Callable[..., Any], state: State) -> None:
    page = page_of()
    page.click("#menu_button")
    page.click("#leave")
    page.click("#sure_yes")
    page.wait_for_selector("#no_stop:visible")
    assert page.locator("#stop").count() == 0


def test_a_condition_is_overridden_by_name_at_its_fault(
    page_of: Callable[..., Any], state: State, spinning: Any
) -> None:
    from calibration_interfaces.srv import OverrideCondition

    given = []

    def take(request: Any, response: Any) -> Any:
        given.append((request.override.condition, request.override.operator_name, request.override.reason))
        return response

    spinning.plain("sequencer").create_service(OverrideCondition, "sequencer/override_condition", take)
    text = "temperature (5.2): found 27 degC"
    state.faults = [Fault(level=Fault.ERROR, code="condition", source="temperature", text=text, remedy="override it")]
    page = page_of()
    control(page)
    page.click("[data-override=temperature]:enabled")
    page.keyboard.type("the hall is warm")
    page.click("#sure_yes")
    wait(page, lambda: given == [("temperature", "Ann", "the hall is warm")])


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
    state.procedure.load_fault = "force: wanted (0, 0, -900) N, found (0, 0, -500) N"
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
    page.focus("#session_name")
    page.evaluate("document.getElementById('toast').textContent = 'Not done: a reason'")
    page.evaluate("""const low = document.getElementById("foot").getBoundingClientRect().top;
        window.scrollBy(0, document.activeElement.getBoundingClientRect().bottom - low + 2);
        document.getElementById("toast").hidden = false""")
    page.wait_for_timeout(100)
    assert page.evaluate(COVERED) is None
    assert page.evaluate("document.activeElement.getBoundingClientRect().bottom") > 400  # it has not gone elsewhere
