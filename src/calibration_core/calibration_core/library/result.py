"""What every answer of the library can do: speak, be a table, be drawn, be saved."""

from __future__ import annotations

import abc
import dataclasses
import functools
import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from calibration_core.cell import Cell
from calibration_core.errors import CalibrationError, InputError, quoted
from calibration_core.report.writing.output import RESULT, Content, write_files
from calibration_core.report.writing.ownership import require_own

if TYPE_CHECKING:
    import pandas as pd

Columns = Mapping[str, Sequence[Any]]
SHOWN = 20  # rows of a table in a notebook


@dataclasses.dataclass(frozen=True)
class Picture:
    """A drawing, as a notebook shows it.

    Attributes:
        svg: The drawing as SVG, UTF-8.
        title: What it shows, in words.
    """

    svg: bytes
    title: str

    def _repr_svg_(self) -> str:
        return self.svg.decode("utf-8")

    def save(self, path: str | Path) -> Path:
        """Write the drawing to an SVG file and return its path.

        Args:
            path: The file; its folder is made if missing.

        Raises:
            OutputError: It cannot be written.
        """
        path = Path(path)
        write_files(path.parent, {path.name: self.svg})
        return path


class Tables(abc.ABC):
    """Something that can be seen as tables, the first of them being the most important one."""

    @property
    @abc.abstractmethod
    def tables(self) -> Mapping[str, Columns]:
        """Name of the table -> name of the column -> values, all columns of a table of one length, SI units."""

    def to_dataframe(self, table: str = "") -> pd.DataFrame:
        """Return one of the `tables` as a pandas data frame, SI units (m, rad, N, N*m, s) and degrees Celsius.

        Args:
            table: Its name; the first one if empty.

        Raises:
            InputError: There is no such table.
            CalibrationError: pandas is not installed.
        """
        columns = self._table(table)
        try:
            import pandas as pd
        except ImportError:
            raise CalibrationError("pandas is not installed; install it with: pip install pandas") from None
        return pd.DataFrame(dict(columns))

    def _table(self, name: str) -> Columns:
        tables = self.tables
        if name and name not in tables:
            raise InputError("to_dataframe", "table", quoted(name), f"one of {', '.join(tables)}")
        return tables[name or next(iter(tables))]

    def _html_table(self, name: str = "") -> str:
        columns = self._table(name)
        rows = list(zip(*columns.values(), strict=True))
        head = "".join(f"<th>{html.escape(column)}</th>" for column in columns)
        body = "".join(f"<tr>{''.join(f'<td>{_cell(value)}</td>' for value in row)}</tr>" for row in rows[:SHOWN])
        more = f"<p>{len(rows) - SHOWN} more rows</p>" if len(rows) > SHOWN else ""
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"


class Answer(Protocol):
    """What a command returns."""

    @property
    def content(self) -> dict[str, Any]:
        """Content of result.json."""

    @property
    def summary(self) -> str:
        """What the command prints."""

    def files(self, *, report: bool) -> dict[str, Content]:
        """File name -> bytes, or a function that writes it."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Result(Tables):
    """The answer of one command.

    Attributes:
        cell: The cell that it holds for.
    """

    cell: Cell

    @abc.abstractmethod
    def files(self, *, report: bool = True) -> dict[str, Content]:
        """Return all files that the command writes: file name -> its bytes, or a function that writes it.

        Args:
            report: Whether `report.html` and `report.pdf` are among them.
        """

    @abc.abstractmethod
    def plot(self) -> Picture:
        """Draw what matters most, in the units that the axes name."""

    @abc.abstractmethod
    def _content(self) -> dict[str, Any]:
        """Return the content of result.json."""

    @property
    @abc.abstractmethod
    def summary(self) -> str:
        """What came out, in a few lines, as the command prints it."""

    @functools.cached_property
    def _contents(self) -> dict[str, Any]:
        return self._content()

    def to_dict(self) -> dict[str, Any]:
        """Return the content of `result.json`, SI units."""
        return dict(self._contents)

    def save(self, directory: str | Path, *, report: bool = True) -> Path:
        """Write all files that the command writes, as one set, and return the path of `result.json`.

        Args:
            directory: Where to; made if missing.
            report: Whether `report.html` and `report.pdf` are made, which takes a second.

        Raises:
            OutputError: They cannot be written, or would replace what the same command did not write; then nothing is.
        """
        directory = Path(directory)
        require_own(directory, str(self.to_dict()["command"]))
        write_files(directory, self.files(report=report))
        return directory / RESULT

    def __repr__(self) -> str:
        return self.summary

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(self.summary)}</pre>{self._html_table()}"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class ResultWithLight(Result):
    """The answer of a command that says whether it can be used."""

    @property
    def usable(self) -> str:
        """`yes`, `with_reservations` or `no`: the traffic light of the report."""
        return str(self._contents["usable"])

    @property
    def reason(self) -> str:
        """Why it is `usable` or not, in one sentence."""
        return str(self._contents["reason"])

    @property
    def next_step(self) -> str:
        """What to do next; empty if there is nothing to do."""
        return str(self._contents["next_step"])

    def _repr_html_(self) -> str:
        light = {"yes": "usable", "no": "not usable"}.get(self.usable, "usable with reservations")
        headline = f"<p><b>{light}</b>: {html.escape(self.reason)}</p>"
        step = f"<p>Next: {html.escape(self.next_step)}</p>" if self.next_step else ""
        return f"{headline}{step}{super()._repr_html_()}"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Judged(ResultWithLight):
    """The answer of a command that evaluates a recording: it says whether it can be used, and what the model leaves.

    Attributes:
        answer: What the command returns, in SI units.
    """

    answer: Answer

    @property
    def summary(self) -> str:
        """Light, verdict and figures in a few lines, as the command prints them; stiffness in 10^5 N*m/rad, µm."""
        return self.answer.summary

    def files(self, *, report: bool = True) -> dict[str, Content]:
        """Return result, tables, model and report: file name -> bytes; arguments as for `save`."""
        return self.answer.files(report=report)

    def _content(self) -> dict[str, Any]:
        return self.answer.content

    @property
    def verdict(self) -> str:
        """`consistent`, `missing_physics`, `partly_explained` or `unexplained`."""
        return str(self._contents["verdict"])


def columns_of(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> Columns:
    """Return the columns of rows that are mappings; None where a row has no such value."""
    return {name: [row.get(name) for row in rows] for name in names}


def _cell(value: Any) -> str:
    return html.escape(f"{value:.6g}" if isinstance(value, float) else str(value))
