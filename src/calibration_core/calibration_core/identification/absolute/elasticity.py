"""Whether absolute positions show joints giving way under gravity, or something that only looks like it.

A compliance column lowers almost any residual a little.  It is believed only if held-out configurations gain clearly,
if most of that gain is lost when gravity is turned by 90 degrees, and if it is not the first harmonic of the same
joints' transmissions in disguise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.identification.absolute.prediction_error import LinearModel, compare
from calibration_core.identification.geometry.fit import AbsoluteProblem, GeometryFit
from calibration_core.identification.geometry.identifiability import LEAST_REST, columns_rest
from calibration_core.identification.geometry.terms import ElasticityTerm, HarmonicTerm, Term
from calibration_core.identification.statistics.sizes import rms_length
from calibration_core.model.effects.absolute.joint_elasticity import turned
from calibration_core.timeseries import Float2D, Int1D

COLLAPSED = 1 / 3  # share of the gain that the best control may keep: most of it must go
UNLOADED = 1e-6  # length of a joint's column, relative to the longest, below which gravity does not load it


@dataclasses.dataclass(frozen=True)
class ElasticityVerdict:
    """What the linearised comparison says.

    Attributes:
        joints: Joints whose compliance improves held-out configurations clearly, counted from 0, best first.
        loaded: Joints that gravity loads.
        believed: Whether the claim survives both controls.
        reason: Why, with figures.
        rms: 3-d root mean square of the linearised model with these compliances, m.
        held_out_rms: The same on configurations left out, m.
    """

    joints: tuple[int, ...]
    loaded: tuple[int, ...]
    believed: bool
    reason: str
    rms: float
    held_out_rms: float


def judge_elasticity(
    problem: AbsoluteProblem, geometry: GeometryFit, fold: Int1D, configuration: Int1D
) -> ElasticityVerdict:
    """Test axial joint compliances under gravity against held-out configurations and two controls.

    Everything is linearised once at the geometric solution (sag is a few thousandths of the lengths, so what is left
    out is a few thousandths of the sag).  Joints are taken one by one, the one with the largest gain first, as long as
    the gain is clear (`Improvement.clear`); where none is clear alone, all of them together.  The controls are given
    every freedom: either sign, where compliances are bound to be positive; each harmonic two amplitudes per joint.

    Args:
        problem: The readings used.
        geometry: The geometric fit.
        fold: (m,) fold of every reading.
        configuration: (m,) configuration of every reading.
    """
    n = problem.chain.n
    joints = tuple(range(n))
    sideways = [tuple(gravity.tolist()) for gravity in turned(problem.chain.gravity)]
    blocks: list[Term] = [
        *geometry.terms,
        ElasticityTerm(joints, tuple(f"C{j}" for j in joints)),
        *(
            ElasticityTerm(joints, tuple(f"{k}C{j}" for j in joints), g, either_sign=True)
            for k, g in enumerate(sideways)
        ),
        HarmonicTerm(joints),
    ]
    model = LinearModel(problem, geometry.parameters, blocks, fold)
    base = list(range(len(geometry.names)))
    real = len(base)
    before = model.held_out(base)
    loaded = tuple(_loaded(model, real, n))
    chosen, after = _choose_joints(model, base, real, loaded, before, configuration)
    if not chosen:
        chosen = tuple(column - real for column in _sound(model, base, [real + j for j in loaded]))
        after = model.held_out([*base, *(real + j for j in chosen)])
    main = compare(before, after, configuration)
    fitted = rms_length(model.fitted([*base, *(real + j for j in chosen)]).T)
    if not chosen or not main.clear:
        reason = f"no joint's compliance helps clearly; all together: {main.text}"
        return ElasticityVerdict(chosen, loaded, believed=False, reason=reason, rms=fitted, held_out_rms=main.after)
    others = [_sound(model, base, [real + (k + 1) * n + j for j in chosen]) for k in range(len(sideways))]
    controls = [model.held_out([*base, *columns]) for columns in others]
    gains = [compare(before, control, configuration).gain for control in controls]
    best = int(np.argmax(gains))
    kept = max(gains[best], 0.0) / main.gain
    against = compare(controls[best], after, configuration)
    first = real + (1 + len(sideways)) * n
    waves = [*base, *_sound(model, base, [first + 2 * j + part for j in chosen for part in (0, 1)])]
    wave = model.held_out(waves)
    beyond = compare(wave, model.held_out([*waves, *(real + j for j in chosen)]), configuration)
    names = ", ".join(problem.chain.joints[j] for j in chosen)
    reason = (
        f"{names}: {main.text}; with gravity turned by 90 degrees {100 * kept:z.0f} % of the gain remains; "
        f"beyond the first harmonic of these joints' own angles: {beyond.text}"
    )
    collapses = kept <= COLLAPSED and against.clear
    if not collapses:
        reason = f"{reason}: the gain does not collapse, so it is not gravity's"
    elif not beyond.clear:
        reason = f"{reason}: it cannot be distinguished from a harmonic of the transmission"
    return ElasticityVerdict(chosen, loaded, collapses and beyond.clear, reason, fitted, main.after)


def _choose_joints(
    model: LinearModel, base: list[int], real: int, loaded: Sequence[int], before: Float2D, configuration: Int1D
) -> tuple[tuple[int, ...], Float2D]:
    """Return the joints that gain clearly, one after another, and the held-out residuals with them."""
    open_joints = list(loaded)
    chosen: list[int] = []
    current = before
    while open_joints:
        taken = [*base, *(real + j for j in chosen)]
        sound = [j for j in open_joints if _sound(model, taken, [real + j])]
        trials = {j: model.held_out([*taken, real + j]) for j in sound}
        gains = {j: compare(current, trial, configuration) for j, trial in trials.items()}
        clear = [j for j in sound if gains[j].clear]
        if not clear:
            break
        best = max(clear, key=lambda j: gains[j].gain)
        chosen.append(best)
        open_joints.remove(best)
        current = trials[best]
    return tuple(chosen), current


def _loaded(model: LinearModel, real: int, n: int) -> list[int]:
    """Return the joints that gravity loads."""
    length = np.sqrt(np.diag(model.matrix)[real : real + n])
    return [j for j in range(n) if length[j] > UNLOADED * max(float(length.max()), 1e-300)]


def _sound(model: LinearModel, base: Sequence[int], offered: Sequence[int]) -> list[int]:
    """Return those of the offered columns that the base and each other do not explain."""
    taken: list[int] = []
    for column in offered:
        index = [*base, *taken, column]
        matrix = model.matrix[np.ix_(index, index)]
        if matrix[-1, -1] > 0 and columns_rest(matrix, len(index) - 1) >= LEAST_REST:
            taken.append(column)
    return taken
