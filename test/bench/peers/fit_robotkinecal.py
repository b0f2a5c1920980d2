"""Fit the shared problem with robotkinecal; runs in that package's own environment.

python fit_robotkinecal.py PROBLEM.npz REPETITIONS      prints one line of JSON
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
import time

import numpy as np
import roboticstoolbox as rtb
from robotkinecal import SerialRobotKineCal
from spatialmath import SE3

TIP = "tip"


def _robot(problem: dict[str, np.ndarray]) -> rtb.Robot:
    links: list[rtb.Link] = []
    for i, (rotation, translation) in enumerate(zip(problem["rotation"], problem["translation"], strict=True)):
        step = rtb.ET.SE3(_pose(rotation, translation)) * rtb.ET.Rz(jindex=i)
        links.append(rtb.Link(step, name=f"link_{i}", parent=links[-1] if links else None))
    tip = problem["flange_translation"] + problem["flange_rotation"] @ problem["point"]
    end = rtb.ETS(rtb.ET.SE3(_pose(problem["flange_rotation"], tip)))
    links.append(rtb.Link(end, name=TIP, parent=links[-1]))
    return rtb.Robot(links, name="bench")


def _pose(rotation: np.ndarray, translation: np.ndarray) -> SE3:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return SE3(pose, check=False)


def main(path: str, repetitions: int) -> None:
    """Fit `repetitions` times from the nominal robot, print the median time and the residual."""
    problem = dict(np.load(path))
    q, positions = list(problem["q"]), list(problem["positions"])
    seconds, rms, parameters = [], 0.0, 0
    for _ in range(repetitions):
        calibration = SerialRobotKineCal(_robot(problem), TIP)
        calibration.set_observations(q, positions)
        with contextlib.redirect_stdout(io.StringIO()):
            start = time.perf_counter()
            result = calibration.solve()
            seconds.append(time.perf_counter() - start)
        n = calibration.N_JOINTS + 1
        predicted = np.array([calibration.forward_kinematics(n, angles).t for angles in q])
        rms = float(np.sqrt(np.mean((predicted - problem["positions"]) ** 2)))
        parameters = int(np.linalg.matrix_rank(result.iteration_results[-1].A_all))
    print(json.dumps({"seconds": float(np.median(seconds)), "rms": rms, "parameters": parameters}))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
