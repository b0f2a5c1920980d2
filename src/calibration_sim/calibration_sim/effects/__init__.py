"""Physics that a model may leave out, with laws of its own: what the diagnosis is tried on, never what it believes.

A maker of a family draws an effect from an amplitude and a source of randomness; its name is the effect's.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from types import MappingProxyType, ModuleType

from calibration_sim.effects import (
    absolute,
    anomalies,
    chains,
    everywhere,
    joints,
    other_shapes,
    outside,
    structure,
)
from calibration_sim.effects.draw import Draw
from calibration_sim.effects.effect import Effect

Maker = Callable[[Draw], Effect]


def _makers(*families: ModuleType) -> Mapping[str, Maker]:
    """Return the public functions of a draw alone, in the order in which the families define them."""
    functions = [item for family in families for item in vars(family).items() if inspect.isfunction(item[1])]
    return MappingProxyType(
        {name: made for name, made in functions if name[0] != "_" and [*inspect.signature(made).parameters] == ["draw"]}
    )


CATALOGUE = _makers(structure, joints, chains, absolute)
ANOMALIES, OUTSIDE = _makers(anomalies), _makers(outside)
OTHER_SHAPES, EVERYWHERE = _makers(other_shapes), _makers(everywhere)
GENERATORS: Mapping[str, Maker] = MappingProxyType({**CATALOGUE, **ANOMALIES, **OUTSIDE, **OTHER_SHAPES, **EVERYWHERE})
