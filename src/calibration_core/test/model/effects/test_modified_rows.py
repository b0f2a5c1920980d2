"""A robot in modified DH rows and the same robot as a URDF: each joint has the same frame, and all effects are alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import load_cell
from calibration_core.model.chain import rotation_x, rotation_z, rpy_of
from calibration_core.model.effects import candidates
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State, state_of
from calibration_core.model.robot import chain_of

# a, alpha, d, theta of the rows before each joint, mass and centre of gravity in the joint's frame: a 60 kg class
ROWS = (
    (0.0, 0.0, 0.82, 0.0, 170.0, (0.08, 0.02, -0.12)),
    (0.33, -1.5707963267948966, 0.0, -1.5707963267948966, 95.0, (0.41, 0.0, -0.1)),
    (0.88, 0.0, 0.0, 0.0, 78.0, (0.09, 0.06, 0.03)),
    (0.14, -1.5707963267948966, 0.83, 0.0, 34.0, (0.0, -0.02, -0.3)),
    (0.0, 1.5707963267948966, 0.0, 0.0, 14.0, (0.0, -0.02, 0.0)),
    (0.0, -1.5707963267948966, 0.17, 0.0, 3.0, (0.0, 0.0, -0.03)),
)
JOINTS = [f"joint_{i + 1}" for i in range(len(ROWS))]
REST = """
frames: {measurement_points: {mp1: [0.1, 0, 0]}}
instruments: {tracker: {sigma: 1.0e-5}}
"""
M = 12


def numbers(values: object) -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values))


def as_rows(folder: Path) -> Path:
    rows = ", ".join(f"{{a: {a}, alpha: {alpha}, d: {d}, theta: {theta}}}" for a, alpha, d, theta, _, _ in ROWS)
    masses = ", ".join(f"{{mass: {mass}, com: {list(com)}}}" for *_, mass, com in ROWS)
    robot = (
        f"robot: {{name: r, dh: [{rows}], modified_dh: true, inertials: [{masses}], joints: {JOINTS}, "
        f"joint_limits: {[[-3.0, 3.0]] * len(ROWS)}, rated_load: 60}}"
    )
    path = folder / "rows.yaml"
    path.write_text(f"name: rows\n{robot}{REST}")
    return path


def as_urdf(folder: Path) -> Path:
    """Write what converters make of modified rows: the frame of a joint is the row's, d included."""
    parts, parent = ['<link name="base"/>'], "base"
    for name, (a, alpha, d, theta, mass, com) in zip(JOINTS, ROWS, strict=True):
        turn = rotation_x(alpha)
        place, angles = np.array([a, 0.0, 0.0]) + turn @ [0.0, 0.0, d], rpy_of(turn @ rotation_z(theta))
        child = f"{name}_link"
        parts.append(
            f'<link name="{child}"><inertial><origin xyz="{numbers(com)}"/><mass value="{mass}"/></inertial></link>'
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{numbers(place)}" rpy="{numbers(angles)}"/><axis xyz="0 0 1"/>'
            '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        )
        parent = child
    (folder / "robot.urdf").write_text(f'<robot name="r">{"".join(parts)}</robot>')
    path = folder / "urdf.yaml"
    robot = f"robot: {{name: r, urdf: robot.urdf, base_link: base, flange: {parent}, joints: {JOINTS}, rated_load: 60}}"
    path.write_text(f"name: urdf\n{robot}{REST}")
    return path


def at_rest(path: Path) -> State:
    chain = chain_of(load_cell(path))
    rng = np.random.default_rng(2)
    return state_of(
        chain, rng.uniform(-1.3, 1.3, (M, chain.n)), np.full(chain.n, 2e-6), None,
        np.tile([[0.1], [0.05], [0.12]], (1, M)), point_index=np.zeros(M, dtype=np.int64), wrench=None,
        configuration=np.arange(M), step=np.zeros(M, dtype=np.int64), time=np.arange(M) * 10.0,
        temperature=np.linspace(20.0, 26.0, M), tracker=np.eye(4), rated_load=60.0,
    )  # fmt: skip


# Not by the axes before the turn theta of a row, which modified rows state behind the frame, and a URDF before it.
ALIKE = {
    ("off_axis_compliance", "isotropic"): 6,
    ("off_axis_compliance", "behind"): 6,
    ("link_bending", "tube"): 4,
    ("link_bending", "bending and torsion"): 4,
    ("base_compliance", "rocking"): 1,
    ("thermal_growth", "one link"): 4,
}


@pytest.mark.parametrize(("effect", "variant"), ALIKE)
def test_modified_rows_and_their_urdf_give_the_same_effects(tmp_path: Path, effect: str, variant: str) -> None:
    def offered(state: State) -> list[Candidate]:
        return [c for c in candidates(state) if (c.effect, c.variant) == (effect, variant)]

    rows, urdf = at_rest(as_rows(tmp_path)), at_rest(as_urdf(tmp_path))
    both = list(zip(offered(rows), offered(urdf), strict=True))
    assert len(both) >= ALIKE[effect, variant]
    for one, other in both:
        assert one.place == other.place
        columns = one.columns(rows)
        np.testing.assert_allclose(columns, other.columns(urdf), rtol=0, atol=1e-9 * np.abs(columns).max())
