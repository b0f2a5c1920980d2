"""Elastostatic compliance calibration of articulated industrial robots (CWA 17384), without ROS.

What stands in `__all__` is the library; everything else may change without notice.  The names are loaded when they are
first used, so that importing the package costs next to nothing.

    import calibration_core as cal

    cell = cal.load_cell("config/cells/small.cell.yaml")
    recording = cal.load_recording("bags/small_loaded", cell)
    result = cal.identify(recording)
    print(result.summary)
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calibration_core.cell import Cell, load_cell
    from calibration_core.errors import CalibrationError, EquilibriumError, InputError
    from calibration_core.library.acceptance import ComparisonResult, VerificationResult, compare, verify
    from calibration_core.library.application import CompensationResult, DeflectionResult, compensate, deflect
    from calibration_core.library.diagnosis import DiagnosisResult, diagnose
    from calibration_core.library.export import ExportResult, export
    from calibration_core.library.identification import IdentificationResult, identify
    from calibration_core.library.planning import PlanResult, plan
    from calibration_core.library.prediction import PredictionResult, predict
    from calibration_core.library.recordings import Recording, load_recording
    from calibration_core.library.result import Picture
    from calibration_core.library.simulation import SimulationResult, simulate

__version__ = "0.1.0"

__all__ = [
    "CalibrationError",
    "Cell",
    "ComparisonResult",
    "CompensationResult",
    "DeflectionResult",
    "DiagnosisResult",
    "EquilibriumError",
    "ExportResult",
    "IdentificationResult",
    "InputError",
    "Picture",
    "PlanResult",
    "PredictionResult",
    "Recording",
    "SimulationResult",
    "VerificationResult",
    "compare",
    "compensate",
    "deflect",
    "diagnose",
    "export",
    "identify",
    "load_cell",
    "load_recording",
    "plan",
    "predict",
    "simulate",
    "verify",
]

_HOME = {
    "cell": ("Cell", "load_cell"),
    "errors": ("CalibrationError", "EquilibriumError", "InputError"),
    "library.acceptance": ("ComparisonResult", "VerificationResult", "compare", "verify"),
    "library.application": ("CompensationResult", "DeflectionResult", "compensate", "deflect"),
    "library.diagnosis": ("DiagnosisResult", "diagnose"),
    "library.export": ("ExportResult", "export"),
    "library.identification": ("IdentificationResult", "identify"),
    "library.planning": ("PlanResult", "plan"),
    "library.prediction": ("PredictionResult", "predict"),
    "library.recordings": ("Recording", "load_recording"),
    "library.result": ("Picture",),
    "library.simulation": ("SimulationResult", "simulate"),
}
_MODULE = {name: module for module, names in _HOME.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _MODULE:
        msg = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(msg)
    value = getattr(importlib.import_module(f"{__name__}.{_MODULE[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
