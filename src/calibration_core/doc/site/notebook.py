"""Runs a notebook cell by cell in this process, and writes it as Markdown with what it showed."""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import io
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any


@dataclasses.dataclass(frozen=True)
class Ran:
    """One cell after it ran.

    Attributes:
        kind: `markdown` or `code`.
        source: Its text.
        printed: What it printed.
        html: Its last value as HTML; empty if it has no such form.
        svg: Its last value as a drawing; empty if it has no such form.
        text: Its last value as text; empty if there is none.
    """

    kind: str
    source: str
    printed: str = ""
    html: str = ""
    svg: str = ""
    text: str = ""


def run(path: Path) -> list[Ran]:
    """Run all cells in the folder of the notebook.

    Raises:
        Exception: What a cell raises.
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    cells = json.loads(path.read_text("utf-8"))["cells"]
    before = Path.cwd()
    os.chdir(path.parent)
    try:
        return [_ran(cell["cell_type"], "".join(cell["source"]), names, f"{path.name}, {cell['id']}") for cell in cells]
    finally:
        os.chdir(before)


def _ran(kind: str, source: str, names: dict[str, Any], place: str) -> Ran:
    if kind != "code":
        return Ran(kind, source)
    tree = ast.parse(source, place)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    printed, value = io.StringIO(), None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, place, "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), place, "eval"), names)
    shown = {form: getattr(value, f"_repr_{form}_", lambda: "")() for form in ("html", "svg")}
    text = "" if value is None or any(shown.values()) else repr(value)
    return Ran(kind, source, printed.getvalue(), shown["html"], shown["svg"], text)


def markdown(cells: list[Ran], pictures: Path) -> str:
    """Return the notebook as Markdown.

    Args:
        cells: As `run` returns them.
        pictures: Folder for drawings, beside the page; made if missing.
    """
    pictures.mkdir(parents=True, exist_ok=True)
    return "\n\n".join(part for number, cell in enumerate(cells, 1) for part in _parts(cell, number, pictures)) + "\n"


def _parts(cell: Ran, number: int, pictures: Path) -> Iterator[str]:
    if cell.kind == "markdown":
        yield cell.source
        return
    yield f"```python\n{cell.source}\n```"
    if cell.printed or cell.text:
        yield f"```text\n{(cell.printed + cell.text).rstrip()}\n```"
    if cell.html:
        yield f'<div class="output">{cell.html}</div>'
    if cell.svg:
        drawing = pictures / f"cell_{number}.svg"
        drawing.write_text(cell.svg, "utf-8")
        yield f"![Drawing of cell {number}]({pictures.name}/{drawing.name})"
