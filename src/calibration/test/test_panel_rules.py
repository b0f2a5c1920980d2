"""Who may see the panel, who may change something, and what may be asked for: the rules without network and ROS."""

from __future__ import annotations

import inspect
import json
import re
import stat
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.web.access import (
    ABSENT,
    IDLE,
    MOST_SESSIONS,
    TOKEN_LIFE,
    Access,
    Control,
    Rate,
    Session,
    host_allowed,
    origin_allowed,
    origins,
    page_token,
    write_private,
)
from calibration.web.folder import Folder
from calibration.web.request_table import KINDS, RequestError, read
from calibration.web.view import Held, _advice, pull

STATIC = Path(__file__).resolve().parents[1] / "calibration" / "web" / "static"


def entered(access: Access, name: str = "Ann", now: float = 0.0) -> tuple[str, Session]:
    found = access.enter(access.token, name, "127.0.0.1", now)
    assert found is not None
    return found


# --- tokens and sessions ------------------------------------------------------------------------------------------


def test_a_token_is_good_for_one_entry() -> None:
    access = Access(0.0)
    token = access.token
    cookie, session = entered(access)
    assert access.token != token
    assert access.enter(token, "Eve", "b", 0.0) is None
    assert len({cookie, session.key, page_token(cookie), token, access.token}) == 5
    assert min(len(cookie), len(page_token(cookie)), len(token)) >= 32


def test_a_wrong_token_is_refused_and_uses_nothing_up() -> None:
    access = Access(0.0)
    token = access.token
    assert access.enter("wrong", "Eve", "b", 0.0) is None
    assert access.enter("", "Eve", "b", 0.0) is None
    assert access.token == token


def test_a_token_and_a_session_grow_old() -> None:
    access = Access(0.0)
    old = access.token
    assert access.enter(old, "Ann", "a", TOKEN_LIFE + 1.0) is None
    cookie, session = entered(access, now=TOKEN_LIFE + 1.0)
    assert access.find(cookie, TOKEN_LIFE + 2.0) is session
    session.pages = 1  # an open page keeps it
    assert access.find(cookie, 10.0 * IDLE) is session
    session.pages, session.used = 0, 0.0
    assert access.find(cookie, IDLE + 1.0) is None
    assert access.sessions == {}


def test_sessions_are_bounded_and_the_one_in_use_stays() -> None:
    access = Access(0.0)
    cookie, first = entered(access)
    first.pages = 1
    for number in range(3 * MOST_SESSIONS):
        entered(access, now=1.0 + number)
    assert len(access.sessions) == MOST_SESSIONS
    assert access.find(cookie, 100.0) is first


def test_sessions_outlive_the_process_and_the_file_holds_no_secret(tmp_path: Path) -> None:
    access, file = Access(0.0), tmp_path / "kept.json"
    (ann, _), (bob, gone), (eve, _) = (entered(access, name, 10.0) for name in ("Ann", "Bob", "Eve"))
    gone.used = 10.0 - IDLE  # Bob was here a shift ago
    write_private(file, access.kept(20.0, 1e9))
    write_private(file, access.kept(20.0, 1e9))
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert [one.name for one in tmp_path.iterdir()] == ["kept.json"]
    assert not any(one in file.read_text("utf-8") for one in (ann, bob, eve, page_token(ann), access.token))
    later = Access(3.0)
    later.restore(file.read_text("utf-8"), 3.0, 1e9 + 100.0)
    assert sorted(one.name for one in later.sessions.values()) == ["Ann", "Eve"]
    found = later.find(ann, 4.0)
    assert found is not None
    assert found.name == "Ann"
    assert later.find(bob, 4.0) is None
    later.leave(found)
    assert later.used(found, 5.0) is None
    much_later = Access(0.0)
    much_later.restore(file.read_text("utf-8"), 0.0, 1e9 + 2.0 * IDLE)
    assert much_later.sessions == {}
    for damaged in ("", "[", "{}x", "[1]", '[{"key": 1}]', '{"a": 1}', "null"):
        with pytest.raises(ValueError, match=r"\w"):
            Access(0.0).restore(damaged, 0.0, 1e9)


# --- control ------------------------------------------------------------------------------------------------------


def test_one_at_a_time_holds_control_and_is_asked_for_it() -> None:
    access, control = Access(0.0), Control()
    (_, ann), (_, bob) = entered(access, "Ann"), entered(access, "Bob")
    ann.pages = bob.pages = 1
    assert control.ask(ann, 0.0)
    assert not control.ask(bob, 1.0)
    assert (control.holder, control.asking) == (ann, bob)
    assert not control.answer(bob, give=True)  # it is not his to give
    assert control.answer(ann, give=False)
    assert (control.holder, control.asking) == (ann, None)
    assert not control.ask(bob, 2.0)
    assert control.answer(ann, give=True)
    assert control.holder is bob
    assert not control.answer(bob, give=True)  # nobody asks


def test_who_is_gone_is_not_asked() -> None:
    access, control = Access(0.0), Control()
    (_, ann), (_, bob) = entered(access, "Ann"), entered(access, "Bob")
    ann.pages = 1
    assert control.ask(ann, 0.0)
    ann.pages, ann.left = 0, 10.0
    assert not control.ask(bob, 10.0 + 0.5 * ABSENT)
    assert control.ask(bob, 10.0 + ABSENT)
    control.release(bob)
    assert control.holder is None


def test_a_rate_gives_its_reserve_then_its_rate() -> None:
    rate = Rate(2.0, 4)
    assert [rate.take("a", 0.0) for _ in range(6)] == [True] * 4 + [False] * 2
    assert rate.take("b", 0.0)
    assert [rate.take("a", 1.0) for _ in range(3)] == [True, True, False]


def test_strangers_do_not_fill_the_memory() -> None:
    rate = Rate(1.0, 2)
    for number in range(5000):
        rate.take(str(number), 0.01 * number)
    assert len(rate._left) < 1500


# --- from where ---------------------------------------------------------------------------------------------------


def test_served_hosts_are_ours_and_no_others() -> None:
    own = origins("192.168.1.7", ["cell-pc", "https://cell.example/"], 8420)
    for host in (
        "127.0.0.1:8420",
        "localhost:8420",
        "LOCALHOST:8420",
        "[::1]:8420",
        "192.168.1.7:8420",
        "cell-pc:8420",
        "cell.example",
    ):
        assert host_allowed(host, own), host
    for host in (None, "", "evil.example:8420", "127.0.0.1", "127.0.0.1:80", "localhost:8420.evil.example",
                 "evil.example:8420@localhost:8420", "0.0.0.0:8420", "cell.example:8420"):  # fmt: skip
        assert not host_allowed(host, own), host
    assert host_allowed("localhost", origins("127.0.0.1", [], 80))
    assert host_allowed("[fe80::1]:1", origins("fe80::1", [], 1))
    assert not host_allowed("0.0.0.0:1", origins("0.0.0.0", [], 1))


def test_an_origin_is_the_page_itself() -> None:
    host, own = "127.0.0.1:8420", origins("127.0.0.1", ["https://cell.example"], 8420)
    assert origin_allowed("http://127.0.0.1:8420", host, own)
    for origin in (None, "null", "", "https://127.0.0.1:8420", "http://127.0.0.1:8421", "http://127.0.0.1",
                   "http://127.0.0.1:8420.evil.example", "http://evil.example", "http://localhost:8420",
                   "https://cell.example"):  # fmt: skip
        assert not origin_allowed(origin, host, own), origin
    assert origin_allowed("https://cell.example", "cell.example", own)
    assert not origin_allowed("http://cell.example", "cell.example", own)


# --- what ---------------------------------------------------------------------------------------------------------

LOAD = {"configuration": 3, "step": 1}


def test_a_request_is_read_with_its_defaults() -> None:
    assert read("load_applied", LOAD) == {**LOAD, "override": False, "reason": ""}
    assert read("override_condition", {"condition": " t ", "reason": "needed "}) == {
        "condition": "t",
        "reason": "needed",
    }
    assert read("stop", {}) == {}


@pytest.mark.parametrize(
    ("name", "given_"),
    [
        ("shutdown", {}),
        ("stop", {"more": 1}),
        ("stop", []),
        ("load_applied", {"configuration": 3}),
        ("load_applied", {**LOAD, "step": "1"}),
        ("load_applied", {**LOAD, "step": True}),
        ("load_applied", {**LOAD, "step": -1}),
        ("load_applied", {**LOAD, "step": 1.5}),
        ("load_applied", {**LOAD, "override": 1}),
        ("load_applied", {**LOAD, "reason": "x" * 501}),
        ("override_condition", {"condition": "a", "reason": "two\nlines"}),
        ("override_condition", {"condition": "a", "reason": "\u202eevil"}),
        ("hold_time", {"seconds": float("nan")}),
        ("hold_time", {"seconds": 31.0}),
        *(("identify", {"what": "stiffness", "session": one}) for one in ("../../etc", ".hidden", "a/b", "")),
        ("identify", {"what": "rm -rf", "session": "a"}),
    ],
)
def test_what_is_malformed_is_refused_in_one_line(name: str, given_: Any) -> None:
    with pytest.raises(RequestError) as caught:
        read(name, given_)
    assert "\n" not in str(caught.value)
    assert "expected" in str(caught.value)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda one: st.lists(one, max_size=3),
    max_leaves=5,
)


@settings(deadline=None)  # how fast a machine is says nothing of what it reads
@given(
    name=st.sampled_from(sorted(KINDS)), given_=st.dictionaries(st.text(max_size=12), JSON, max_size=4), data=st.data()
)
def test_whatever_comes_is_read_or_refused(name: str, given_: dict[str, Any], data: st.DataObject) -> None:
    fields = KINDS[name].fields
    given_ |= {key: data.draw(JSON) for key in fields if data.draw(st.booleans())}
    try:
        values = read(name, given_)
    except RequestError:
        return
    assert values.keys() == fields.keys()
    json.dumps(values, allow_nan=False)


def test_a_stop_needs_no_control_and_everything_that_moves_does() -> None:
    free = {name for name, kind in KINDS.items() if not kind.control}
    assert free == {"stop", "control_ask", "control_release", "operator"}


# --- the load -----------------------------------------------------------------------------------------------------


WANTED, FAULT = [0.0, 0.0, -1000.0], "force: wanted, found"


@pytest.mark.parametrize(
    ("wanted", "felt", "band", "fault", "against", "by_itself"),
    [
        (WANTED, [0.0, 50.0, -1000.0], 20.0, "", "", True),
        (WANTED, [0.0, 0.0, -900.0], 20.0, FAULT, "force_too_small", False),
        (WANTED, [0.0, 0.0, -1100.0], 20.0, FAULT, "force_too_great", False),
        (WANTED, [0.0, 150.0, -990.0], 20.0, FAULT, "direction_off", False),
        (WANTED, [0.0, 0.0, 1000.0], 20.0, FAULT, "direction_off", False),
        (WANTED, [0.0, 0.0, -1000.0], 20.0, "torque: wanted, found", "load_differs", False),
        (WANTED, None, 20.0, "", "load_not_felt", False),
        (WANTED, None, None, "", "", False),  # nothing is checked: the operator's word is enough, and is needed
        (WANTED, [0.0, 0.0, -1000.0], None, "", "", False),
        ([0.0, 0.0, 0.0], [3.0, 0.0, 0.0], 20.0, "", "", False),  # a release: the robot moves after it
        ([0.0, 0.0, 0.0], [100.0, 100.0, 100.0], 20.0, FAULT, "not_released", False),
        ([0.0, 0.0, 0.0], None, None, "", "", False),
    ],
)
def test_what_the_sensor_feels_is_judged_by_the_sequencer_and_a_release_needs_a_hand(
    wanted: list[float], felt: list[float] | None, band: float | None, fault: str, against: str, by_itself: bool
) -> None:
    one = pull(wanted, felt, band, 0.1, fault)
    assert (one.against, one.by_itself) == (against, by_itself)


def test_a_load_is_held_without_a_break_and_for_its_own_step() -> None:
    held = Held()
    assert [held.look(("a", 1), now, fits=True) for now in (0.0, 1.0, 2.5)] == [0.0, 1.0, 2.5]
    assert held.look(("a", 1), 3.0, fits=False) == 0.0
    assert [held.look(("a", 1), now, fits=True) for now in (4.0, 5.0)] == [0.0, 1.0]
    assert held.look(("a", 2), 6.0, fits=True) == 0.0


def test_a_load_that_is_held_is_confirmed_once() -> None:
    held = Held()
    held.look(("a", 1, -900.0), 0.0, fits=True)
    assert not held.take(10.0, 0.0)  # never, by default
    assert [held.take(now, 2.0) for now in (1.0, 2.0, 3.0)] == [False, True, False]
    held.look(("a", 1, 0.0), 4.0, fits=True)  # the release of the same step
    assert [held.take(now, 2.0) for now in (5.0, 6.0, 7.0)] == [False, True, False]
    held.look(("a", 1, 0.0), 8.0, fits=False)
    held.look(("a", 1, 0.0), 9.0, fits=True)  # somebody has changed it meanwhile
    assert held.take(11.0, 2.0)
    held.refused(12.0)  # it was not heard, or refused: it is asked again
    assert [held.take(now, 2.0) for now in (13.0, 14.0, 15.0)] == [False, True, False]


# --- files --------------------------------------------------------------------------------------------------------


def test_only_listed_files_of_a_session_are_handed_out(tmp_path: Path) -> None:
    session = tmp_path / "one"
    (session / "identify").mkdir(parents=True)
    for name in ("session.db", "secret.txt", "identify/result.json", "identify/other.txt"):
        (session / name).write_text("x", "utf-8")
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "plan.yaml").write_text("x", "utf-8")
    for name in ("one/diagnose/next.yaml", "one/identify/model.yaml", "one/next.yaml", "one/model.yaml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("x", "utf-8")
    folder = Folder(tmp_path)
    assert sorted(folder.plans()) == ["made/plan.yaml", "one/diagnose/next.yaml"]
    assert [one["name"] for one in folder.sessions()] == ["one"]
    assert set(folder.files("one")) == {"model.yaml", "identify/model.yaml", "identify/result.json"}
    for name in ("..", ".", "../one", "a/b", "", "a\x00b", "-rf"):
        with pytest.raises(RequestError):
            folder.files(name)
    assert Folder(tmp_path / "none").sessions() == []
    assert Folder(tmp_path / "none").free() is None


def test_hidden_files_and_what_is_no_plan_are_not_offered(tmp_path: Path) -> None:
    for name in ("plan.yaml", "my.cell.yaml", "other.yaml", ".pre-commit-config.yaml", ".cache/plan.yaml",
                 ".old/diagnose/next.yaml", "one/plan.yaml", "one/diagnose/next.yaml", "one/diagnose/model.yaml",
                 ".old/identify/model.yaml", "one/session.db", ".old/session.db"):  # fmt: skip
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("robot: x\nconfigurations:\n" if name == "other.yaml" else "robot: x\n", "utf-8")
    for root in (tmp_path, tmp_path / ".old" / ".."):
        folder = Folder(root)
        assert sorted(folder.plans()) == ["one/diagnose/next.yaml", "one/plan.yaml", "other.yaml", "plan.yaml"]
        assert [one["name"] for one in folder.sessions()] == ["one"]


# --- the page -----------------------------------------------------------------------------------------------------


MADE = re.compile(  # keys that the page puts together from codes
    "(against|check|column|drives|fault|help|mode|node|party|phase|reason|remedy|scene|self_test|state|stream|test"
    "|usable|verdict)_"
)


def words() -> dict[str, list[str]]:
    return dict(json.loads((STATIC / "words.json").read_text("utf-8")))


def test_every_word_of_the_page_is_there_in_both_languages_and_used() -> None:
    marks = re.compile(r"\{\w+\}")
    for key, (english, german) in words().items():
        assert english, key
        assert set(marks.findall(english)) == set(marks.findall(german)), key
    used = set()
    for path in STATIC.glob("*.js"):
        used |= set(re.findall(r'\b(?:w|card)\("(\w+)"', path.read_text("utf-8")))
    assert len(used) > 80
    assert used - words().keys() == set()
    scripts = "".join(path.read_text("utf-8") for path in STATIC.glob("*.js"))
    assert [one for one in words() if not MADE.match(one) and f'"{one}"' not in scripts] == []


def test_every_code_of_the_nodes_has_words() -> None:
    pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")
    from calibration.manager import NAMES
    from calibration.web.view import CONSTANTS

    codes = [f"node_{one}" for one in NAMES]
    codes += [f"reason_{one}" for one in CONSTANTS["Permission"]["reasons"].values()]
    codes += [f"state_{one}" for one in CONSTANTS["ProcedureState"]["state"].values()]
    codes += [f"party_{one}" for one in CONSTANTS["ProcedureState"]["waits_for"].values()]
    codes += [f"verdict_{one}" for one in CONSTANTS["ProcedureState"]["reading_verdict"].values()]
    problems = (*CONSTANTS["SampleCheck"]["problem"].values(), "not_heard")
    codes += [f"stream_{one}" for one in problems]
    codes += [f"against_{one}" for one in re.findall(r'return "(\w+)"', inspect.getsource(_advice))]
    codes += [f"mode_{one}" for one in CONSTANTS["RobotState"]["operating_mode"].values()]
    codes += [f"drives_{one}" for one in CONSTANTS["RobotState"]["drives"].values()]
    faults = Path(STATIC.parents[1] / "manager.py").read_text("utf-8")
    found = re.findall(r'_fault\(Fault[^"]*"(\w+)"|code = "(\w+)" if .* else "(\w+)"', faults)
    codes += [f"fault_{one}" for row in found for one in row if one]
    assert [one for one in codes if one not in words()] == []


def test_the_page_is_small_and_brings_everything_with_it() -> None:
    files = [path for path in STATIC.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) <= 300_000
    for path in files:
        text = path.read_text("utf-8")
        foreign = [one for one in re.findall(r"https?://[^\s\"'`]+", text) if not one.startswith("http://www.w3.org/")]
        assert foreign == [], path
        for sink in (
            "innerHTML",
            "outerHTML",
            "insertAdjacentHTML",
            "document.write",
            "eval(",
            "new Function",
            "srcdoc",
        ):
            assert sink not in text, f"{path}: {sink}"
    page = (STATIC / "index.html").read_text("utf-8")
    assert not re.search(r"\son\w+=|<style|javascript:", page)
    assert re.findall(r"<script([^>]*)>([^<]*)</script>", page) == [(' type="module" src="/static/app.js"', "")]


def contrast(one: str, other: str) -> float:
    """Contrast of two colours (WCAG 2.2, relative luminance)."""

    def luminance(colour: str) -> float:
        parts = [int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)]
        r, g, b = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
        return 0.2126 * r + 0.7152 * g + 0.0722 * b

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_what_cannot_be_pressed_looks_so_wherever_it_stands() -> None:
    """A rule for the buttons of one place is as strong as that for dashed ones, and the later one holds."""
    css = (STATIC / "panel.css").read_text("utf-8")
    _, dashed, later = css.partition("button:disabled {")
    assert dashed
    rules = re.findall(r"^([^{}@]*\bbutton\b[^{}]*)\{([^}]*)\}", later.partition("}")[2], re.MULTILINE)
    assert rules
    for selectors, body in rules:
        if "border" in body or "background" in body:
            assert all("[aria-" in one or ":enabled" in one for one in selectors.split(",")), selectors


def test_colours_can_be_read_in_sunlight() -> None:
    css = (STATIC / "panel.css").read_text("utf-8")
    colours = dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", css))
    on_paper = ("ink", "good", "bad", "accent", "pull", "felt", "line")
    assert {name: contrast(colours[name], colours["paper"]) >= 7.0 for name in on_paper} == dict.fromkeys(
        on_paper, True
    )
    assert contrast(colours["ink"], colours["soft"]) >= 7.0
    assert contrast("#404040", "#ffffff") >= 7.0  # what cannot be pressed now
