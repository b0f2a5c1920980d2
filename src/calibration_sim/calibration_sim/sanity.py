"""`python -m calibration_sim.sanity`: how loudly each effect of typical size speaks, beside a study's values.

Median over effects drawn at every joint that a maker may choose.
"""

from __future__ import annotations

import numpy as np

from calibration_sim.influence import Background, background, signal_to_noise
from calibration_sim.makers import CATALOGUE
from calibration_sim.makers.draw import Draw
from calibration_sim.protocols import make_protocol
from calibration_sim.robots import MAGNITUDES, ROBOTS, robot_cell
from calibration_sim.truth import draw_truth, generator
from calibration_sim.world import World, play

DRAWS = 6
# docs/physics.md, A1-A3: SNR of a 240 kg robot under L and R, of a 10 kg robot under L.
STUDY = {
    "off_axis_compliance": (77, 183, 19),
    "link_bending": (47, 113, 20),
    "base_compliance": (100, 200, 18),
    "tool_compliance": (12, 25, 2),
    "joint_coupling": (27, 65, 11),
    "pose_dependent_stiffness": (13, 32, 5),
    "gravity_compensator": (10, 23, 2),
    "nonlinear_stiffness": (23, 41, 10),
    "soft_zone": (32, 74, 18),
    "backlash": (30, 53, 8),
    "hysteresis": (47, 70, 40),
    "creep": (4, 7, 2),
    "wrench_gain": (11, 32, 3),
    "wrench_crosstalk": (29, 73, 9),
    "wrench_drift": (1, 2, 0),
    "wrench_frame_misalignment": (19, 44, 6),
    "wrench_point_offset": (7, 17, 2),
    "tool_weight": (0, 1, 0),
    "cable_force": (0, 0, 0),
    "tracker_frame_misalignment": (5, 12, 2),
    "tracker_scale": (0, 0, 0),
    "tracker_drift": (0, 0, 0),
    "measurement_point_offset": (5, 12, 2),
    "joint_zero_offset": (4, 7, 1),
    "thermal_growth": (2, 5, 1),
}
KINDS = ("L", "R", "LA")


def table(seed: int = 1) -> str:
    """Return the table as Markdown."""
    known = {}
    for robot in ROBOTS:
        cell = robot_cell(robot)
        for kind in KINDS:
            protocol = make_protocol(cell, kind, seed)
            sigma = float(cell.instruments.tracker.sigma or 0.0)
            known[robot, kind] = background(World(cell, draw_truth(cell, seed)), protocol, sigma)
    lines = ["| effect | heavy L | study | heavy R | study | light L | study | heavy LA | light R | light LA |"]
    lines.append("|---|" + "---|" * 9)
    for name in CATALOGUE:
        figures = {key: _median(name, key[0], value, seed) for key, value in known.items()}
        study = STUDY.get(name, ("", "", ""))
        cells = [
            figures["heavy", "L"],
            study[0],
            figures["heavy", "R"],
            study[1],
            figures["light", "L"],
            study[2],
            figures["heavy", "LA"],
            figures["light", "R"],
            figures["light", "LA"],
        ]
        lines.append(f"| {name} | " + " | ".join(f"{c:.1f}" if isinstance(c, float) else str(c) for c in cells) + " |")
    return "\n".join(lines)


def _median(name: str, robot: str, known: Background, seed: int) -> float:
    cell = robot_cell(robot)
    found = []
    for k in range(DRAWS):
        rng = generator(seed + k, 7)
        draw = Draw(MAGNITUDES[robot], np.array(cell.robot.stiffness), 1.0, rng)
        effect = CATALOGUE[name](draw)
        found.append(signal_to_noise(known, play(known.world.with_effects(effect), known.protocol)))
    return float(np.median(found))


if __name__ == "__main__":
    print(table())
