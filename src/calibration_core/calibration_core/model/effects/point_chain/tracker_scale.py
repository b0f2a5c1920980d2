"""The tracker's unit of length is wrong: all that it sees is farther from it, or nearer, by the same share.

p_read = (1 + s) p in the tracker's frame.  Source: refraction of air at a temperature, pressure and humidity other than
set, 1 ppm per K.  Deflections show it nowhere: there it is a common factor of all compliances.
"""

from __future__ import annotations

from collections.abc import Iterator

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, typical
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D


def _columns(state: State) -> Float3D:
    return stacked(state.point.T - state.tracker[:3, 3])


def _candidates(state: State) -> Iterator[Candidate]:
    parameters = (Parameter("scale", "1", typical("tracker_scale", state.rated_load)),)
    yield Candidate(EFFECT.name, EFFECT.family, {"tracker": "tracker"}, "common factor", parameters, _columns)


EFFECT = Effect(
    name="tracker_scale",
    family="point chain",
    equation="p_read = (1 + s) p, in the tracker's frame",
    source="refraction of air, 1 ppm per K",
    reveal="a scale bar, or targets at known distances",
    candidates=_candidates,
    loaded=False,
    sentence="the tracker's scale is off",
)
