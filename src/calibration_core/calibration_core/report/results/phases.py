"""The phases of a calibration, and arm and wrist apart, as parts of result.json."""

from __future__ import annotations

from typing import Any

from calibration_core.identification.result.estimate import Identification, PhaseEstimate


def phases_dict(result: Identification) -> list[dict[str, Any]]:
    """Return one entry per phase: values, standard deviations and the full covariance, SI units."""
    return [_phase(phase) for phase in result.phases]


def _phase(phase: PhaseEstimate) -> dict[str, Any]:
    return {
        "phase": phase.phase,
        "clause": phase.clause,
        "readings": phase.readings,
        "parameters": [
            {"name": name, "value": float(phase.values[i]), "std": float(phase.std[i]), "unit": phase.unit(i)}
            for i, name in enumerate(phase.names)
        ],
        "covariance": phase.covariance,
        "scale": phase.scale,
        "remarks": list(phase.remarks),
    }


def decoupled_dict(result: Identification) -> dict[str, Any] | None:
    """Return the stiffnesses of arm and wrist apart, N*m/rad, and how they compare; None where not asked for."""
    found = result.decoupled
    if found is None:
        return {"reason": result.not_decoupled} if result.not_decoupled else None
    return {
        "wrist_centre": {"flange": found.wrist_centre, "measured": found.measured},
        "stiffness": [
            {
                "joint": joint,
                "part": "arm" if i < found.arm else "wrist",
                "value": 1 / float(found.compliance[i]),
                "std": float(found.std[i] / found.compliance[i] ** 2),
                "together": 1 / float(found.together[i]),
                "difference_std": float(found.difference_std[i] / found.compliance[i] ** 2),
            }
            for i, joint in enumerate(found.joints)
        ],
        "comparison": {
            "chi2": found.chi2,
            "degrees_of_freedom": found.freedom,
            "limit": found.limit,
            "agree": found.agree,
        },
    }
