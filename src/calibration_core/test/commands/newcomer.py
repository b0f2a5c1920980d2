"""What a newcomer has: the URDF of a robot that is in no library, and a table that other software exported."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

STIFFNESS = (4.1e5, 6.3e5, 3.7e5, 8.2e4, 7.1e4, 4.4e4)
OPTIONS = (
    "--rated-load", "25", "--sensor", "0", "0", "0.045", "0", "0", "0.4", "--wrench-point", "0.05", "0.02", "0.16",
    "--point", "A1=0.12,0,0.06", "--point", "A2=-0.07,0.1,0.06", "--point", "A3=-0.07,-0.1,0.11",
    "--tracker", "3.1", "-0.8", "0.9", "0", "0", "2.7", "--tracker-sigma", "1.5e-5", "--force-sigma", "0.2",
    "--torque-sigma", "0.05",
)  # fmt: skip
LENGTHS = ("0 0 0.42", "0.16 0 0.02", "0 0 0.71", "0.1 0 0.13", "0.62 0 0", "0.11 0 0")
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
MASSES = (52.0, 31.0, 26.0, 9.0, 4.0, 0.8)


def robot() -> str:
    """Return a URDF, with the meshes that nobody handed on left out."""
    parts = ['<?xml version="1.0"?>', '<robot name="rb25">', '<link name="base_link"/>']
    for i, mass in enumerate(MASSES, 1):
        parts.append(
            f'<link name="l{i}"><inertial><origin xyz="0.03 0 0.08"/><mass value="{mass}"/></inertial>'
            f'<visual><geometry><mesh filename="package://rb25/meshes/l{i}.stl"/></geometry></visual></link>'
        )
    parts.append('<link name="tool0"/>')
    for i, (xyz, axis) in enumerate(zip(LENGTHS, AXES, strict=True), 1):
        parent = "base_link" if i == 1 else f"l{i - 1}"
        parts.append(
            f'<joint name="axis_{i}" type="revolute"><parent link="{parent}"/><child link="l{i}"/>'
            f'<origin xyz="{xyz}"/><axis xyz="{axis}"/><limit lower="-2.6" upper="2.6"/></joint>'
        )
    parts.append(
        '<joint name="end" type="fixed"><parent link="l6"/><child link="tool0"/>'
        '<origin xyz="0.02 0 0" rpy="0 1.5707963 0"/></joint></robot>'
    )
    return "\n".join(parts)


def exported(folder: Path, cell: Path, simulate: Callable[[Path, Path, Path], None]) -> Path:
    """Return a table as tracker software exports it: mm, degrees, semicolons, decimal commas, names of its own.

    Args:
        folder: Where to.
        cell: The newcomer's cell file; the truth behind the table is stiffer or softer than anybody knows.
        simulate: Writes the recording of a cell file and a plan into a folder.
    """
    truth = cell.with_name("truth.yaml")
    row = ", ".join(f"{value:g}" for value in STIFFNESS)
    truth.write_text(cell.read_text().replace("  # stiffness: [1.0e+6, ...]", f"  stiffness: [{row}]"))
    rng = np.random.default_rng(3)
    plan = ["schema: 1", "configurations:"]
    for number in range(1, 15):
        q = ", ".join(f"{x:.3f}" for x in rng.uniform(-1.1, 1.1, 6))
        pull = rng.normal(size=3)
        pull *= 230.0 / np.linalg.norm(pull)
        steps = [[*(share * pull).round(2).tolist(), 0, 0, 0] for share in (0.0, 0.5, 1.0, 0.5)]
        plan.append(f"  - {{number: {number}, q: [{q}], steps: {json.dumps(steps)}}}")
    (folder / "plan.yaml").write_text("\n".join(plan) + "\n")
    simulate(truth, folder / "plan.yaml", folder / "truth")
    lines = (folder / "truth" / "measurements.csv").read_text().splitlines()
    names = lines[0].split(",")
    out = ["Pose;Step;Target;X [mm];Y [mm];Z [mm];" + ";".join(f"A{i} [deg]" for i in range(1, 7))]
    out[0] += ";Fx [N];Fy [N];Fz [N];Tx [Nm];Ty [Nm];Tz [Nm]"
    for line in lines[1:]:
        value = dict(zip(names, line.split(","), strict=True))
        cells = [value["configuration"], value["step"], value["point"]]
        cells += [f"{1e3 * float(value[axis]):.5f}" for axis in "xyz"]
        cells += [f"{np.degrees(float(value[f'q{i}'])):.8f}" for i in range(1, 7)]
        cells += [f"{float(value[name]):.4f}" for name in ("fx", "fy", "fz", "tx", "ty", "tz")]
        out.append(";".join(cell.replace(".", ",") for cell in cells))
    path = folder / "export.txt"
    path.write_text("\n".join(out) + "\n", encoding="utf-8")
    truth.unlink()
    return path


def found(folder: Path) -> list[float]:
    """Return how many standard deviations each identified stiffness is from the truth."""
    joints = json.loads((folder / "result.json").read_text())["stiffness"]
    return [(one["value"] - true) / one["std"] for one, true in zip(joints, STIFFNESS, strict=True)]
