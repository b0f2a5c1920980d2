"""The look at the input that every fitting command takes before any physics."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.checks.space import operating_space
from calibration_core.input_checks.anomaly import InputAnomaly
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.report.results.refused import refused_result, refused_summary
from calibration_core.report.results.result import result_json
from calibration_core.report.writing.output import RESULT, Content
from calibration_core.timeseries import Readings


@dataclasses.dataclass(frozen=True, eq=False)
class Refusal:
    """The answer where the input is not what it claims to be: nothing is identified.

    Attributes:
        inputs: Role -> file -> SHA-256 of input files besides recording and cell.
    """

    command: str
    cell: Cell
    readings: Readings
    found: tuple[InputAnomaly, ...]
    inputs: Mapping[str, Mapping[str, str]]

    @staticmethod
    def of(
        command: str, cell: Cell, readings: Readings, found: Sequence[InputAnomaly], given: GivenModel | None
    ) -> Refusal:
        """Return the refusal of a recording with at least one anomaly that blocks."""
        inputs = {} if given is None else given.digest
        return Refusal(command, cell, readings, tuple(one for one in found if one.blocks), inputs)

    @property
    def content(self) -> dict[str, Any]:
        """The content of result.json."""
        return refused_result(self.command, self.cell, self.readings, self.found, self.inputs)

    @property
    def summary(self) -> str:
        """What is wrong and what to put right."""
        return "\n".join(refused_summary(self.found))

    @property
    def error(self) -> IdentificationError:
        """The same as an error, for whoever needs what such input cannot give."""
        first = self.found[0]
        return IdentificationError(self.readings.provenance.path, first.kind, first.text, first.remedy)

    def files(self, *, report: bool) -> dict[str, Content]:
        """Return result and, if asked for, report: file name -> content."""
        result = result_json(self.content)
        if not report:
            return {RESULT: result}
        from calibration_core.report.documents.refused import refused_document
        from calibration_core.report.view3d.space import space_view
        from calibration_core.report.writing.rendering import rendered

        space = operating_space(chain_of(self.cell), nominal_parameters(self.cell), self.readings, None)
        document = refused_document(self.cell, self.readings, self.found, result, self.inputs)
        return {RESULT: result, **rendered(document, space_view(space, self.cell))}
