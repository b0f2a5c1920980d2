"""A robot with a spring, a cylinder or a counterweight beside joint 2, in equations of its own: nothing of the model's.

Positions are what is left when every joint has given way under the weight of the arm, the help beside joint 2 and a
load at the flange, at the angles where they come to rest.  Lengths, masses and stiffnesses are those of robots of 60,
200 and 500 kg.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from calibration_core.cell import Cell
from calibration_core.diagnosis.result.finding import Diagnosis, Finding
from calibration_core.timeseries import Provenance, Readings

GRAVITY = np.array([0, 0, -9.80665])
SIZES = {60: (0.85, 0.30, 0.30), 200: (1.0, 1.0, 1.0), 500: (1.25, 2.3, 2.6)}  # of lengths, masses and stiffnesses
ROWS = np.array([  # a, alpha, d, theta
    [0.35, -np.pi / 2, 0.675, 0], [1.15, 0, 0, -np.pi / 2], [0.05, -np.pi / 2, 0, 0],
    [0, np.pi / 2, 1.05, 0], [0, -np.pi / 2, 0, 0], [0, 0, 0.24, 0],
])  # fmt: skip
MASS = np.array([350.0, 230, 240, 70, 40, 60])
CENTRE = np.array(
    [[-0.1, 0.15, 0.05], [-0.55, 0.02, -0.12], [0, 0.05, 0.12], [0, -0.35, 0.02], [0, 0.02, 0.05], [0.01, 0, 0.03]]
)
STIFFNESS = np.array([2.2e6, 2.4e6, 2.0e6, 4.5e5, 4.0e5, 3.5e5])
LOW, HIGH = np.array([-2.6, -1.1, -1.0, -2.5, -1.9, -2.5]), np.array([2.6, 1.1, 1.1, 2.5, 1.9, 2.5])
POINTS = np.array([[0.17, 0, 0.12], [-0.09, 0.15, 0.12], [-0.09, -0.15, 0.18]])
TRACKER = np.array([4.0, 1.0, 1.2, 0, 0, -2.9])
HELPED = 1
KINDS = ("gas", "coil", "hydraulic", "counterweight", "torsion")
LONGEST = 2.1  # times the shortest: what a cylinder can be
SHARE = (0.3, 0.8)  # of the largest torque of the weight that the help carries
USUAL = 3e-4  # rad, amplitude of a gear of a robot of 10 kg; half of it for one of 240 kg
PULLS = (0.0, 0.35, 0.7, 1.0)  # of the rated load
SOFTER = 0.8  # by how much of its compliance joint 2 is softer at rest than under
SOFT_TORQUE = 9.0  # N*m per kg of rated load
SENSOR = (1.0, 1.0, 1.0, 0.5, 0.5, 0.5)  # N and N*m, noise of the force/torque sensor

LOADS = tuple(SIZES)  # kg
SPRING, GEAR = ("gravity_compensator", "joint_2"), ("transmission_error", "joint_2")

Law = Callable[[float], float]
Extra = tuple[tuple[int, float, np.ndarray], ...]


@dataclasses.dataclass(frozen=True)
class Plant:
    """What is beside joint 2, and what else is wrong there.

    Attributes:
        seed: Of everything that is drawn.
        kind: One of `KINDS`; empty: nothing helps the joint.
        rated: kg.
        waves: Order and amplitude, in usual ones, of the gear of joint 2.
        zero: Largest zero offset of joint 2, rad; at least a fifth of it is there.
        slope: rad, by which the floor leans, in a direction that is drawn.
        hose: Joint (index) that winds up a hose, and the power of its law; None: none does.
        geometry: Whether lengths and angles differ from the cell file.
        loaded: How many of the configurations are loaded, too, in steps.
        soft: Whether joint 2 is softer at small torques.
    """

    seed: int
    kind: str = ""
    rated: int = 200
    waves: tuple[tuple[int, float], ...] = ()
    zero: float = 0.0
    slope: float = 0.0
    hose: tuple[int, int] | None = None
    geometry: bool = False
    loaded: int = 0
    soft: bool = False


def of_every_kind(first: int, loaded: tuple[int, ...] = (0,)) -> list[Plant]:
    """Return two robots of every size with a spring of every kind, seeds from `first` on, loads in turn."""
    several = itertools.product(KINDS, LOADS, range(2))
    return [
        Plant(first + k, kind, rated, geometry=bool(k % 2), loaded=loaded[k % len(loaded)])
        for k, (kind, rated, _) in enumerate(several)
    ]


def place(finding: Finding) -> tuple[str, str]:
    """Return effect and place of a finding."""
    return finding.effect, str(*finding.location.values())


def named(found: Diagnosis) -> set[tuple[str, str]]:
    """Return effects and places of all findings."""
    return {place(finding) for finding in found.findings}


def springs_are_named(several: list[Diagnosis]) -> bool:
    """Say whether nine tenths name the spring of joint 2, and no more than a tenth its gear."""
    springs, gears = (sum(one in named(found) for found in several) for one in (SPRING, GEAR))
    return springs >= 0.9 * len(several) and gears <= 0.1 * len(several)


@dataclasses.dataclass(frozen=True)
class Arm:
    """The true robot.

    Attributes:
        rows: (6, 4) a, alpha, d, theta.
        stiffness: (6,) N*m/rad.
        bodies: Link, mass and centre in its frame.
        law: Torque beside a joint at its angle, N*m.
        helped: That joint (index).
        gravity: (3,) m/s^2, base axes.
        soft: N*m, of total torque at joint 2 below which it is softer; 0: it is not.
    """

    rows: np.ndarray
    stiffness: np.ndarray
    bodies: Extra
    law: Law
    helped: int
    gravity: np.ndarray
    soft: float

    def at_rest(self, begun: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return the flange where the joints come to rest under weight and a force at the flange, base axes, N."""
        angles = begun
        for _ in range(60):
            frames = _frames(self.rows, angles)
            torque = _weight(self.rows, self.bodies, angles, self.gravity)
            for joint in range(6):
                torque[joint] += np.cross(frames[joint][:3, 2], frames[6][:3, 3] - frames[joint][:3, 3]) @ force
            torque[self.helped] += self.law(float(angles[self.helped]))
            new = begun + torque / self.stiffness
            if self.soft:
                more = SOFTER * self.soft * np.tanh(torque[HELPED] / self.soft)
                new[HELPED] += more / self.stiffness[HELPED]
            if np.abs(new - angles).max() < 1e-12:
                break
            angles = new
        return _frames(self.rows, angles)[6]


def recorded(plant: Plant) -> tuple[Cell, Readings]:
    """Return the cell file's robot and what a tracker and a sensor at the flange see of the true one."""
    rng = np.random.default_rng(plant.seed)
    length, heavy, stiff = SIZES[plant.rated]
    rows, stiffness = ROWS * [length, 1, length, 1], STIFFNESS * stiff
    stated, noise, share = stiffness * (1 + rng.normal(0, 0.05, 6)), rng.uniform(10e-6, 30e-6), rng.uniform(*SHARE)
    true, zero = rows.copy(), np.zeros(6)
    if plant.geometry:
        true += rng.normal(0, 1, (6, 4)) * [1e-4, 5e-5, 1e-4, 5e-5]
    zero[HELPED] = plant.zero * rng.choice([-1, 1]) * rng.uniform(0.2, 1)
    q = _postures(rng, rows, int(rng.integers(40, 121)), length)
    law, extra = _help(plant.kind, rng, rows, q, share, length, heavy)
    phases = [(order, size * _usual(plant.rated), rng.uniform(0, 2 * np.pi)) for order, size in plant.waves]
    points = POINTS * length + rng.normal(0, 2e-4, (3, 3))
    soft = SOFT_TORQUE * plant.rated * plant.soft
    helped, gravity = HELPED, GRAVITY
    if plant.hose is not None:
        helped, power = plant.hose
        law = _hose(
            power, rng, q[:, helped], 0.05 * max(abs(_weight(rows, _arm(heavy, length), one)[HELPED]) for one in q)
        )
    if plant.slope:
        way = rng.uniform(0, 2 * np.pi)
        gravity = Rotation.from_rotvec(plant.slope * np.array([np.cos(way), np.sin(way), 0])).apply(GRAVITY)
    arm = Arm(true, stiffness, (*_arm(heavy, length), *extra), law, helped, gravity, soft)
    positions, wrenches, steps, configurations = [], [], [], []
    for number, one in enumerate(q):
        begun = one + zero
        begun[HELPED] += sum(size * np.sin(order * one[HELPED] + phase) for order, size, phase in phases)
        pulls = PULLS if number < plant.loaded else PULLS[:1]
        along = rng.normal(size=3) if number < plant.loaded else GRAVITY
        for step, pull in enumerate(pulls):
            force = pull * plant.rated * np.linalg.norm(GRAVITY) * along / np.linalg.norm(along)
            flange = arm.at_rest(begun, force)
            positions.append(points @ flange[:3, :3].T + flange[:3, 3])
            wrenches.append(np.concatenate([flange[:3, :3].T @ force, np.zeros(3)]))
            steps.append(step)
            configurations.append(number)
    pose = TRACKER + np.concatenate([rng.normal(0, 2e-3, 3), rng.normal(0, 1e-4, 3)])
    turn = Rotation.from_euler("xyz", pose[3:]).as_matrix()
    seen = (np.concatenate(positions) - pose[:3]) @ turn
    seen += rng.normal(0, noise, seen.shape)
    cell = _cell(plant, rows, heavy, length, stated, noise)
    wrench = np.array(wrenches) + rng.normal(0, SENSOR, (len(steps), 6)) if plant.loaded else None
    return cell, _readings(cell, q, np.array(configurations), np.array(steps), seen, wrench)


def _usual(rated: int) -> float:
    return float(USUAL * 0.5 ** min(1, np.log(rated / 10) / np.log(24)))


def _frames(rows: np.ndarray, q: np.ndarray) -> list[np.ndarray]:
    frames = [np.eye(4)]
    for (a, alpha, d, theta), angle in zip(rows, q, strict=True):
        c, s, ca, sa = np.cos(theta + angle), np.sin(theta + angle), np.cos(alpha), np.sin(alpha)
        step = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        frames.append(frames[-1] @ np.array(step))
    return frames


def _weight(rows: np.ndarray, bodies: Extra, q: np.ndarray, gravity: np.ndarray = GRAVITY) -> np.ndarray:
    """Return the torques of the weight of bodies (link, mass, centre in its frame) about all joints, (6,) N*m."""
    frames, torque = _frames(rows, q), np.zeros(6)
    for link, mass, centre in bodies:
        at = frames[link + 1][:3, :3] @ centre + frames[link + 1][:3, 3]
        for joint in range(link + 1):
            torque[joint] += np.cross(frames[joint][:3, 2], at - frames[joint][:3, 3]) @ (mass * gravity)
    return torque


def _arm(heavy: float, length: float) -> Extra:
    return tuple((i, mass * heavy, centre * length) for i, (mass, centre) in enumerate(zip(MASS, CENTRE, strict=True)))


def _postures(rng: np.random.Generator, rows: np.ndarray, count: int, length: float) -> np.ndarray:
    found: list[np.ndarray] = []
    while len(found) < count:
        one = rng.uniform(LOW, HIGH)
        flange, wrist = _frames(rows, one)[6], _frames(rows, one)[4]
        if min(flange[2, 3], wrist[2, 3]) > 0.3 * length and np.hypot(*flange[:2, 3]) > 0.6 * length:
            found.append(one)
    return np.array(found)


def _help(
    kind: str, rng: np.random.Generator, rows: np.ndarray, q: np.ndarray, share: float, length: float, heavy: float
) -> tuple[Law, Extra]:
    """Return the torque of a spring at the angle of joint 2, N*m, and the bodies that hang on it."""
    if not kind:
        return (lambda _: 0.0), ()
    largest = max(abs(_weight(rows, _arm(heavy, length), one)[HELPED]) for one in q)
    if kind == "counterweight":
        centre = np.array([-1.55, rng.uniform(-0.1, 0.1), 0.3]) * length
        unit = max(abs(_weight(rows, ((HELPED, 1.0, centre),), one)[HELPED]) for one in q)
        return (lambda _: 0.0), ((HELPED, share * largest / unit, centre),)
    law = _spring(kind, rng, length)
    scale = share * largest / max(abs(law(angle)) for angle in q[:, HELPED])
    return (lambda angle: scale * law(angle)), ()


def _hose(power: int, rng: np.random.Generator, q: np.ndarray, torque: float) -> Law:
    """Return the torque of a hose that winds up with a joint, evenly or ever stiffer, `torque` N*m where it is most."""
    free, most = rng.uniform(-0.5, 0.5), float(np.abs(q).max())

    def law(angle: float) -> float:
        wound = (angle - free) / most
        return -torque * (wound if power == 1 else 0.4 * wound + 0.6 * wound**power)

    return law


def _spring(kind: str, rng: np.random.Generator, length: float) -> Law:
    """Return the torque of a spring between the base and the arm, in units of its own."""
    if kind == "torsion":
        free = rng.uniform(-0.3, 0.3)
        return lambda angle: free - angle
    force = _force(kind, rng)
    angles = np.linspace(LOW[HELPED] - 0.1, HIGH[HELPED] + 0.1, 400)
    while True:
        base, lever, middle = length * rng.uniform(0.3, 0.55), length * rng.uniform(0.15, 0.45), rng.uniform(-0.1, 0.1)

        def distance(angle: np.ndarray) -> np.ndarray:
            return np.sqrt(base**2 + lever**2 - 2 * base * lever * np.cos(angle - middle))  # noqa: B023

        shortest, longest = distance(angles).min(), distance(angles).max()
        if longest <= LONGEST * shortest:
            break

    def torque(angle: float) -> float:
        now = float(distance(np.array(angle)))
        return float(-force((now - shortest) / (longest - shortest)) * base * lever * np.sin(angle - middle) / now)

    return torque


def _force(kind: str, rng: np.random.Generator) -> Law:
    """Return the force of a spring over the share of its stroke."""
    if kind == "gas":
        more = rng.uniform(0.2, 0.4)
        return lambda share: 1 + more * share
    if kind == "coil":
        first = rng.uniform(0.2, 0.8)
        return lambda share: first + (1 - first) * share
    power, taken = rng.uniform(1.2, 1.4), rng.uniform(0.3, 0.6)  # gas over oil: polytropic
    return lambda share: float((1 - taken * share) ** -power)


def _cell(plant: Plant, rows: np.ndarray, heavy: float, length: float, stated: np.ndarray, noise: float) -> Cell:
    names = [f"joint_{i + 1}" for i in range(6)]
    robot = {
        "name": f"robot of {plant.rated} kg", "rated_load": float(plant.rated),
        "joints": names, "stiffness": stated.tolist(),
        "dh": [dict(zip(("a", "alpha", "d", "theta"), map(float, row), strict=True)) for row in rows],
        "joint_limits": np.stack([LOW, HIGH], 1).tolist(),
        "inertials": [{"mass": mass, "com": centre.tolist()} for _, mass, centre in _arm(heavy, length)],
    }  # fmt: skip
    points = {f"mp{i + 1}": one.tolist() for i, one in enumerate(POINTS * length)}
    frames: dict[str, object] = {
        "tracker": {"xyz": TRACKER[:3].tolist(), "rpy": TRACKER[3:].tolist()}, "measurement_points": points,
    }  # fmt: skip
    instruments = {"tracker": {"sigma": noise}}
    if plant.loaded:
        frames |= {"force_torque": {"xyz": [0, 0, 0], "rpy": [0, 0, 0]}, "wrench_point": [0, 0, 0]}
        instruments["force_torque"] = {"sigma_force": SENSOR[0], "sigma_torque": SENSOR[3]}
    content = {"name": "spring", "robot": robot, "frames": frames, "instruments": instruments}
    return Cell.model_validate(content)


def _readings(
    cell: Cell, q: np.ndarray, configuration: np.ndarray, step: np.ndarray, seen: np.ndarray, wrench: np.ndarray | None
) -> Readings:
    k, plateaus = len(cell.points), len(step)
    return Readings(
        points=cell.points,
        configuration=np.repeat(configuration + 1, k),
        step=np.repeat(step, k),
        point=np.tile(np.arange(k), plateaus),
        q=np.repeat(q[configuration], k, axis=0),
        position=seen,
        wrench=None if wrench is None else np.repeat(wrench, k, axis=0),
        time=np.repeat(60.0 * np.arange(plateaus), k) + np.tile(5.0 * np.arange(k), plateaus),
        temperature=np.full(k * plateaus, np.nan),
        provenance=Provenance("plant", "csv", {}, {}),
    )
