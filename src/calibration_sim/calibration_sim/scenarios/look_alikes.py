"""Which other places and effects would show what an effect shows, so nearly that no test could choose.

A rival is as good as the truth if the best of its parameters leaves less of the signal than a few nats of likelihood.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calibration_core.timeseries import Float1D, Float2D
from calibration_sim.scenarios.influence import Background, beyond, span
from calibration_sim.scenarios.yielding import Place

NATS = 5.0  # half the sum of squares, in units of sigma, that a rival leaves


def look_alikes(known: Background, blocks: Mapping[Place, Float2D], shown: Float1D) -> list[dict[str, Any]]:
    """Return the effects and places that leave less than a few nats of a signal (r,), as in a label.

    Args:
        known: What is refitted anyway.
        blocks: Effect and place -> columns (r, k), m.
        shown: What is to be imitated, beyond what is refitted, in units of sigma.
    """
    found = []
    for (effect, location), columns in blocks.items():
        basis = span(beyond(known, columns))
        left = shown - basis @ (basis.T @ shown)
        if 0.5 * float(left @ left) < NATS:
            place = {key: list(value) if isinstance(value, tuple) else value for key, value in location}
            found.append({"effect": effect, "location": place})
    return found
