"""HTML and PDF say the same, need nothing else, stay within their size, and hostile names remain text."""

from __future__ import annotations

import base64
import datetime as dt
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import pytest
import typst
from browser import dumped

from calibration_core.cell import Cell
from calibration_core.identification.result.estimate import Identification
from calibration_core.report import content
from calibration_core.report.document import Document, Facts, Items, Paragraph, Table
from calibration_core.report.figures.style import parts
from calibration_core.report.view3d.space import space_view
from calibration_core.report.writing import identification_files as writing
from calibration_core.report.writing import rendering
from calibration_core.report.writing.html import render_html
from calibration_core.report.writing.pdf import _data, render_pdf

DAY = dt.date(2026, 3, 5)
Case = tuple[Identification, Cell]


class Page(HTMLParser):
    def __init__(self, content: bytes) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.handlers: list[str] = []
        self.scripts: list[str] = []
        self.text = ""
        self.feed(content.decode())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in {"src", "href", "action", "data"}]
        self.handlers += [name for name, _ in attrs if name.startswith("on")]
        if tag == "script":
            self.scripts.append("")

    def handle_data(self, data: str) -> None:
        if self.lasttag == "script":
            self.scripts[-1] += data
        elif self.lasttag != "style":
            self.text += data


@pytest.fixture(scope="module")
def pages(
    loaded: Identification, cell: Cell, hostile: Case, documents: dict[str, Document]
) -> dict[str, tuple[Page, list[str]]]:
    out = {}
    for name, (answer, of) in {"loaded": (loaded, cell), "hostile": hostile}.items():
        document = documents[name]
        words: list[str] = []
        for block in (document.facts, Facts(document.verdict.lines), *document.blocks()):
            if isinstance(block, Table):
                words += [
                    block.caption,
                    *(column.head for column in block.columns),
                    *(c for row in block.rows for c in row),
                ]
            elif isinstance(block, Facts):
                words += [entry for row in block.rows for entry in row]
            elif isinstance(block, Paragraph):
                words.append(block.text)
            elif isinstance(block, Items):
                words += block.texts
            else:
                words.append(block.caption)
        out[name] = Page(render_html(document, space_view(answer.space, of))), words
    return out


@pytest.mark.parametrize("name", ["loaded", "hostile"])
def test_html_shows_every_word_of_the_document(name: str, pages: dict[str, tuple[Page, list[str]]]) -> None:
    page, words = pages[name]
    missing = [word for word in words if word not in page.text]
    assert missing == []


@pytest.mark.parametrize("name", ["loaded", "hostile"])
def test_html_needs_nothing_else_and_runs_only_its_own_programs(
    name: str, pages: dict[str, tuple[Page, list[str]]]
) -> None:
    page, _ = pages[name]
    assert page.tags.count("script") == 3
    assert len(json.loads(page.scripts[0])["postures"]) >= 7
    assert all(link.startswith(("data:image/svg+xml;base64,", "#")) for link in page.links)
    assert page.handlers == []
    assert not {"link", "iframe", "object", "embed", "base", "form"} & set(page.tags)
    assert not [script for script in page.scripts if script.lstrip().startswith("alert")]


def test_figures_in_html_are_the_documents(
    documents: dict[str, Document], pages: dict[str, tuple[Page, list[str]]]
) -> None:
    shown = [base64.b64decode(link.partition(",")[2]) for link in pages["loaded"][0].links if link[0] != "#"]
    assert shown == [svg for figure in documents["loaded"].figures() for svg, _ in parts(figure.svg)]


@pytest.mark.parametrize("name", ["loaded", "absolute", "hostile"])
def test_pdf_pages_keep_their_form(name: str, documents: dict[str, Document]) -> None:
    template = Path(writing.__file__).parents[1] / "templates" / "report.typ"
    inputs = {"document": json.dumps(_data(documents[name]))}
    sheets, complaints = typst.compile_with_warnings(
        template.read_bytes(), sys_inputs=inputs, ignore_system_fonts=True, format="svg"
    )
    assert [str(complaint) for complaint in complaints] == []
    assert 5 <= len(sheets) <= 12
    for sheet in sheets:
        width, height = re.search(rb'viewBox="0 0 ([\d.]+) ([\d.]+)"', sheet).groups()
        assert (float(width), float(height)) == pytest.approx((595.28, 841.89), abs=0.01)


def test_pdf_holds_hostile_names_as_text(documents: dict[str, Document], tmp_path: Path) -> None:
    if shutil.which("pdftotext") is None:
        pytest.skip("pdftotext (poppler-utils) is not installed")
    (tmp_path / "report.pdf").write_bytes(render_pdf(documents["hostile"]))
    subprocess.run(["pdftotext", "-raw", "report.pdf", "report.txt"], cwd=tmp_path, check=True, timeout=60)
    words = "".join((tmp_path / "report.txt").read_text().replace("\u200b", "").split())
    assert "</script><script>alert(1)</script>#setpage(width:1cm)$x^2$\\u{41}*b*_i_`r`\"q\"'a'<b>&amp;{{7*7}}" in words


def test_the_same_answer_gives_the_same_bytes(
    loaded: Identification, cell: Cell, documents: dict[str, Document]
) -> None:
    again = content.build(loaded, cell, DAY)
    assert again == documents["loaded"]
    view = space_view(loaded.space, cell)
    assert rendering.rendered(again, view) == rendering.rendered(documents["loaded"], view)


def test_large_recordings_give_reports_of_moderate_size(large: Case, large_document: Document) -> None:
    files = rendering.rendered(large_document, space_view(large[0].space, large[1]))
    assert len(files["report.html"]) < 1_500_000
    assert len(files["report.pdf"]) < 5_000_000
    assert "First 40 of 11,911; all of them stand in table1.csv." in Page(files["report.html"]).text


def test_the_robot_is_drawn_by_a_browser(
    loaded: Identification, cell: Cell, documents: dict[str, Document], tmp_path: Path
) -> None:
    page = render_html(documents["loaded"], space_view(loaded.space, cell))
    assert len(page) <= 1_500_000
    (tmp_path / "report.html").write_bytes(page)
    body = dumped(tmp_path / "report.html", tmp_path)
    if 'class="turnable"' not in body:
        pytest.skip("this Chromium has no WebGL")
    assert re.search(r'<div id="scene"><div[^>]*><div[^>]*><canvas[^>]* role="img"', body)
    assert "configuration 1" in body
    assert 'type="range"' in body
