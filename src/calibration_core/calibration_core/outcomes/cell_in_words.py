"""What a cell file means, in words."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import posture
from calibration_core.report.rounding import counted

COUNTS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


def meaning(cell: Cell, chain: Chain) -> list[tuple[str, str]]:
    """Return label and sentence of everything that the file states."""
    rows = [("Robot", _robot(cell, chain)), ("Flange at zero", _flange(chain))]
    frames, instruments, measured = cell.frames, cell.instruments, cell.measurements
    rows.append(("Stiffness", "stated for every joint" if cell.robot.stiffness else "not stated: found by identify"))
    rows.append(("Masses", _masses(cell, chain)))
    if frames.tracker is None:
        rows.append(("Tracker", "its place is not stated: it is found from the recording; planning needs it"))
    else:
        x, y, z = frames.tracker.xyz
        away = float(np.linalg.norm(frames.tracker.xyz))
        rows.append(("Tracker", f"{away:.3g} m from the base, at x {x:.3g} m, y {y:.3g} m, z {z:.3g} m"))
    rows.append(("Tracker's reading", _tracker(cell)))
    names = [f"{name} ({1e3 * float(np.linalg.norm(at)):.0f} mm)" for name, at in frames.measurement_points.items()]
    rows.append(("Targets, from the flange", ", ".join(names)))
    if frames.wrench_point is not None:
        rows.append(
            ("Load", f"pulls {1e3 * float(np.linalg.norm(frames.wrench_point)):.0f} mm from the flange's origin")
        )
    if instruments.force_torque is not None:
        sensor = instruments.force_torque
        rows.append(("Force/torque sensor", f"reads to {sensor.sigma_force:g} N and {sensor.sigma_torque:g} N·m (1 σ)"))
    axes = "base" if measured.wrench_axes == "base" else "the sensor's"
    about = "the wrench point" if measured.wrench_at == "wrench_point" else "the sensor's origin"
    rows.append(("Wrenches", f"in {axes} axes, about {about}: what the environment does to the robot"))
    kind = "positions in the tracker's frame" if measured.points == "absolute" else "differences to the unloaded step"
    rows.append(("Readings", kind))
    if cell.boxes:
        rows.append(("Boxes", ", ".join(box.name for box in cell.boxes)))
    return rows


def _robot(cell: Cell, chain: Chain) -> str:
    turning, sliding = len(chain.revolute), chain.n - len(chain.revolute)
    kinds = [f"{_count(turning)} turning" if turning else "", f"{_count(sliding)} sliding" if sliding else ""]
    joints = f"{' and '.join(kind for kind in kinds if kind)} joints"
    if chain.mimics:
        verb = "mimic others" if chain.mimics[1:] else "mimics another"
        joints += f" and {_count(len(chain.mimics))} more that {verb}"
    source = "URDF" if cell.robot.dh is None else "DH rows"
    size = f"{chain.reach:.3g} m long, rated load {cell.robot.rated_load:g} kg"
    return f"{cell.robot.name}: {joints} ({source}), {size}"


def _flange(chain: Chain) -> str:
    at = posture(chain, np.zeros((1, chain.n)))
    x, y, z = at.flange_origin[:, 0]
    axis = at.flange[2][:, 0]
    towards = "xyz"[int(np.argmax(np.abs(axis)))]
    sign = "+" if axis[int(np.argmax(np.abs(axis)))] > 0 else "-"
    return f"x {x:z.3f} m, y {y:z.3f} m, z {z:z.3f} m in the base frame; its z axis points along {sign}{towards}"


def _masses(cell: Cell, chain: Chain) -> str:
    mass = chain.whole.mass
    if mass is None:
        return "not stated: the sag of the links under their own weight is not predicted"
    known = "" if cell.robot.inertials_known else ", declared as guesses"
    return f"{float(mass.sum()):.4g} kg in {counted(int(np.count_nonzero(mass)), 'moving link')}{known}"


def _tracker(cell: Cell) -> str:
    tracker = cell.instruments.tracker
    if tracker.sigma is not None:
        return f"to {1e6 * tracker.sigma:.3g} µm for each coordinate (1 σ)"
    along, angle = 1e6 * (tracker.sigma_range or 0.0), 1e6 * (tracker.sigma_angle or 0.0)
    more = 1e6 * tracker.sigma_range_per_m
    return f"to {along:.3g} µm and {more:.2g} µm/m along the beam, {angle:.3g} µrad across (1 σ)"


def _count(number: int) -> str:
    return COUNTS[number] if number < len(COUNTS) else str(number)
