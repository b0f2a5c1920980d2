"""The pages that are made from the code say what the code says, and no document leads nowhere."""

from __future__ import annotations

import importlib
import json
import re
import subprocess
from pathlib import Path

import build_site
import collect
import page_cell
import page_commands
import page_effects
import page_library
import page_result
import page_validation
import pytest
import yaml
from documents import DOCUMENTS, ROOT

import calibration_core as cal
from calibration_core.cell import load_cell
from calibration_core.model.effects import catalogue
from calibration_core.report.results.schema import ResultFile

CORE = ROOT / build_site.CORE


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) <= 120


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_what_a_document_refers_to_exists(path: Path) -> None:
    missing = [
        target
        for target in build_site.linked(path.relative_to(ROOT))
        if not target.exists()
        and not (target.parent == CORE and target.name in build_site.MADE)
        and not target.is_relative_to(CORE / "pictures")
    ]
    assert missing == []


def test_the_site_lists_pages_that_are_there() -> None:
    text = (CORE / "site" / "mkdocs.yml").read_text("utf-8")
    found = re.findall(r": (\S+\.md)$", text, re.MULTILINE)
    listed = set(found)
    assert sorted(found) == sorted(listed)
    made = {(build_site.CORE / name).as_posix() for name in build_site.MADE if name.endswith(".md")}
    written = {path.as_posix() for path in build_site.documents()}
    books = {path.with_suffix(".md").as_posix() for path in build_site.notebooks()}
    assert listed ^ (made | written | books) == set()


def test_every_command_and_argument_is_described() -> None:
    page = page_commands.page()
    for name, parser, text in page_commands.commands():
        assert text, name
        assert f"## calibration {name}\n" in page
        assert [one.dest for one in parser._actions if not one.help] == [], name


def test_every_field_of_the_cell_file_is_described() -> None:
    schema = load_cell(ROOT / "config" / "cells" / "small.cell.yaml").model_json_schema()
    rows = page_cell.rows(schema, schema, "")
    names = {name for name, _, _ in rows}
    assert {"robot.joints", "robot.dh[].alpha", "instruments.tracker.sigma", "frames.measurement_points"} <= names
    assert set(page_cell.MEANING) <= names, set(page_cell.MEANING) - names
    assert page_cell.page().count("\n| `") == len(rows)


@pytest.mark.slow
def test_every_effect_stands_with_its_picture(tmp_path: Path) -> None:
    page = page_effects.page(ROOT, tmp_path)
    for effect in catalogue():
        assert f"### {effect.name}\n" in page
        assert effect.equation in page
        assert f"pictures/effects/{effect.name}.svg" in page
        assert (tmp_path / f"{effect.name}.svg").read_bytes().startswith(b"<?xml")
    cell = load_cell(ROOT / "config" / "cells" / "demo.cell.yaml")
    drawn = {effect.name: page_effects.shown(effect, cell) for effect in catalogue()}
    assert [name for name, one in drawn.items() if one is None] == ["clock_offset"], "readings at rest cannot show it"
    moved = {name: abs(page_effects.shift(*one)).max() for name, one in drawn.items() if one is not None}
    assert [name for name, size in moved.items() if not size > 1e-7] == []


def test_every_public_name_stands_in_the_library() -> None:
    page = page_library.page()
    assert [name for name in cal.__all__ if f"## {name}\n" not in page] == []
    for home in re.findall(r"^::: (\S+)$", page, re.MULTILINE):
        module, _, name = home.rpartition(".")
        assert hasattr(importlib.import_module(module), name)


def test_results_are_as_the_schema_says(tmp_path: Path) -> None:
    cell = cal.load_cell(ROOT / "config" / "cells" / "small.cell.yaml")
    recording = cal.load_recording(ROOT / "bags" / "small_loaded", cell)
    identified = cal.identify(recording)
    planned = cal.plan(cell, configurations=12, load_levels=(0.0, 1.0, 0.0))
    results = (identified, cal.diagnose(recording), cal.predict(recording, identified), planned)
    for result in (*results, cal.simulate(cell, plan=planned)):
        content = json.loads(result.save(tmp_path / "out", report=False).read_text("utf-8"))
        found = ResultFile.model_validate(content)
        assert found.command == content["command"]
        with pytest.raises(ValueError, match="verdict"):
            ResultFile.model_validate({**content, "verdict": "fine"})
    page = page_result.page()
    assert all(f"| `{name}` |" in page for name in ResultFile.model_json_schema()["properties"])


def test_documents_name_nothing_that_the_project_does_not_hold() -> None:
    """No commit that is not in the repository, no section of a document that is not there."""
    record = [*(ROOT / path for path in build_site.documents()), CORE / "validation" / "measured.yaml"]
    texts = {path.name: path.read_text("utf-8") for path in record}
    code = {str(path): path.read_text("utf-8") for path in (ROOT / "src").glob("calibration*/calibration*/**/*.py")}
    assert len(code) > 400
    pattern = re.compile(r"contract, sections? \d|of the contract|the contract's")
    assert [name for name, text in {**texts, **code}.items() if pattern.search(text)] == []
    git = ["git", "-C", str(ROOT), "rev-list", "--abbrev-commit", "--abbrev=7", "HEAD"]
    history = set(subprocess.run(git, capture_output=True, text=True, check=False).stdout.split())
    if len(history) < 100:
        pytest.skip("no history here: not a checkout, or a shallow one")
    named = {name: re.findall(r"\bcommit:? [`'\"]?([0-9a-f]{7})\b", text) for name, text in texts.items()}
    assert sum(map(len, named.values())) > 20
    assert {name: missing for name, found in named.items() if (missing := set(found) - history)} == {}


def test_binomial_intervals() -> None:
    """Against the closed forms for none and all, and the table of Clopper and Pearson for 3 of 50."""
    assert page_validation.binomial(0, 134) == pytest.approx((0.0, 1 - 0.025 ** (1 / 134)))
    assert page_validation.binomial(56, 56) == pytest.approx((0.025 ** (1 / 56), 1.0))
    assert page_validation.binomial(3, 50) == pytest.approx((0.0125, 0.1655), abs=1e-4)


def test_runs_are_merged_to_median_and_range() -> None:
    texts = [f"identify: {took} s (bar 5)" for took in ("3.2", "2.9", "4.0")]
    assert page_validation.merged(texts) == "identify: 3.2 (2.9 to 4.0) s (bar 5)"
    assert page_validation.merged([*texts, "skipped"]) == "skipped"
    assert page_validation.merged(texts[:2]) == texts[1]


def test_the_record_of_figures_is_complete() -> None:
    groups = yaml.safe_load((CORE / "validation" / "measured.yaml").read_text("utf-8"))
    figures = [figure for group in groups for figure in group["figures"]]
    assert len(figures) > 20
    for figure in figures:
        assert set(figure) <= {"what", "measured", "command", "date", "commit", "shares"}
        assert re.fullmatch(r"20\d\d-\d\d-\d\d", figure["date"])
        named = re.findall(r"(?:pytest )(\S+\.py)", figure["command"])
        assert [name for name in named if not (ROOT / name).is_file()] == []
    page = page_validation.page(CORE / "validation")
    assert "nothing missing, a finding: 1 of 134 (0.0 to 4.1 %)" in page


def test_the_readme_says_of_concealed_effects_what_the_record_says() -> None:
    groups = yaml.safe_load((CORE / "validation" / "measured.yaml").read_text("utf-8"))
    shares = [share for group in groups for figure in group["figures"] for share in figure.get("shares", [])]
    count, of = next((s["count"], s["of"]) for s in shares if s["what"] == "nothing missing, a finding")
    low, high = (100 * bound for bound in page_validation.binomial(count, of))
    readme = (ROOT / "README.md").read_text("utf-8")
    assert f"| Nothing missing in {of} recordings: effects named all the same | {count} " in readme
    assert f"(95 % interval of the share: {low:.1f} to {high:.1f} %)" in readme
    right = next(100 * s["count"] / s["of"] for s in shares if s["what"] == "effect right, given something found")
    assert f"in recordings with concealed effects of typical size | {right:.1f} % |" in readme


def test_the_page_on_use_says_what_the_record_says() -> None:
    groups = yaml.safe_load((CORE / "validation" / "measured.yaml").read_text("utf-8"))
    figures = {one["what"].split(",")[0]: one["measured"] for group in groups for one in group["figures"]}
    use = (CORE / "use.md").read_text("utf-8")
    shares = re.findall(r"(at least|median|of the means) (\d+) %", figures["twelve concealed effects"])
    assert [how for how, _ in shares] == ["at least", "median", "of the means"]
    assert [share for _, share in shares if f"{share} % less" not in use] == []
    held = re.search(r"holds (\d+ to \d+ %) of the places", figures["twelve concealed effects"])
    assert held is not None
    assert f"holds at {held.group(1)} of the places" in use
    real = figures["real recordings"].partition("MA1400 ")[2]
    one, other, left, also = (f"{float(text):.2f}" for text in re.findall(r"0\.\d+", real)[:4])
    assert f"off by {one} and {other} mm" in use
    assert f"leaves {left} and {also} mm" in use


def test_what_proof_and_benchmarks_wrote_is_collected(tmp_path: Path) -> None:
    table = {"seed": 7, "labels": "abc", "recordings": 2, "wrong": [], "power": [], "measures": [
        {"text": "a finding", "value": 0.25, "bar": "<= 0.3", "met": True, "count": 4}]}  # fmt: skip
    (tmp_path / "prove" / "7").mkdir(parents=True)
    (tmp_path / "prove" / "7" / "table.json").write_text(json.dumps(table))
    run = {
        "date": "2026-01-01",
        "commit": "abc",
        "machine": "x",
        "tests": {"b": {"outcome": "passed", "text": "took 3 s"}},
    }
    (tmp_path / "bench").mkdir()
    (tmp_path / "bench" / "runs.json").write_text(json.dumps([run] * 3))
    record = tmp_path / "record"
    record.mkdir()
    (record / "measured.yaml").write_text("[]")
    assert {path.name for path in collect.collect(tmp_path, record)} == {"prove.json", "bench.json"}
    page = page_validation.page(record)
    assert "| a finding | 0.250 | 0.006 to 0.806 | 4 | <= 0.3 | yes |" in page
    assert "| `b` | 3 of 3 | took 3 s |" in page
