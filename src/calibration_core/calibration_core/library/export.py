"""`calibration_core.export`: the calibrated robot in the format of another program."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from calibration_core.cell import Cell
from calibration_core.cli import parse
from calibration_core.commands.application import export as exporting
from calibration_core.formats.calibrated import Exported, ExportedRobot, calibrated_robot
from calibration_core.library.arguments import checked, differing
from calibration_core.library.models import HoldsModel, given_model
from calibration_core.library.result import Columns, Tables, columns_of
from calibration_core.outcomes.inputs import Inputs, naming_model
from calibration_core.report.writing.output import RESULT, Content, write_files
from calibration_core.report.writing.ownership import require_own

OPTIONS = {
    "template": "--template", "joints": "--joints", "points": "--points", "q": "--q", "ends": "--range"
}  # fmt: skip
Format = Literal["urdf", "dh", "ur", "mjcf", "table"]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class ExportResult(Tables):
    """The calibrated robot in one format, read again and compared with the model.

    Attributes:
        cell: The cell that it holds for.
        robot: The calibrated robot.
        exported: Its files, and how far they are from the model.
        options: What was asked for.
        inputs: Role -> name -> SHA-256 of what it rests on.
    """

    cell: Cell
    robot: ExportedRobot
    exported: Exported
    options: argparse.Namespace
    inputs: Inputs

    @property
    def tables(self) -> Mapping[str, Columns]:
        """`deviations`: largest and root mean square deviation from the model, m, at random postures."""
        rows = [vars(one) for one in self.exported.deviations]
        return {"deviations": columns_of(rows, ("what", "postures", "largest", "rms"))}

    @property
    def summary(self) -> str:
        """How far it is from the model, and what the format does not hold, as the command prints it; mm or µm."""
        return exporting.export_summary(self.robot, self.exported)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of `result.json`, SI units."""
        return exporting.export_result(self.robot, self.exported, self.options.format, self.inputs)

    def files(self, directory: str | Path = ".") -> dict[str, Content]:
        """Return all files: file name -> bytes.

        Args:
            directory: Where they shall stand: a URDF refers to its meshes from there.
        """
        options = argparse.Namespace(**{**vars(self.options), "out": Path(directory)})
        exported = exporting.exported_as(self.robot, options)
        return exporting.files_of(self.robot, exported, self.options.format, self.inputs)

    def save(self, directory: str | Path) -> Path:
        """Write all files that the command writes, as one set, and return the path of `result.json`.

        Args:
            directory: Where to; made if missing.

        Raises:
            OutputError: They cannot be written, or would replace what the same command did not write; then nothing is.
        """
        directory = Path(directory)
        require_own(directory, str(self.to_dict()["command"]))
        write_files(directory, self.files(directory))
        return directory / RESULT

    def __repr__(self) -> str:
        return self.summary

    def _repr_html_(self) -> str:
        return self._html_table()


@checked
def export(
    cell: Cell,
    model: str | Path | HoldsModel,
    form: Format,
    *,
    template: str | Path | None = None,
    joints: Sequence[int] = (2, 3),
    points: int = 21,
    q: Sequence[float] | None = None,
    ends: Sequence[float] | None = None,
) -> ExportResult:
    """Write the calibrated robot in the format of another program.

    Args:
        cell: The cell.
        model: A model file, or the result of `identify` or `diagnose`.
        form: `urdf`, `dh` (Denavit-Hartenberg rows), `ur` (Universal Robots' kinematics file), `mjcf` (MuJoCo), or
            `table` (corrections of joint angles over a grid).
        template: `ur`: the kinematics file extracted from this robot's controller.
        joints: `table`: numbers, from 1, of the joints that it runs over.
        points: `table`: nodes per joint.
        q: `table`: where the other joints stand, rad (m where one slides); None: the middle of the limits.
        ends: `table`: lower and upper end for each of `joints`, rad; None: their limits.

    Returns:
        The files, with their deviations from the model in m, and the effects that the format does not hold.

    Raises:
        InputError: Model, template or grid cannot be used, or the format cannot hold the robot.
        EquilibriumError: The robot cannot carry its own weight.

    Source: the formats' own conventions, as the documentation of `calibration export` names them.
    """
    given = given_model(model, cell)
    options = parse(["export", f"--cell={cell.path}", f"--model={given.file}", f"--format={form}"])
    asked = {"template": template, "joints": joints, "points": points, "q": q, "ends": ends}
    exporting.refuse_idle(differing(asked, export, OPTIONS), form)
    vars(options).update(
        template=None if template is None else Path(template),
        joints=list(joints),
        points=points,
        q=None if q is None else " ".join(repr(float(x)) for x in q),
        range=None if ends is None else " ".join(repr(float(x)) for x in ends),
    )
    with naming_model(Path(given.file)):
        robot = calibrated_robot(cell, given.parameters, given.notes)
        exported = exporting.exported_as(robot, options)
    return ExportResult(cell, robot, exported, options, given.digest)
