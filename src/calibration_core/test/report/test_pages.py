"""The report in a real browser: what comes first, that nothing is cut off at 390 pixels, and who can read it."""

from __future__ import annotations

import dataclasses
import html
import json
import re
from pathlib import Path
from typing import Any

import pytest
from answers import DAY
from browser import dumped

from calibration_core.cell import Cell
from calibration_core.identification.result.estimate import Identification
from calibration_core.report.content import build
from calibration_core.report.document import Document
from calibration_core.report.view3d.space import space_view
from calibration_core.report.writing.html import render_html

MOST_SHRUNK = 0.7
MEASURE = """<script>
function luminance(colour) {
  const linear = v => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const [r, g, b] = colour.match(/[\\d.]+/g).slice(0, 3).map(v => linear(v / 255));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}
function ground(element) {
  for (let one = element; one; one = one.parentElement) {
    const colour = getComputedStyle(one).backgroundColor;
    if (!/, 0\\)$/.test(colour) && colour !== "transparent") { return colour; }
  }
  return "rgb(255, 255, 255)";
}
window.onload = () => {
  const frame = document.querySelector("iframe"), page = frame.contentDocument, faint = [], wide = [];
  for (const element of page.querySelectorAll("body *")) {
    const own = [...element.childNodes].some(node => node.nodeType === 3 && node.textContent.trim());
    if (!own || ["SCRIPT", "STYLE"].includes(element.tagName)) { continue; }
    const both = [luminance(getComputedStyle(element).color), luminance(ground(element))];
    const [light, dark] = both.sort((a, b) => b - a);
    if ((light + 0.05) / (dark + 0.05) < 4.5) { faint.push(element.outerHTML.slice(0, 80)); }
    const box = element.getBoundingClientRect();
    const scrolls = element.closest(".scroll") || element.closest(".skip") || element.closest("thead");
    if (box.right > frame.clientWidth + 1 && !scrolls) { wide.push(element.outerHTML.slice(0, 80)); }
  }
  const top = one => page.querySelector(one).getBoundingClientRect().top;
  const levels = [...page.querySelectorAll("h1, h2, h3")].map(one => Number(one.tagName[1]));
  document.title = JSON.stringify({
    width: page.documentElement.scrollWidth, faint, wide,
    cut: [...page.querySelectorAll(".scroll")].filter(one => one.querySelector("table"))
      .map(one => one.scrollWidth - one.clientWidth),
    images: [...page.querySelectorAll(".panels img")].filter(one => one.clientWidth).map(one =>
      [one.clientWidth / one.naturalWidth, one.getBoundingClientRect().right - frame.clientWidth]),
    verdict: top("#result"), table: top("table"), about: top("#about"),
    alts: [...page.images].every(one => one.alt), heads: [...page.querySelectorAll("th")].every(one => one.scope),
    lang: page.documentElement.lang, levels,
    links: [...page.querySelectorAll("nav a")].map(one => !!page.querySelector(one.getAttribute("href"))),
  });
};
</script>"""


def measured(page: bytes, width: int, height: int, folder: Path) -> dict[str, Any]:
    """Return what a browser says of a report in a window of this size, without its own programs."""
    still = re.sub(r"<script\b.*?</script>", "", page.decode(), flags=re.DOTALL)
    frame = f'<iframe style="border:0;width:{width}px;height:{height}px" srcdoc="{html.escape(still)}"></iframe>'
    path = folder / f"frame-{width}.html"
    path.write_text(
        f"<!DOCTYPE html><html><head><title></title></head><body>{frame}{MEASURE}</body></html>", encoding="utf-8"
    )
    body = dumped(path, folder)
    title = re.search(r"<title>(.*?)</title>", body, re.DOTALL)
    assert title is not None
    found: dict[str, Any] = json.loads(html.unescape(title.group(1)))
    return found


@pytest.mark.parametrize(("width", "height"), [(1280, 900), (390, 844)])
def test_a_report_can_be_read_by_everybody(
    width: int, height: int, loaded: Identification, cell: Cell, documents: dict[str, Document], tmp_path: Path
) -> None:
    page = render_html(documents["loaded"], space_view(loaded.space, cell))
    seen = measured(page, width, height, tmp_path)
    assert seen["width"] <= width
    assert seen["wide"] == []
    assert seen["faint"] == []  # contrast of at least 4.5 (WCAG 2.2, 1.4.3)
    assert seen["alts"]
    shrunk = [scale for scale, beyond in seen["images"] if beyond <= 0]
    assert len(shrunk) >= len(seen["images"]) - 1  # operating space alone is wider than a telephone, and scrolls
    assert min(scale for scale, _ in seen["images"]) >= MOST_SHRUNK  # type of 8 points stays legible
    if width < 400:
        assert max(shrunk) <= 1.01  # a narrow diagram is not blown up beside a wide one that shrinks
    assert seen["heads"]
    assert seen["lang"] == "en"
    assert seen["links"]
    assert all(seen["links"])
    assert max(b - a for a, b in zip(seen["levels"], seen["levels"][1:], strict=False)) <= 1
    assert 0 <= seen["verdict"] < height / 3  # the light and the next step come first, who and when after Table 2
    assert seen["verdict"] < seen["table"] < seen["about"]
    if width > 1000:
        assert seen["table"] < height


def test_table_2_shows_the_extended_model_without_scrolling(loaded: Identification, cell: Cell, tmp_path: Path) -> None:
    beside = tuple(dataclasses.replace(joint, extended=joint) for joint in loaded.stiffness)
    page = render_html(build(dataclasses.replace(loaded, stiffness=beside), cell, DAY), None)
    assert "Extended model" in page.decode()
    assert measured(page, 1280, 900, tmp_path)["cut"][0] <= 0


def test_the_light_is_told_by_shape_and_word_too(documents: dict[str, Document]) -> None:
    light = documents["loaded"].verdict.light
    assert light in {"yes", "with_reservations", "no"}
    page = render_html(documents["loaded"], None).decode()
    assert f'class="verdict {light}"' in page
    assert {"yes": "●", "with_reservations": "▲", "no": "■"}[light] in page


def test_short_tables_are_printed_on_one_page_and_clauses_are_counted(documents: dict[str, Document]) -> None:
    page = render_html(documents["absolute"], None).decode()
    rows = [part.count("<tr>") - 1 for part in page.split("<table>")[1:]]
    short = ['"scroll short"' in part[-200:] for part in page.split("<table>")[:-1]]
    assert short == [count <= 24 for count in rows]
    assert "CWA 17384, clauses 7.1 to 7.5" in page
    assert "CWA 17384, clause 8 d)" in page
