"""An input that is not what it claims to be: of which kind it is, what shows it, and how to put it right.

A common factor of all forces or of all positions: it leaves no residual, and shows in how stiff the robot seems.

Judged by the stiffness that the cell file states, else by what robots of its rated load usually have, which tells
factors of a hundred and more.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.input_checks.explained import Motion, Reading, columns_of, posture_of
from calibration_core.model.chain import Chain
from calibration_core.model.effects.candidate import typical
from calibration_core.timeseries import Float1D, Float2D

ROBOT = "robot"
OF_ROBOT = frozenset({"wrong_robot_file", "joint_order", "no_relation", "angle_unit", "joint_coupling"})


@dataclasses.dataclass(frozen=True)
class InputAnomaly:
    """One thing about the input that has to be put right.

    Attributes:
        kind: One of the kinds, e.g. `wrench_sign`.
        text: One sentence: what is seen, with the figures as recorded and with the fault put right.
        magnitude: Share of the motion that the recording as it stands leaves unexplained, or the size of what is wrong.
        unit: Its unit.
        factor: What to multiply with, where it is a unit.
        axes: What to read the wrench in, where it is a frame.
        place: Where it is; empty: what the kind says.
        recording: Of several recordings, the file of the one that it concerns; empty: one alone.
    """

    kind: str
    text: str
    remedy: str
    magnitude: float
    unit: str = "1"
    factor: float | None = None
    joints: tuple[str, ...] = ()
    points: tuple[str, ...] = ()
    axes: str = ""
    place: str = ""
    recording: str = ""

    @property
    def blocks(self) -> bool:
        """Whether nothing may be claimed before it is put right."""
        return self.kind != "noise_overstated"

    def of_recording(self, file: str) -> InputAnomaly:
        """Return the same of one of several recordings, which its sentences name."""
        text, remedy = (f"in {file}, {sentence}" for sentence in (self.text, self.remedy))
        return dataclasses.replace(self, recording=file, text=text, remedy=remedy)

    @property
    def location(self) -> dict[str, str]:
        """Where it is, as in a finding."""
        usual = "sensor" if self.kind.startswith("wrench") else ROBOT if self.kind in OF_ROBOT else "tracker"
        where = self.place or usual
        return {where: where} | ({"recording": self.recording} if self.recording else {})

    def record(self) -> dict[str, Any]:
        """Return it as result.json has it; keys that do not apply are left out."""
        content: dict[str, Any] = {
            "kind": self.kind,
            "location": self.location,
            "configurations": None,
            "magnitude": self.magnitude,
            "unit": self.unit,
            "text": self.text,
            "remedy": self.remedy,
        }
        further = {
            "factor": self.factor,
            "joints": list(self.joints),
            "points": list(self.points),
            "axes": self.axes,
        }
        return {**content, **{key: value for key, value in further.items() if value not in (None, [], "")}}


# --- A common factor of all forces or of all positions ----------------------------------------------------------------


VISIBLE = 3.0  # times the claimed noise: less motion tells nothing
SEEN_BY_PRIOR = 100.0  # factor from the usual stiffness of a rated load that is a matter of units
SEEN_BY_STATED = 8.0  # factor from the stated stiffness
FORCES = ((1000.0, "kN", 0.01), (9.80665, "kgf", 0.3))  # N, name, largest force over the rated load's weight
LENGTHS = ((1e-3, "mm"), (0.01, "cm"), (0.0254, "inches"))  # m
POUND = 4.4482216152605  # N
TORQUE_UNITS = {1e-3: "N·mm", 1e3: "kN·m", 9.80665: "kgf·m", 0.0254 * POUND: "lbf·in"}  # by what makes N·m of them
FORCE_UNITS = {1e-3: "mN", 1e3: "kN", 9.80665: "kgf (daN: by 10)", POUND: "lbf"}  # by what makes N of them
OF_ITS_LOAD = "robots of its rated load do"


@dataclasses.dataclass(frozen=True, eq=False)
class CellSizes:
    """What a cell file tells about sizes.

    Attributes:
        rated_load: kg.
        stiffness: N*m/rad per joint, where the cell file states it.
        positions: Whether the recording holds positions, which say more of points and zeros than deflections do.
        base_claimed: Whether the messages say that the wrench is in base axes, against the cell file.
        tracker: (3, 3) axes of the tracker in the base frame, where the cell file states them.
    """

    rated_load: float
    stiffness: tuple[float, ...] | None
    joints: tuple[str, ...]
    positions: bool = True
    base_claimed: bool = False
    tracker: Float2D | None = None


def expected_motion(motion: Motion, given: Reading, facts: CellSizes) -> Float1D:
    """Return the (3 m,) motion, m, that a robot of the stated stiffness, or of the usual one, would show."""
    usual = np.full(len(facts.joints), typical("joint_elasticity", facts.rated_load))
    if facts.stiffness is not None:
        usual = 1.0 / np.array(facts.stiffness)
    return columns_of(motion, posture_of(motion), motion.force, motion.torque, given) @ usual


def apart() -> tuple[float, ...]:
    """Return the factors that torques of other units than the forces may need."""
    return tuple(sorted({*TORQUE_UNITS, *(1.0 / factor for factor in FORCE_UNITS)}))


def torques_apart(motion: Motion, given: Reading, facts: CellSizes, factor: float) -> InputAnomaly:
    """Name the unit that is wrong where torques belong to the forces only when they are multiplied by a factor.

    Either the torques are wrong, or the forces by the reciprocal: the springs fit alike.  Where both have a unit of
    that name, what is right lets the robot give way as its stated stiffness says, or as robots of its rated load
    usually do.
    """
    ways = []
    if torque_unit := _named(TORQUE_UNITS, factor):
        ways.append(("torques", factor, torque_unit, motion.force, factor * motion.torque))
    if force_unit := _named(FORCE_UNITS, 1 / factor):
        ways.append(("forces", 1 / factor, force_unit, motion.force / factor, motion.torque))
    moved = float(np.linalg.norm(motion.moved))

    def unlikely(force: Float2D, torque: Float2D) -> float:
        read = dataclasses.replace(motion, force=force, torque=torque)
        expected = float(np.linalg.norm(expected_motion(read, given, facts)))
        return abs(float(np.log(moved / expected))) if moved > 0 and expected > 0 else 0.0

    what, by, unit, _, _ = min(ways, key=lambda way: unlikely(*way[3:]))
    other = "torques" if what == "forces" else "forces"
    remedy = f"multiply the {what} by {by:g}: they look like {unit} beside {other} of another unit"
    text = "forces and torques have units that do not belong together"
    return InputAnomaly("wrench_unit", text, remedy, 0.0, factor=by)


def _named(units: Mapping[float, str], factor: float) -> str:
    return next((name for one, name in units.items() if math.isclose(one, factor)), "")


def unit_words(motion: Motion, facts: CellSizes) -> str:
    """Return in words why the unit of forces and positions is not checked, or only coarsely; empty where it is."""
    if motion.total < motion.freedom * (VISIBLE * motion.sigma) ** 2:
        return "the unit cannot be checked: the loads move the points by less than three times the noise"
    if facts.stiffness is None:
        return (
            "the unit is checked by what robots of this rated load usually have; a common factor below "
            f"{SEEN_BY_PRIOR:g} cannot be seen (state robot.stiffness for a closer check)"
        )
    return ""


def unit_anomaly(size: float, strength: float, *, stated: bool) -> list[InputAnomaly]:
    """Name the unit of forces or positions that a robot's apparent softness suggests; none within what may be.

    Args:
        size: Motion seen over motion expected.
        strength: Largest force over the weight of the rated load.
        stated: Whether the expectation rests on a stated stiffness.
    """
    limit = SEEN_BY_STATED if stated else SEEN_BY_PRIOR
    if 1.0 / limit < size < limit:
        return []
    seen = f"the robot gives way {size:.2g} times as much as {'its stated stiffness says' if stated else OF_ITS_LOAD}; "
    seen += f"the largest force is {100 * strength:.2g} % of the rated load"
    if size <= 1.0 / limit:
        remedy = "give positions in m: multiply them by 1000 (they look like km, or millimetres divided twice)"
        return [InputAnomaly("position_unit", seen, remedy, size, factor=1e3)]
    units = [(factor, name) for factor, name, most in FORCES if strength < most]
    units += [(1 / factor, name) for factor, name in LENGTHS]
    factor, name = min(units, key=lambda unit: abs(np.log(size / unit[0])))
    if name in {unit for _, unit, _ in FORCES}:
        remedy = f"give forces in N and torques in N·m: multiply them by {factor:g} (they look like {name})"
        return [InputAnomaly("wrench_unit", seen, remedy, size, factor=factor)]
    remedy = f"give positions in m: multiply them by {1 / factor:g} (they look like {name})"
    return [InputAnomaly("position_unit", seen, remedy, size, factor=1 / factor)]


LONGEST_ARM = 100.0  # m, linear axes included
LONGEST_TRAVEL = 500.0  # m, of a linear unit from its zero
FARTHEST_TRACKER = 300.0  # m; laser trackers measure up to 160 m
LARGEST_TOOL = 20.0  # m, from the flange to a measurement point, the wrench point or the sensor


def check_lengths(cell: Cell, chain: Chain) -> list[InputAnomaly]:
    """Return the lengths of a cell file that look like millimetres, as one anomaly; empty where they are plausible."""
    places: list[tuple[str, float, float]] = [("robot (its kinematics)", chain.reach, LONGEST_ARM)]
    if any(chain.prismatic):
        stated = "the URDF's limits" if cell.robot.joint_limits is None else "robot.joint_limits"
        places.append((f"{stated} of sliding joints", float(chain.travel.max()), LONGEST_TRAVEL))
    frames = cell.frames
    if frames.tracker is not None:
        places.append(("frames.tracker.xyz", _size(frames.tracker.xyz), FARTHEST_TRACKER))
    if frames.force_torque is not None:
        places.append(("frames.force_torque.xyz", _size(frames.force_torque.xyz), LARGEST_TOOL))
    if frames.wrench_point is not None:
        places.append(("frames.wrench_point", _size(frames.wrench_point), LARGEST_TOOL))
    far = max((_size(point) for point in frames.measurement_points.values()), default=0.0)
    places.append(("frames.measurement_points", far, LARGEST_TOOL))
    wrong = [(name, size, most) for name, size, most in places if size > most]
    if not wrong:
        return []
    seen = "; ".join(f"{name}: {size:,.4g} m, at most {most:g} m is plausible" for name, size, most in wrong)
    names = ", ".join(name for name, _, _ in wrong)
    text = f"lengths of the cell file look like millimetres ({seen})"
    remedy = f"give lengths of the cell file in m: multiply {names} by 0.001"
    return [InputAnomaly("position_unit", text, remedy, max(size for _, size, _ in wrong), unit="m", factor=1e-3,
                         place="cell")]  # fmt: skip


def _size(xyz: tuple[float, ...]) -> float:
    return float(np.linalg.norm(xyz))
