"""What is wrong with the data, before any physics: no model of the robot's elasticity is needed for it."""

from __future__ import annotations

from calibration_core.identification.estimate import Anomaly, Identification


def find_anomalies(identification: Identification) -> tuple[Anomaly, ...]:
    """Return the anomalies that the identification names."""
    return identification.anomalies
