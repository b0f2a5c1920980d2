"""A whole short measurement in a real browser, click by click, from the checklist to the report."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from panel_cell import LONG, Cell, begin, browser, browser_path, press_begin, short_plan, wait

from calibration_core.measurement.session import Session

CONFIGURATIONS = 2
SIZES = {"wide": {"viewport": {"width": 1280, "height": 800}},
         "upright": {"viewport": {"width": 800, "height": 1280}, "has_touch": True, "locale": "de-DE"}}  # fmt: skip


@pytest.fixture
def cell(spinning: Any, source_environment: dict[str, str], tmp_path: Path) -> Iterator[Cell]:
    """The simulated cell where an operator brings on the loads."""
    browser_path()
    short_plan(tmp_path, CONFIGURATIONS)
    one = Cell(source_environment, spinning.plain("hands"), tmp_path, by="operator")
    one.runner.start()
    yield one
    one.runner.shutdown()


def look(page: Any, folder: Path, name: str) -> None:
    """Keep a picture; nothing is wider than the page."""
    page.screenshot(path=folder / f"{name}.png")
    assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]


def measure(page: Any, pictures: Path) -> int:
    """Measure until the run is over; return the clicks."""
    clicks, seen = 0, set()
    end = time.monotonic() + LONG
    while "over" not in page.inner_text("#now") and "beendet" not in page.inner_text("#now"):
        assert time.monotonic() < end, page.inner_text("body")
        if page.locator("#confirm:visible:enabled").count():
            if "load" not in seen:
                seen.add("load")
                look(page, pictures, "load")
            before = page.inner_text("#now")
            page.click("#confirm")
            clicks += 1
            wait(page, lambda before=before: page.inner_text("#now") != before)
        if "averaging" not in seen and "%" in page.inner_text("#averaging"):
            seen.add("averaging")
            look(page, pictures, "averaging")
        page.wait_for_timeout(30)
    assert seen == {"load", "averaging"}
    return clicks


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
def test_from_the_checklist_to_the_report(cell: Cell, size: str, tmp_path: Path) -> None:
    with browser(drawing=size == "upright") as one:
        page = cell.page(one, **SIZES[size])
        pictures = tmp_path / "pictures"
        page.click("#control")
        wait(page, lambda: page.locator("#checklist li.no, #checklist li.unknown").count() == 0
             and page.locator("#checklist li").count() > 12)  # fmt: skip
        look(page, pictures, "before")
        wait(page, lambda: page.input_value("#plan") == "short/plan.yaml")
        press_begin(page)
        look(page, pictures, "during")
        clicks = measure(page, pictures)
        assert clicks == 3 * CONFIGURATIONS  # half the load, all of it, and its release
        page.wait_for_selector("#after:visible")
        page.click("#stiffness")
        page.wait_for_selector("#reports button", timeout=1e3 * LONG)
        page.click("#reports button")
        report = page.frame_locator("#report")
        report.locator("h1").first.wait_for()
        wait(page, lambda: page.locator("#result tbody tr").count() == 6)
        look(page, pictures, "after")
        with page.expect_download() as download:
            page.click("a[href*='bag.tar']")
        assert Path(download.value.path()).stat().st_size > 10_000
        with page.expect_download() as download:
            page.click("a[href*='report.pdf']")
        assert Path(download.value.path()).read_bytes().startswith(b"%PDF")
        assert page.errors == []
    with Session.look(cell.root / "session") as session:
        assert len(session.completed) == CONFIGURATIONS
        told = [event.text for event in session.events if event.kind == "operator_action"]
    assert sum("load_applied" in text and "by Ann from 127.0.0.1" in text for text in told) == clicks


@pytest.mark.slow
def test_a_point_is_left_out_at_the_page(spinning: Any, source_environment: dict[str, str], tmp_path: Path) -> None:
    """One beam aims at one point after the other; the page says at which, and leaves one out for a reason."""
    short_plan(tmp_path, 1, (0.0, 1.0))
    cell = Cell(source_environment, spinning.plain("hands"), tmp_path, by="device", speed=1.0, tracker="line")
    cell.runner.start()
    try:
        with browser() as one:
            page = cell.page(one)
            page.click("#control")
            begin(page)
            wait(page, lambda: "mp2" in page.inner_text("#aimed"))
            page.click("#point_exclude")
            page.fill("#sure_reason", "its nest is dirty")
            page.click("#sure_yes")
            wait(page, lambda: "left out here: mp" in page.inner_text("#aimed"))
            look(page, tmp_path, "excluded")
            wait(page, lambda: "over" in page.inner_text("#now"))
            page.wait_for_selector("#after:visible")
            look(page, tmp_path, "after")
            assert page.errors == []
    finally:
        cell.runner.shutdown()
    with Session.look(cell.root / "session") as session:
        (excluded,) = {event.text for event in session.events if event.kind == "point_excluded"}
    assert "by Ann" in excluded
    assert "its nest is dirty" in excluded
