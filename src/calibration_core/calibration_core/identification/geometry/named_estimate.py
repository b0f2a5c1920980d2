"""What an identification found, with its joint covariance, under the names of the model file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.geometry.frames import FrameFit
from calibration_core.identification.geometry.identifiability import candidates
from calibration_core.identification.geometry.parameter_table import frames_uncertainty
from calibration_core.identification.geometry.terms import AXES, CORRECTIONS
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.named_values import POSE, unit_of, value_of
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float2D

COMPLIANCE = "C "  # what the fits call the compliance of a joint, before its name


def named_estimate(names: Sequence[str], covariance: Float2D, model: ModelParameters, cell: Cell) -> GaussianEstimate:
    """Return fitted parameters under the names of the model file; what has no place there is left out.

    That are the joints that are declared rigid, and tracker poses of several recordings.

    Args:
        names: (p,) as the fits call them: `C joint_1`, `tracker roll`, `mp1 x`, `a_2`, ...
        covariance: (p, p) SI units; an infinite variance where the recording says nothing.
        model: The identified model.
        cell: The cell file.

    Raises:
        KeyError: A name is none of the model's.
    """
    kept = in_model_file(names, cell)
    paths = model_paths(cell)
    chosen = tuple(paths[names[k]] for k in kept)
    slides = dict(zip(cell.robot.joints, cell.prismatic, strict=True))
    matrix = np.array(covariance)[np.ix_(kept, kept)]
    return GaussianEstimate(
        chosen,
        tuple(unit_of(name, slides) for name in chosen),
        np.array([value_of(model, name) for name in chosen]),
        without_unknown(matrix),
    )


def in_model_file(names: Sequence[str], cell: Cell) -> list[int]:
    """Return the positions of the parameters that stand in a model file (see `named_estimate`)."""
    rigid = {
        f"{COMPLIANCE}{j}" for j, k in zip(cell.robot.joints, cell.robot.stiffness or (), strict=False) if np.isinf(k)
    }
    return [k for k, name in enumerate(names) if name not in rigid and not name.startswith("tracker@")]


def without_unknown(covariance: Float2D) -> Float2D:
    """Return a covariance in which what is not known (infinite variance) varies with nothing else."""
    unknown = ~np.isfinite(np.diag(covariance))
    matrix = np.where(unknown[:, None] | unknown[None, :], 0.0, covariance)
    matrix[unknown, unknown] = np.inf
    return np.asarray((matrix + matrix.T) / 2, dtype=np.float64)


def loaded_estimate(
    compliance: Float2D, frames: FrameFit | None, points: Sequence[str], model: ModelParameters, cell: Cell
) -> GaussianEstimate:
    """Return the compliances of a loaded recording, and beside them tracker pose and points.

    Args:
        compliance: (n, n) covariance of the compliances.
        frames: Fit of tracker pose and points; None for a recording of differences, which says nothing of them.
        points: Names of the points that were read.
        model: The identified model.
        cell: The cell file.
    """
    joints = named_estimate([f"{COMPLIANCE}{joint}" for joint in cell.robot.joints], compliance, model, cell)
    if frames is None:
        return joints
    fitted = frames_uncertainty(frames, points)
    around = named_estimate(fitted.names, fitted.covariance, model, cell)
    return GaussianEstimate.independent((joints, around))


def with_known_effects(estimate: GaussianEstimate, known: GaussianEstimate | None, count: int) -> GaussianEstimate:
    """Return the estimate of a model that begins with effects known before.

    Args:
        estimate: Of the model without them.
        known: Of the given model; only what it says of its effects is taken over.  None: it has no intervals.
        count: How many effects come before those of the estimate.
    """
    moved = estimate.renamed([_later(name, count) for name in estimate.names])
    if known is None:
        return moved
    of_effects = [k for k, name in enumerate(known.names) if name.startswith("effects.")]
    return GaussianEstimate.independent((moved, known.chosen(of_effects)))


def _later(name: str, count: int) -> str:
    group, _, rest = name.partition(".")
    if group != "effects":
        return name
    number, _, parameter = rest.partition(".")
    return f"effects.{int(number) + count}.{parameter}"


def model_paths(cell: Cell) -> dict[str, str]:
    """Return what the fits call a parameter -> its path in the model file."""
    joints = cell.robot.joints
    paths = {c.name: f"geometry.{joints[c.joint]}.{CORRECTIONS[c.kind]}" for c in candidates(cell)}
    paths |= {f"{COMPLIANCE}{joint}": f"compliance.{joint}" for joint in joints}
    paths |= {f"{point} {axis}": f"measurement_points.{point}.{axis}" for point in cell.points for axis in AXES}
    return paths | {f"tracker {part}": f"tracker.{part}" for part in POSE}
