"""Builds the documentation: gathers the packages' documents, makes the pages from the code, runs the notebooks.

    .venv/bin/python src/calibration_core/doc/site/build_site.py OUT

Every page keeps its place in the project, so that a link works in both.  `make docs` then has MkDocs make the site.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path

import notebook
import page_cell
import page_commands
import page_effects
import page_library
import page_result
import page_validation
import pictures

from calibration_core.report.results.schema import ResultFile

ROOT = Path(__file__).resolve().parents[4]
CORE = Path("src/calibration_core/doc")
LINK = re.compile(r"(\]\()([^)#:\s]+)((?:#[^)]*)?\))")
MADE = (
    "commands.md",
    "cell_file.md",
    "effects.md",
    "library.md",
    "result_json.md",
    "result.schema.json",
    "validation.md",
)
"""Pages in the core's `doc` folder that are made here."""


def documents() -> list[Path]:
    """Return the documents of the project, relative to its root."""
    found = [Path("README.md"), Path("bags/README.md"), *(path.relative_to(ROOT) for path in ROOT.glob(".github/*.md"))]
    return sorted({*found, *(path.relative_to(ROOT) for path in ROOT.glob("src/*/doc/*.md"))})


def notebooks() -> list[Path]:
    """Return the notebooks, relative to the project's root."""
    return sorted(path.relative_to(ROOT) for path in ROOT.glob("src/*/doc/notebooks/*.ipynb"))


def build(out: Path) -> None:
    """Make all pages below a folder, which is emptied first."""
    shutil.rmtree(out, ignore_errors=True)
    for path in documents():
        _put(out / path, _as_page((ROOT / path).read_text("utf-8")))
        for target in linked(path):
            if target.is_file() and target.suffix not in {".md", ".ipynb"}:
                copy = out / target.relative_to(ROOT)
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(target, copy)
    for path in notebooks():
        page = (out / path).with_suffix(".md")
        _put(page, _as_page(notebook.markdown(notebook.run(ROOT / path), page.with_suffix(""))))
    shutil.copyfile(Path(__file__).with_name("site.css"), out / "site.css")
    core = out / CORE
    pictures.draw(core / "pictures")
    _put(core / "commands.md", page_commands.page())
    _put(core / "cell_file.md", page_cell.page())
    _put(core / "effects.md", page_effects.page(ROOT, core / "pictures" / "effects"))
    _put(core / "library.md", page_library.page())
    _put(core / "result_json.md", page_result.page())
    _put(core / "result.schema.json", json.dumps(ResultFile.model_json_schema(), indent=2) + "\n")
    _put(core / "validation.md", page_validation.page(ROOT / CORE / "validation"))
    for name in ("config/priors.yaml", "config/cells/demo.cell.yaml"):
        _put(out / name, (ROOT / name).read_text("utf-8"))


def linked(path: Path) -> list[Path]:
    """Return the files that a document links to."""
    text = (ROOT / path).read_text("utf-8")
    return [(ROOT / path.parent / target).resolve() for _, target, _ in LINK.findall(text)]


def _as_page(text: str) -> str:
    """Return a document with its links to notebooks pointing at their pages."""
    return LINK.sub(lambda m: m[1] + re.sub(r"\.ipynb$", ".md", m[2]) + m[3], text)


def _put(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, "utf-8")


if __name__ == "__main__":
    build(Path(sys.argv[1]).resolve())
