"""Fit the shared problem with figaroh (`full_params`); runs in that package's own environment.

python fit_figaroh.py PROBLEM.npz REPETITIONS      prints one line of JSON
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml
from figaroh.calibration.base_calibration import BaseCalibration
from figaroh.calibration.calibration_tools import calc_updated_fkm
from figaroh.tools.robot import Robot

JOINT = """<link name="l{i}"/><joint name="j{i}" type="revolute"><parent link="{parent}"/><child link="l{i}"/>
<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/><limit lower="-3.1" upper="3.1" effort="1" velocity="1"/></joint>"""
TIP = """<link name="tip"/><joint name="tip_joint" type="fixed"><parent link="{parent}"/><child link="tip"/>
<origin xyz="{xyz}" rpy="{rpy}"/></joint>"""


class Calibration(BaseCalibration):
    """figaroh's calibration with plain position residuals in the base frame, metres."""

    def cost_function(self, var: np.ndarray) -> np.ndarray:
        """Return the residuals."""
        predicted = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
        return self._compute_logmap_residuals(self.PEE_measured, predicted, position_frame="world")


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)


def _write_files(problem: dict[str, np.ndarray], folder: Path) -> None:
    parent, parts = "base", ['<robot name="bench"><link name="base"/>']
    for i, (rotation, translation) in enumerate(zip(problem["rotation"], problem["translation"], strict=True)):
        rpy = _text(pin.rpy.matrixToRpy(rotation))
        parts.append(JOINT.format(i=i, parent=parent, xyz=_text(translation), rpy=rpy))
        parent = f"l{i}"
    tip = problem["flange_translation"] + problem["flange_rotation"] @ problem["point"]
    rpy = _text(pin.rpy.matrixToRpy(problem["flange_rotation"]))
    parts.append(TIP.format(parent=parent, xyz=_text(tip), rpy=rpy) + "</robot>")
    (folder / "robot.urdf").write_text("\n".join(parts))
    n = problem["q"].shape[1]
    header = ",".join(["x1", "y1", "z1", *(f"j{i}" for i in range(n))])
    table = np.hstack([problem["positions"], problem["q"]])
    np.savetxt(folder / "data.csv", table, delimiter=",", header=header, comments="", fmt="%.17g")
    measured = {"name": "m", "measurable_dof": [True, True, True, False, False, False]}
    config = {
        "robot": {"name": "bench"},
        "tasks": {
            "calibration": {
                "type": "kinematic_calibration",
                "kinematics": {"base_frame": "universe", "tool_frame": "tip"},
                "joints": {"active_joints": [f"j{i}" for i in range(n)]},
                "parameters": {
                    "calibration_level": "full_params",
                    # its default selection leaves one parameter of this robot out and stays at 0.25 mm
                    "estimation": {"method": "excitation", "noise_std": float(problem["sigma"])},
                },
                "measurements": {"markers": [measured]},
                "data": {"number_of_samples": len(table), "source_file": str(folder / "data.csv")},
            }
        },
    }
    (folder / "config.yaml").write_text(yaml.safe_dump(config))


def main(path: str, repetitions: int) -> None:
    """Fit `repetitions` times from the nominal robot, print the median time and the residual."""
    problem = dict(np.load(path))
    seconds, rms, parameters = [], 0.0, 0
    with tempfile.TemporaryDirectory() as name, contextlib.redirect_stdout(io.StringIO()):
        folder = Path(name)
        _write_files(problem, folder)
        for _ in range(repetitions):
            robot = Robot(str(folder / "robot.urdf"), package_dirs=str(folder))
            calibration = Calibration(robot, str(folder / "config.yaml"))
            calibration.calib_config.update(known_baseframe=False, known_tipframe=False)
            calibration.initialize()
            start = time.perf_counter()
            result, _ = calibration.solve_optimisation()
            seconds.append(time.perf_counter() - start)
            rms = float(np.sqrt(np.mean(calibration.cost_function(result.x) ** 2)))
            parameters = len(result.x)
    print(json.dumps({"seconds": float(np.median(seconds)), "rms": rms, "parameters": parameters}))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
