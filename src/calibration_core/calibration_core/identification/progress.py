"""While measuring: what the readings so far tell, whether the last configuration fits, and what to measure next.

It is the evaluation of a loaded recording on what there is of it, with the information that the rest of the plan will
add: J_MP diag(J_WP^T W) of every planned configuration (CWA 17384, equation (7)), weighted as the readings are.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.result.observability import TWO_SIDED
from calibration_core.identification.statistics import chi2_limit, normal_equations
from calibration_core.identification.stiffness.fit import LoadedFit
from calibration_core.identification.stiffness.loaded import Options, identify_prepared, prepare_loaded
from calibration_core.identification.stiffness.problem import LoadedProblem, build_problem
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.simulation.simulate import Loading, simulate_plan
from calibration_core.observations.kinds import is_loaded
from calibration_core.timeseries import Float1D, Float2D, Float3D, Readings

FALSE_ALARM = 1e-3  # probability that a sound configuration is called suspicious
DETERMINED = 1e-10  # reciprocal condition of the column-scaled normal matrix, below which nothing is told


@dataclasses.dataclass(frozen=True, eq=False)
class Progress:
    """What a session has told so far.

    Attributes:
        configuration: The one measured last.
        stiffness: (n,) N*m/rad; NaN where nothing is determined yet, infinite where the joint may be rigid.
        interval: (n, 2) N*m/rad, 95 %.
        accuracy: (n,) half of the 95 % interval of the compliance over its value, now; infinite where undetermined.
        expected: (n,) the same, expected at the plan's end.
        misfit: m, rms of the last configuration's readings as predicted from the others; NaN where these do not tell.
        misfit_limit: m, above it the configuration is suspicious.
        suspicious: Whether it does not fit the others, or holds a gross error.
        wanted: Accuracy that is wanted of every joint; 0: none.
        enough: Whether every joint has it.
        next_configuration: The planned one that would tell most about the worst joint; None if none is left.
        text: All of it in one line for a person.
    """

    configuration: int
    joints: tuple[str, ...]
    stiffness: Float1D
    interval: Float2D
    accuracy: Float1D
    expected: Float1D
    misfit: float
    misfit_limit: float
    suspicious: bool
    wanted: float
    enough: bool
    next_configuration: int | None
    text: str


def progress(
    readings: Readings,
    cell: Cell,
    pending: Sequence[Loading] = (),
    spares: Sequence[Loading] = (),
    *,
    wanted: float = 0.0,
) -> Progress:
    """Evaluate the readings of a session so far.

    Args:
        readings: Of whole configurations, in the order of time; unloaded ones may be among them.
        cell: The cell file.
        pending: Configurations of the plan that will still be measured.
        spares: Those that may be measured besides.
        wanted: Half of the 95 % interval of each compliance over its value that is enough; 0: none is wanted.

    Raises:
        IdentificationError: Fewer than two loaded configurations are measured: nothing can be determined yet.
        CellError: A frame is needed and missing.
        EquilibriumError: The load is beyond what the joints can carry.
    """
    last = int(readings.configuration[-1])
    if not is_loaded(readings):
        what = "loaded configurations (the phases before them say nothing about stiffness)"
        raise IdentificationError(readings.provenance.path, "step", "no load yet", what)
    options = Options()
    prepared = prepare_loaded(readings, cell, options)
    found = identify_prepared(prepared, cell, options)
    fit, scale = prepared.fit, found.noise.scale
    total = fit.normal.matrix.sum(axis=0)
    compliance = fit.compliance
    planned = _information(pending, readings, cell, prepared.problem, prepared.parameters)
    spare = _information(spares, readings, cell, prepared.problem, prepared.parameters)
    accuracy = _accuracy(total, compliance, scale)
    expected = _accuracy(total + planned.sum(axis=0), compliance, scale)
    next_one = _next([*pending, *spares], np.concatenate([planned, spare]), total, compliance)
    misfit, limit = _misfit(fit, prepared.problem, last, found.residuals.held_out)
    gross = any(exclusion.configuration == last for exclusion in found.exclusions)
    suspicious = gross or bool(misfit > limit)
    determined = np.isfinite(accuracy)
    enough = wanted > 0.0 and bool(np.all(accuracy <= wanted))
    done = Progress(
        configuration=last,
        joints=prepared.problem.chain.joints,
        stiffness=np.where(determined, [joint.value for joint in found.stiffness], np.nan),
        interval=np.array([joint.interval for joint in found.stiffness]),
        accuracy=accuracy,
        expected=expected,
        misfit=misfit,
        misfit_limit=limit,
        suspicious=suspicious,
        wanted=wanted,
        enough=enough,
        next_configuration=next_one,
        text="",
    )
    return dataclasses.replace(done, text=in_words(done))


def in_words(found: Progress) -> str:
    """Say it in one line."""
    parts = []
    if found.suspicious:
        parts.append(f"configuration {found.configuration} does not fit the others: measure it again")
    worst = int(np.argmax(found.accuracy))
    if np.isfinite(found.accuracy[worst]):
        end = f", {100 * found.expected[worst]:.2g} % expected at the end" if np.isfinite(found.expected[worst]) else ""
        parts.append(f"worst {found.joints[worst]} ± {100 * found.accuracy[worst]:.2g} %{end}")
    else:
        parts.append(f"{found.joints[worst]} is not determined yet")
    if found.enough:
        parts.append(f"enough: every joint within ± {100 * found.wanted:.2g} %")
    elif found.next_configuration is not None:
        parts.append(f"configuration {found.next_configuration} would add most now")
    return "; ".join(parts)


def _information(
    planned: Sequence[Loading], readings: Readings, cell: Cell, problem: LoadedProblem, parameters: ModelParameters
) -> Float3D:
    """Return what each planned configuration will tell about the compliances, (k, n, n)."""
    n = problem.chain.n
    if not planned:
        return np.empty((0, n, n))
    foreseen = simulate_plan(planned, cell, parameters, None)
    order = [foreseen.points.index(name) for name in readings.points]
    assert order == sorted(order)  # noqa: S101 - both name the cell's points in its order
    ahead = build_problem(foreseen, cell, problem.chain, parameters)
    linear = ahead.linearise(parameters.compliance)
    matrix = normal_equations(linear.rows, linear.residual, linear.columns).matrix
    numbers = np.unique(foreseen.configuration)
    return np.asarray(matrix[[int(np.searchsorted(numbers, one.number)) for one in planned]])


def _accuracy(matrix: Float2D, compliance: Float1D, scale: float) -> Float1D:
    """Return half of each 95 % interval over its value; infinite where the information does not determine it."""
    size = np.sqrt(np.clip(np.diag(matrix), 0.0, None))
    if not np.all(size > 0.0):
        return np.full(len(size), np.inf)
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    if values[0] <= DETERMINED * values[-1]:
        return np.full(len(size), np.inf)
    std = scale * np.sqrt((vectors**2 / values).sum(axis=1)) / size
    return np.where(compliance > 0.0, TWO_SIDED * std / np.where(compliance > 0.0, compliance, 1.0), np.inf)


def _next(planned: Sequence[Loading], information: Float3D, total: Float2D, compliance: Float1D) -> int | None:
    """Return the number of the configuration after which the worst joint would be known best."""
    if not planned:
        return None
    believed = np.where(compliance > 0.0, compliance, max(float(compliance.max()), 1e-12))
    worst = [float(_accuracy(total + one, believed, 1.0).max()) for one in information]
    if not np.isfinite(worst).any():  # nothing is determined yet: what tells most about all of them together
        worst = [
            -float(np.linalg.slogdet(one * np.outer(believed, believed) + np.eye(len(one)))[1]) for one in information
        ]
    return int(planned[int(np.argmin(worst))].number)


def _misfit(fit: LoadedFit, problem: LoadedProblem, last: int, held_out: Float2D) -> tuple[float, float]:
    """Return how badly the last configuration is predicted from the others, and the limit, both m rms.

    The sum of squares grows by D = chi2_c + v_c^T (N - N_c)^-1 v_c when configuration c joins the others, which is
    chi-squared with as many degrees of freedom as c has beyond its offsets, times the variance seen in the others.
    """
    rows = problem.readings.configuration == last
    index = int(problem.configuration[np.flatnonzero(rows)[0]])
    size = float(np.sqrt(np.mean(held_out[rows] ** 2)))
    normal = fit.normal
    if index >= len(normal.matrix) or normal.freedom[index] < 1:
        return float("nan"), float("nan")
    rest = normal.matrix.sum(axis=0) - normal.matrix[index]
    if not np.all(np.isfinite(_accuracy(rest, np.ones(len(rest)), 1.0))):
        return float("nan"), float("nan")
    vector = normal.vector[index]
    grown = float(normal.chi2[index] + vector @ np.linalg.solve(rest, vector))
    freedom = max(fit.freedom - int(normal.freedom[index]), 1)
    variance = max(1.0, (fit.chi2 - grown) / freedom)
    limit = variance * chi2_limit(FALSE_ALARM, int(normal.freedom[index]))
    return size, size * float(np.sqrt(limit / grown)) if grown > 0.0 else float("inf")
