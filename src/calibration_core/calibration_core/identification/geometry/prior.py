"""What earlier phases found, with its full covariance, as the beginning of the next one.

The phases of the standard (7.1 to 7.6) build on each other.  What one of them leaves is a normal distribution over the
parameters of frames, points and geometry; the next adds its own readings to it.  With readings y, model f and knowledge
(x0, P), the next phase minimises |W (y - f(x))|^2 + (x - x0)^T P^-1 (x - x0), whose information matrix is the sum of
both: the order of the phases does not matter, nothing is counted twice, and nothing is taken as exact that is not.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.identification.geometry.fit import (
    AbsoluteProblem,
    NormalEquations,
    fit,
    freedom_beside,
    normal_equations,
)
from calibration_core.identification.geometry.terms import ElasticityTerm, GeometryTerm, Term, TrackerTerm, names_of
from calibration_core.identification.statistics.distributions import LEVEL, chi2_limit
from calibration_core.identification.statistics.solve import scaled_inverse
from calibration_core.model.chain import rotation_vector
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float1D, Float2D


@dataclasses.dataclass(frozen=True, eq=False)
class ConsiderParameters:
    """Parameters that readings cannot tell from others: they stay nominal, and their doubt is not forgotten.

    Where such a parameter is wrong, others take up the difference, so that the readings are met all the same; what
    else depends on it, such as where the sensor sits, is then wrong.

    Attributes:
        term: The parameters.
        across: (p, h) information between the parameters that are fitted and these.
        std: (h,) usual errors of nominal values, one standard deviation, m or rad.
    """

    term: GeometryTerm
    across: Float2D
    std: Float1D


@dataclasses.dataclass(frozen=True, eq=False)
class GaussianPrior:
    """Values of frames, points and geometry and how well they are known.

    Attributes:
        parameters: The values; what no term names is taken as it stands.
        terms: The parameters that have an uncertainty.
        information: (p, p) inverse covariance of the terms' parameters in their order, SI units; for the tracker pose
            of the twist (v, w) that makes T -> [exp(w), v] T.  A row of zeros: nothing is known yet.
        scale: Factor by which the residuals of the last readings exceeded the instruments' claim (1: they did not).
        freedom: Degrees of freedom of that comparison.
        held: What stays nominal; None: nothing.
    """

    parameters: ModelParameters
    terms: tuple[Term, ...]
    information: Float2D
    scale: float = 1.0
    freedom: int = 0
    held: ConsiderParameters | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of `covariance`."""
        return names_of(self.terms)

    @property
    def covariance(self) -> Float2D:
        """(p, p), SI units.

        Raises:
            numpy.linalg.LinAlgError: Something is not known at all.
        """
        return scaled_inverse(self.information)

    def normal(self, parameters: ModelParameters) -> NormalEquations:
        """Return what this knowledge adds to the normal equations at other values (no readings)."""
        step = difference(self.terms, self.parameters, parameters)
        pull = self.information @ step
        return NormalEquations(self.information, -pull, float(step @ pull), 0)

    def and_of(self, term: Term) -> GaussianPrior:
        """Return the same knowledge with one more term, of which nothing is known yet."""
        count = len(term.names)
        held = self.held
        return dataclasses.replace(
            self,
            terms=(*self.terms, term),
            information=np.pad(self.information, ((0, count), (0, count))),
            held=None if held is None else dataclasses.replace(held, across=np.pad(held.across, ((0, count), (0, 0)))),
        )

    def without_compliances(self) -> GaussianPrior:
        """Return what is known of everything but the compliances, whatever these are (the marginal)."""
        bends = [isinstance(term, ElasticityTerm) for term in self.terms]
        gone = np.repeat(bends, [len(term.names) for term in self.terms])
        kept = np.flatnonzero(~gone)
        share = np.linalg.solve(self.information[np.ix_(gone, gone)], self.information[np.ix_(gone, ~gone)]).T
        held = self.held
        if held is not None:
            held = dataclasses.replace(held, across=held.across[kept] - share @ held.across[gone])
        return dataclasses.replace(
            self,
            terms=tuple(term for term, bend in zip(self.terms, bends, strict=True) if not bend),
            information=self.information[np.ix_(kept, kept)] - share @ self.information[np.ix_(gone, kept)],
            held=held,
        )


def learn(problem: AbsoluteProblem, known: GaussianPrior) -> GaussianPrior:
    """Add readings of absolute positions to what is known.

    Where their residuals are larger than the instrument's claim explains (1 % level), the readings count less, by the
    factor of the residuals over the claim, squared.

    Raises:
        EquilibriumError: The compliances do not carry the robot's own weight.
    """
    found = fit(problem, known.parameters, known.terms, known)
    seen = normal_equations(problem, found.parameters, known.terms)
    freedom = freedom_beside(seen, seen.matrix + known.information)
    ratio = float(np.sqrt(seen.cost / freedom)) if freedom > 0 else 1.0
    scale = ratio if freedom > 0 and seen.cost > chi2_limit(LEVEL, freedom) and ratio > 1.0 else 1.0
    if scale > 1.0:
        whitening = problem.whitening / scale
        problem = dataclasses.replace(problem, whitening=whitening)
        found = fit(problem, found.parameters, known.terms, known)
        seen = normal_equations(problem, found.parameters, known.terms)
    held = known.held
    if held is not None:
        p = len(known.names)
        both = normal_equations(problem, found.parameters, (*known.terms, held.term)).matrix
        held = dataclasses.replace(held, across=held.across + both[:p, p:])
    return GaussianPrior(found.parameters, known.terms, known.information + seen.matrix, scale, freedom, held)


def difference(terms: tuple[Term, ...], first: ModelParameters, second: ModelParameters) -> Float1D:
    """Return the step of the terms, (p,), that leads from one set of values to the other.

    Source: for the pose, T2 = [exp(w), v] T1, so w is the rotation vector of R2 R1^T and v = t2 - R2 R1^T t1.
    """
    parts = []
    for term in terms:
        if isinstance(term, TrackerTerm):
            turned = second.tracker[:3, :3] @ first.tracker[:3, :3].T
            shift = second.tracker[:3, 3] - turned @ first.tracker[:3, 3]
            parts.append(np.concatenate([shift, rotation_vector(turned)]))
        else:
            parts.append(term.values(second) - term.values(first))
    return np.concatenate(parts)
