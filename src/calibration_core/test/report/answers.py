"""Hand-made answers, realistic in size and shape, from which reports are made in these tests."""

from __future__ import annotations

import dataclasses
import datetime as dt
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.result.estimate import (
    Anomaly,
    Exclusion,
    Fit,
    Identification,
    JointStiffness,
    NoiseAudit,
    NoiseCheck,
    OperatingSpace,
    ParameterEstimate,
    Precondition,
    Residuals,
    Stage,
    Unidentified,
)
from calibration_core.identification.result.tested import TestPart, TestResult
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Note, Provenance, Readings

DAY = dt.date(2026, 3, 5)
SIX = (
    (0.35, -np.pi / 2, 0.675),
    (1.35, 0.0, 0.0),
    (0.041, -np.pi / 2, 0.0),
    (0.0, np.pi / 2, 1.4),
    (0.0, -np.pi / 2, 0.0),
    (0.0, 0.0, 0.215),
)
SEVEN = (
    (0.0, -np.pi / 2, 0.35),
    (0.0, np.pi / 2, 0.0),
    (0.045, -np.pi / 2, 0.55),
    (-0.045, np.pi / 2, 0.0),
    (0.0, -np.pi / 2, 0.3),
    (0.0, np.pi / 2, 0.0),
    (0.0, 0.0, 0.06),
)
STIFFNESS = np.array([1.41e6, 1.83e6, 1.62e6, 4.2e5, 3.9e5, 2.1e5])
HOSTILE = (
    "</script><script>alert(1)</script> #set page(width: 1cm) $x^2$ \\u{41} *b* _i_ `r` \"q\" 'a' <b>&amp; {{7*7}} "
    "\U0001f916"
)


def frames(rows: tuple[tuple[float, float, float], ...], q: np.ndarray) -> np.ndarray:
    """(n + 1, 4, 4) frames of a standard DH chain, the base first."""
    pose, out = np.eye(4), [np.eye(4)]
    for (a, alpha, d), angle in zip(rows, q, strict=True):
        c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
        pose = pose @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
        out.append(pose)
    return np.array(out)


def make_cell(name: str, joints: tuple[str, ...], points: tuple[str, ...], loaded: bool, equipment: str = "") -> Cell:
    rows = SIX if len(joints) == 6 else SEVEN
    corners = {p: (0.2 * np.cos(2.1 * i), 0.2 * np.sin(2.1 * i), 0.12) for i, p in enumerate(points)}
    tracker: dict[str, object] = {"sigma": 2.0e-5}
    if equipment:
        tracker |= {"name": equipment, "serial": "750 123", "calibrated": "2026-02-11"}
    return Cell.model_validate(
        {
            "name": name,
            "robot": {
                "name": name,
                "joints": joints,
                "rated_load": 240.0,
                "dh": [{"a": a, "alpha": alpha, "d": d} for a, alpha, d in rows],
                "joint_limits": [(-3.0, 3.0)] * len(joints),
                "stiffness": list(STIFFNESS * 1.1) if loaded else None,
            },
            "frames": {"measurement_points": corners, "wrench_point": (0.0, 0.0, 0.18) if loaded else None},
            "instruments": {
                "tracker": tracker,
                "force_torque": {"sigma_force": 1.0, "sigma_torque": 0.5} if loaded else None,
            },
            "path": Path("cells/demo.cell.yaml"),
            "sha256": "c" * 64,
        }
    )


def space_of(
    rows: tuple[tuple[float, float, float], ...], q: np.ndarray, cell: Cell, loaded: bool, rng: np.random.Generator
) -> OperatingSpace:
    chains = np.array([frames(rows, row) for row in q])
    origins = np.concatenate([np.zeros((len(q), 1, 3)), chains[:, :, :3, 3]], axis=1)
    flange = chains[:, -1]
    points = {
        name: flange[:, :3, 3] + flange[:, :3, :3] @ np.array(p) for name, p in cell.frames.measurement_points.items()
    }
    force = rng.normal(size=(len(q), 3))
    force *= 2400 / np.linalg.norm(force, axis=1, keepdims=True)
    return OperatingSpace(
        configuration=np.arange(1, len(q) + 1),
        joint_origins=origins,
        flange=flange[:, :3, 3],
        points=points,
        wrench_point=flange[:, :3, 3] + 0.18 * flange[:, :3, 2] if loaded else None,
        force=force if loaded else None,
        deflection=force * 1.1e-6 + rng.normal(size=force.shape) * 3e-4 if loaded else None,
        q=q,
        singularity=rng.uniform(0.05, 0.3, len(q)),
        k_csm_share=rng.uniform(1e-7, 6e-6, len(q)) if loaded else None,
    )


def residuals_of(
    readings: Readings, deflection: np.ndarray, sigma: float, rng: np.random.Generator, excluded: tuple[int, ...] = ()
) -> Residuals:
    noise = rng.normal(scale=sigma, size=deflection.shape)
    flags = np.zeros(len(readings), dtype=bool)
    flags[list(excluded)] = True
    noise[flags] += 9 * sigma
    load = np.zeros(len(readings)) if readings.wrench is None else np.linalg.norm(readings.wrench[:, :3], axis=1)
    return Residuals(
        measured=deflection + noise,
        predicted=deflection,
        residual=noise,
        held_out=noise * 1.06,
        sigma=np.full(deflection.shape, sigma),
        load=load,
        excluded=flags,
    )


def make_loaded(cell: Cell, configurations: int = 18, steps: int = 9, seed: int = 1) -> Identification:
    rng = np.random.default_rng(seed)
    joints, points = cell.robot.joints, cell.points
    n = len(joints)
    q = rng.uniform(-1.1, 1.1, (configurations, n)) + np.array([0, -1.0, 1.2, 0, 0.8, 0])
    space = space_of(SIX, q, cell, True, rng)
    rows = configurations * steps * len(points)
    configuration = np.repeat(np.arange(configurations), steps * len(points))
    step = np.tile(np.repeat(np.arange(steps), len(points)), configurations)
    share = np.array([0, 1, 2, 3, 4, 3, 2, 1, 0])[step % 9] / 4
    wrench = np.hstack([space.force[configuration] * share[:, None], np.zeros((rows, 3))])
    readings = Readings(
        points=points,
        configuration=configuration + 1,
        step=step,
        point=np.tile(np.arange(len(points)), configurations * steps),
        q=q[configuration],
        position=rng.normal(size=(rows, 3)),
        wrench=wrench,
        time=np.arange(rows, dtype=float),
        temperature=20.4 + 0.3 * np.sin(np.arange(rows) / 80),
        provenance=Provenance(
            "bags/demo",
            "mcap",
            {"demo_0.mcap": "a" * 64, "metadata.yaml": "b" * 64},
            {"/joint_states": 81000, "/tracker/mp1": 16200},
            "2026-03-02T09:14:05Z",
        ),
    )
    relative = np.array([0.008, 0.011, 0.009, 0.021, 0.018, 0.031])
    compliance = 1 / STIFFNESS
    std = compliance * relative
    mixing = np.eye(n) + 0.3 * np.eye(n, k=1) + 0.15 * rng.normal(size=(n, n))
    correlation = mixing @ mixing.T
    scale = np.sqrt(np.diag(correlation))
    covariance = correlation / np.outer(scale, scale) * np.outer(std, std)
    stiffness = tuple(
        JointStiffness(joint, k, k * r, (k / (1 + 1.96 * r), k / (1 - 1.96 * r)), 1 / k, r / k, True)
        for joint, k, r in zip(joints, STIFFNESS, relative, strict=True)
    )
    excluded = (40, 171, 333) if rows > 400 else (5,)
    exclusions = tuple(
        Exclusion(
            int(readings.configuration[i]),
            int(readings.step[i]),
            points[readings.point[i]],
            "its residual is beyond what the noise of the others allows",
            2.1e-4,
            9.3,
        )
        for i in excluded
    )
    return Identification(
        kind="loaded",
        method="equilibrium on the deformed geometry, point deflections, instrument weights, robust",
        readings=readings,
        stiffness=stiffness,
        parameters=(),
        names=tuple(f"C {joint}" for joint in joints),
        covariance=covariance,
        condition_number=8.42,
        fit=Fit(5.1e-5, 2.03e-5, 5.3e-5, 2.09e-5, 2.0e-5, 3.3e-5, 8.1e-5),
        noise=NoiseAudit(
            2.0e-5,
            (
                NoiseCheck("rigid triangle", 2.02e-5, 486),
                NoiseCheck("zero return", 1.94e-5, 162),
                NoiseCheck("residual", 2.03e-5, 1272),
            ),
            1.0,
            False,
            "The readings scatter as the instruments claim.",
        ),
        stages=(),
        unidentified=(),
        exclusions=exclusions,
        anomalies=(
            Anomaly(
                "outlier_readings",
                {"point": points[0]},
                None,
                2.1e-4,
                "m",
                "3 readings lie further from the model than noise allows.",
            ),
        ),
        preconditions=(
            Precondition("5.1", "at least 12 configurations", f"{configurations} configurations", True),
            Precondition(
                "5.1", "load at most 100 % of the rated load (240 kg, 2354 N)", "largest force 2400 N, 102 %", False
            ),
            Precondition("5.1", "temperature 20 ± 2 °C", "20.1 to 20.7 °C", True),
            Precondition("5.1", "speed at most 250 mm/s in manual mode", "averaged readings do not show speed", None),
            Precondition(
                "5.3", "test uncertainty ratio not lower than 1:5", "median deflection 412 µm to 20 µm: 1:21", True
            ),
            Precondition("6.2", "far from singularities, K_CSM negligible", "largest share of K_CSM 5.9 µm", True),
        ),
        residuals=residuals_of(
            readings, wrench[:, :3] * 1.1e-6 * rng.uniform(0.4, 1.6, (rows, 1)), 2.0e-5, rng, excluded
        ),
        space=space,
        model=ModelParameters(joints, compliance, np.zeros((n, 6)), np.eye(4), cell.frames.measurement_points),
        test=TestResult(
            "bags/demo_2",
            162,
            2.2e-5,
            3.4e-5,
            8.8e-5,
            5.6e-5,
            9.1e-5,
            {"demo_2_0.mcap": "f" * 64},
            (
                TestPart("loaded", 6, 162, 2.2e-5, 3.4e-5, 8.8e-5, 5.6e-5, 9.1e-5),
                TestPart.without_figures("at_rest", 2, 6, "too few to fit the tracker"),
            ),
            "postures at rest: too few to fit the tracker",
        ),
        notes=(Note("gap", "/tracker/mp1", "one gap of 0.8 s between samples", 1),),
    )


def make_absolute(cell: Cell, configurations: int = 216, seed: int = 2) -> Identification:
    rng = np.random.default_rng(seed)
    joints = cell.robot.joints
    n = len(joints)
    q = rng.uniform(-1.4, 1.4, (configurations, n))
    space = space_of(SEVEN, q, cell, False, rng)
    point = cell.points[0]
    readings = Readings(
        points=(point,),
        configuration=np.arange(1, configurations + 1),
        step=np.zeros(configurations, dtype=int),
        point=np.zeros(configurations, dtype=int),
        q=q,
        position=space.points[point],
        wrench=None,
        time=np.full(configurations, np.nan),
        temperature=np.full(configurations, np.nan),
        provenance=Provenance("wam_grid.csv", "csv", {"wam_grid.csv": "d" * 64}, {"rows": configurations}),
    )
    groups = ("tracker", "point", "geometry")
    names = [f"tracker {a}" for a in ("x", "y", "z", "rx", "ry", "rz")] + [f"{point} {a}" for a in "xyz"]
    names += [f"{kind}_{i + 1}" for i in range(n) for kind in ("a", "alpha", "d", "theta")]
    fitted = [not name.startswith(("a_7", "d_1")) for name in names]
    parameters = tuple(
        ParameterEstimate(
            name,
            groups[min(2, (i >= 6) + (i >= 9))],
            rng.normal(scale=2e-3),
            1.1e-4 * (1 + i % 3),
            "rad" if any(k in name for k in (" r", "alpha", "theta")) else "m",
            0.0 if i > 5 else None,
            ok,
        )
        for i, (name, ok) in enumerate(zip(names, fitted, strict=True))
    )
    free = tuple(name for name, ok in zip(names, fitted, strict=True) if ok)
    covariance = np.eye(len(free)) * 1e-8
    covariance[0, 6] = covariance[6, 0] = 0.97e-8
    return Identification(
        kind="absolute",
        method="frames, then geometry, instrument weights",
        readings=readings,
        stiffness=(),
        parameters=parameters,
        names=free,
        covariance=covariance,
        condition_number=214.0,
        fit=Fit(9.8e-3, 1.71e-3, 9.9e-3, 1.86e-3, 2.0e-5, 2.7e-3, 7.7e-3),
        noise=NoiseAudit(
            2.0e-5,
            (NoiseCheck("residual", 1.78e-3, 610),),
            89.0,
            True,
            "The claimed 20 µm is too small for this recording: the residuals show 1.78 mm.",
        ),
        stages=(
            Stage("nominal", 0, 17.6e-3, 17.6e-3, True, "the cell file as it stands"),
            Stage("frames", 9, 4.05e-3, 4.12e-3, True, "held-out rms falls from 17.6 to 4.12 mm"),
            Stage("geometry", 35, 2.96e-3, 3.22e-3, True, "held-out rms falls from 4.12 to 3.22 mm"),
            Stage("elasticity", 42, 2.81e-3, 3.24e-3, False, "held-out rms does not fall (3.22 to 3.24 mm)"),
        ),
        unidentified=(Unidentified({"d_1": 1.0, "tracker z": -1.0}, "both move the point along the same axis"),),
        exclusions=(),
        anomalies=(Anomaly("noise_understated", {}, None, 1.78e-3, "m", "Noise is understated by a factor 89."),),
        preconditions=(
            Precondition("5.1", "at least 12 configurations", "216", True),
            Precondition("5.1", "temperature 20 ± 2 °C", "no temperature recorded", None),
        ),
        residuals=residuals_of(readings, space.points[point], 1.7e-3, rng),
        space=space,
        model=ModelParameters(joints, np.zeros(n), np.zeros((n, 6)), np.eye(4), cell.frames.measurement_points),
    )


def make_hostile() -> tuple[Identification, Cell]:
    joints = tuple(f"{HOSTILE} {i}" for i in range(6))
    cell = make_cell(HOSTILE, joints, (HOSTILE + " 1", "= 2 <&>", "x" * 300), True, HOSTILE)
    answer = make_loaded(cell, configurations=12, steps=3, seed=3)
    readings = dataclasses.replace(
        answer.readings,
        provenance=dataclasses.replace(
            answer.readings.provenance, path=HOSTILE, start=HOSTILE, sha256={HOSTILE: "e" * 64}
        ),
    )
    broken = dataclasses.replace(
        answer.stiffness[5],
        value=np.inf,
        std=np.inf,
        interval=(4e4, np.inf),
        compliance=0.0,
        identifiable=False,
        reason=HOSTILE,
    )
    covariance = np.array(answer.covariance)
    covariance[5] = covariance[:, 5] = np.nan
    return dataclasses.replace(
        answer,
        readings=readings,
        stiffness=(*answer.stiffness[:5], broken),
        covariance=covariance,
        method=HOSTILE,
        exclusions=(Exclusion(1, 0, HOSTILE, HOSTILE, np.nan, np.inf),),
        condition_number=np.inf,
        unidentified=(Unidentified({HOSTILE: 1.0}, HOSTILE),),
        notes=(Note(HOSTILE, HOSTILE, HOSTILE + "\x00\ud800\n"),),
        preconditions=(Precondition(HOSTILE, HOSTILE, HOSTILE, None),),
    ), cell
