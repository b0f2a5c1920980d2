"""Recordings of several kinds: the geometry comes from all postures at rest, the stiffness from the loaded steps."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.diagnosis.positions import standing
from calibration_core.identification.absolute.evaluate import identify_absolute
from calibration_core.identification.identify import fit_freed
from calibration_core.identification.result.estimate import Identification
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.outcomes.together.prepare import Prepared
from calibration_core.timeseries import Bool1D, Float2D

GEOMETRY = "geometry."


@dataclasses.dataclass(frozen=True, eq=False)
class AtRest:
    """What the postures at rest of all recordings show together.

    Attributes:
        rows: (m,) which readings of the merged recordings they are.
        found: Frames and geometry.
    """

    rows: Bool1D
    found: Identification


def of_several_kinds(prepared: Prepared) -> bool:
    """Say whether some recordings, or parts of them, fix the geometry, and others the stiffness."""
    kinds = {alone.kind for alone in prepared.alone}
    return len(kinds) > 1 or (kinds == {"loaded"} and any(alone.phases for alone in prepared.alone))


def identify_mixture(prepared: Prepared) -> tuple[Identification, AtRest]:
    """Identify stiffness from the loaded steps of all recordings, on the geometry that the postures at rest show.

    Raises:
        InputError: They cannot be evaluated together.
    """
    readings, cell, options = prepared.merged.readings, prepared.merged.cell, prepared.options
    start = options.start
    assert start is not None  # noqa: S101 - several recordings begin with the frames of each
    loaded = fit_freed(readings, cell, options, None)
    rows = standing(readings)
    at_rest = identify_absolute(
        readings.select(rows),
        cell,
        robust=options.robust,
        readmit=options.readmit,
        believed=start.replace(compliance=loaded.model.compliance),
    )
    started = dataclasses.replace(options, start=start.replace(geometry=at_rest.model.geometry))
    found = fit_freed(readings, cell, started, prepared.test)
    return _with_geometry(found, at_rest), AtRest(rows, at_rest)


def residual_of(found: Identification, prepared: Prepared, at_rest: AtRest | None) -> tuple[Float2D, Bool1D]:
    """Return what the common model leaves of every reading, (m, 3) m, and which were not used, (m,).

    Args:
        found: The answer of all recordings; of a recording at rest beside loaded ones its differences leave nothing.
        prepared: The recordings.
        at_rest: What the postures at rest show; None where all recordings are of one kind.
    """
    residual, excluded = found.residuals.residual.copy(), found.residuals.excluded.copy()
    if at_rest is None:
        return residual, excluded
    still = np.zeros(len(residual), dtype=bool)
    for rows, alone in zip(prepared.merged.readings.each(), prepared.alone, strict=True):
        still[rows] = alone.kind == "absolute"
    some = still[at_rest.rows]
    residual[still & at_rest.rows] = at_rest.found.residuals.residual[some]
    excluded[still & at_rest.rows] |= at_rest.found.residuals.excluded[some]
    return residual, excluded


def _with_geometry(found: Identification, at_rest: Identification) -> Identification:
    """Return the answer of the loaded steps with the geometry, and what else the postures at rest show."""
    known = at_rest.estimate
    rows = [k for k, name in enumerate(known.names) if name.startswith(GEOMETRY)]
    seen = {(one.configuration, one.step, one.point) for one in found.exclusions}
    exclusions = [one for one in at_rest.exclusions if (one.configuration, one.step, one.point) not in seen]
    kinds = {one.kind for one in found.anomalies}
    return dataclasses.replace(
        found,
        method=f"{found.method}; geometry from all postures at rest ({at_rest.method})",
        parameters=(*found.parameters, *(one for one in at_rest.parameters if one.group == "geometry")),
        unidentified=(*found.unidentified, *at_rest.unidentified),
        exclusions=(*found.exclusions, *exclusions),
        anomalies=(*found.anomalies, *(one for one in at_rest.anomalies if one.kind not in kinds)),
        estimate=GaussianEstimate.independent((found.estimate, known.chosen(rows))),
    )
