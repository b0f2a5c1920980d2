"""Reading robots: URDF, standard and modified DH; pinocchio as a witness."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.errors import CellError
from calibration_sim.cell.configurations import random_protocol
from calibration_sim.cell.protocol import Configuration, Protocol
from calibration_sim.cell.table import solve
from calibration_sim.cell.truth import nominal_truth
from calibration_sim.mechanics.chain import read_chain
from calibration_sim.mechanics.statics import Mechanism

Changed = Callable[..., Cell]


def _dh(row: dict[str, float], q: float, *, modified: bool) -> np.ndarray:
    """One DH row as the textbooks print it, element by element (Craig for modified)."""
    a, d = row["a"], row["d"]
    ca, sa = np.cos(row["alpha"]), np.sin(row["alpha"])
    ct, st = np.cos(row["theta"] + q), np.sin(row["theta"] + q)
    if modified:
        return np.array(
            [
                [ct, -st, 0, a],
                [st * ca, ct * ca, -sa, -sa * d],
                [st * sa, ct * sa, ca, ca * d],
                [0, 0, 0, 1],
            ]
        )
    return np.array([[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]])


def _random_dh(joints: int, seed: int) -> list[dict[str, float]]:
    rng = np.random.default_rng(seed)
    return [
        dict(zip(("a", "alpha", "d", "theta"), rng.uniform(-1.0, 1.0, 4).tolist(), strict=True)) for _ in range(joints)
    ]


def _dh_cell(changed: Changed, cell: Cell, rows: list[dict[str, float]], *, modified: bool = False) -> Cell:
    n = len(rows)
    rng = np.random.default_rng(n)
    return changed(
        cell,
        robot__dh=rows,
        robot__modified_dh=modified,
        robot__joints=[f"j{i}" for i in range(n)],
        robot__joint_limits=[[-3.0, 3.0]] * n,
        robot__inertials=[
            {"mass": float(m), "com": c.tolist()}
            for m, c in zip(rng.uniform(1, 9, n), rng.uniform(-0.3, 0.3, (n, 3)), strict=True)
        ],
        robot__stiffness=rng.uniform(1e4, 1e5, n).tolist(),
    )


@pytest.mark.parametrize("modified", [False, True])
@pytest.mark.parametrize("joints", [3, 6, 7])
def test_dh_kinematics_as_printed(changed: Changed, small: Cell, joints: int, modified: bool) -> None:
    rows = _random_dh(joints, joints)
    cell = _dh_cell(changed, small, rows, modified=modified)
    mechanism = Mechanism(read_chain(cell), cell.robot.stiffness, cell.gravity)
    rng = np.random.default_rng(1)
    for q in rng.uniform(-3, 3, (10, joints)):
        expected = np.linalg.multi_dot([_dh(row, x, modified=modified) for row, x in zip(rows, q, strict=True)])
        place = mechanism.forward(q)
        assert place.rotation == pytest.approx(expected[:3, :3], abs=1e-13)
        assert place.translation == pytest.approx(expected[:3, 3], abs=1e-13)


@pytest.mark.parametrize("modified", [False, True])
@pytest.mark.parametrize("joints", [3, 7])
def test_centres_of_gravity_stand_in_the_dh_frames(changed: Changed, small: Cell, joints: int, modified: bool) -> None:
    """Gravity torque = minus the slope of potential energy, computed from the printed DH matrices."""
    rows = _random_dh(joints, 10 + joints)
    cell = _dh_cell(changed, small, rows, modified=modified)
    mechanism = Mechanism(read_chain(cell), np.full(joints, 1e9), cell.gravity)
    q = np.random.default_rng(2).uniform(-2, 2, joints)

    def energy(angles: np.ndarray) -> float:
        frame, total = np.eye(4), 0.0
        for row, x, inertial in zip(rows, angles, cell.robot.inertials, strict=True):
            frame = frame @ _dh(row, x, modified=modified)
            total -= inertial.mass * cell.gravity @ (frame @ [*inertial.com, 1.0])[:3]
        return float(total)

    step = 1e-5 * np.eye(joints)
    slope = [(energy(q + s) - energy(q - s)) / 2e-5 for s in step]
    assert mechanism.equilibrium(q).torque == pytest.approx(slope, rel=1e-6, abs=1e-4)


def _urdf(cell: Cell) -> str:
    """Write a standard DH robot as URDF: joint i stands where frame i-1 ends, its link carries the weight."""
    text = ['<robot name="same"><link name="base"/>']
    before = {"a": 0.0, "alpha": 0.0, "d": 0.0, "theta": 0.0}
    parent = "base"
    inertials = cell.robot.inertials
    for i, name in enumerate(cell.robot.joints):
        row = cell.robot.dh[i].model_dump()
        com = _dh(row, 0.0, modified=False) @ [*inertials[i].com, 1.0]
        text.append(
            f'<link name="l{i}"><inertial><mass value="{inertials[i].mass!r}"/>'
            f'<origin xyz="{com[0]!r} {com[1]!r} {com[2]!r}"/>'
            '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            + _joint(name, "revolute", parent, f"l{i}", before)
        )
        before, parent = row, f"l{i}"
    return "".join([*text, '<link name="end"/>', _joint("end_joint", "fixed", parent, "end", before), "</robot>"])


def _joint(name: str, kind: str, parent: str, child: str, row: dict[str, float]) -> str:
    origin = _dh(row, 0.0, modified=False)[:3, 3]
    rpy = f"{row['alpha']!r} 0 {row['theta']!r}"  # Rz(theta) Rx(alpha)
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{origin[0]!r} {origin[1]!r} {origin[2]!r}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
    )


@pytest.mark.parametrize("joints", [3, 6, 7])
def test_urdf_and_dh_of_one_robot_agree_under_load(changed: Changed, small: Cell, tmp_path: Path, joints: int) -> None:
    """Points and wrench readings of both agree to 1e-9 (m; relative for the wrench)."""
    by_dh = _dh_cell(changed, small, _random_dh(joints, 20 + joints))
    (tmp_path / "same.urdf").write_text(_urdf(by_dh).replace("np.float64(", "").replace(")", ""))
    drop = dict.fromkeys(("robot__dh", "robot__modified_dh", "robot__joint_limits", "robot__inertials"))
    robot = {"urdf": str(tmp_path / "same.urdf"), "base_link": "base", "flange": "end"}
    by_urdf = changed(by_dh, **drop, **{f"robot__{key}": value for key, value in robot.items()})
    rng = np.random.default_rng(4)
    protocol = Protocol(
        tuple(Configuration(i, rng.uniform(-2, 2, joints), rng.uniform(-60, 60, (3, 6))) for i in range(5))
    )
    dh, urdf = (solve(cell, nominal_truth(cell), protocol).states for cell in (by_dh, by_urdf))
    assert np.max(np.abs(dh.points - urdf.points)) < 1e-9
    assert np.max(np.abs(dh.wrench - urdf.wrench)) < 1e-9 * np.max(np.abs(dh.wrench))
    assert np.max(np.abs(dh.deflection)) > 1e-4


def test_pinocchio_sees_the_same_flange_and_weights(demo: Cell) -> None:
    """The URDF read by another library: forward kinematics to 1e-12 m, gravity torques to 1e-6 relative."""
    pinocchio = pytest.importorskip("pinocchio")
    model = pinocchio.buildModelFromUrdf(str(demo.urdf_path))
    model.gravity.linear = demo.gravity
    data = model.createData()
    mechanism = Mechanism(read_chain(demo), np.full(6, 1e12), demo.gravity)
    rng = np.random.default_rng(7)
    flange = model.getFrameId("flange")
    for q in rng.uniform(-2, 2, (20, 6)):
        pinocchio.framesForwardKinematics(model, data, q)
        place = mechanism.forward(q)
        assert place.translation == pytest.approx(data.oMf[flange].translation, abs=1e-12)
        assert place.rotation == pytest.approx(data.oMf[flange].rotation, abs=1e-12)
        gravity = pinocchio.computeGeneralizedGravity(model, data, q)
        assert mechanism.equilibrium(q).torque == pytest.approx(gravity, rel=1e-6, abs=1e-2)


def test_arm_weighs_about_eleven_hundred_kilograms(demo: Cell) -> None:
    text = demo.urdf_path.read_text()
    total = sum(float(part.split('"')[0]) for part in text.split('mass value="')[1:])
    assert 1000.0 < total < 1200.0


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ('<mass value="330"/>', '<mass value="heavy"/>', "'heavy'"),
        ('<mass value="330"/>', '<mass value="-3"/>', "'-3'"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', "length zero"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 1"/>', "'0 1'"),
        ('joint_4" type="revolute"', 'joint_4" type="floating"', "'floating'"),
        ('name="joint_6"', 'name="joint_seven"', "'joint_6'"),
        ('lower="-2.1380" upper="2.1380"', 'lower="2" upper="-2"', "[2, -2]"),
        ("</robot>", "", "no element found"),
        ("<robot", '<!DOCTYPE a [<!ENTITY b "c">]><robot', "DOCTYPE"),
        ('<link name="flange"/>', "", "'flange'"),
        ('<child link="link_3"/>', '<child link="nowhere"/>', "'nowhere'"),
        ('<parent link="link_3"/>', "", "parent: found nothing"),
    ],
)
def test_urdf_faults_are_named(changed: Changed, demo: Cell, tmp_path: Path, old: str, new: str, found: str) -> None:
    text = demo.urdf_path.read_text()
    assert old in text
    (tmp_path / "bad.urdf").write_text(text.replace(old, new))
    with pytest.raises(CellError) as caught:
        read_chain(changed(demo, robot__urdf=str(tmp_path / "bad.urdf")))
    assert found in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("end", ["999999", "inf"])
def test_limits_that_are_none_are_those_of_an_endless_joint(
    changed: Changed, demo: Cell, tmp_path: Path, end: str
) -> None:
    text = demo.urdf_path.read_text().replace('lower="-2.1380" upper="2.1380"', f'lower="-{end}" upper="{end}"')
    (tmp_path / "endless.urdf").write_text(text)
    chain = read_chain(changed(demo, robot__urdf=str(tmp_path / "endless.urdf")))
    assert [-np.pi, np.pi] in chain.limits.tolist()


def test_a_missing_urdf_is_named(changed: Changed, demo: Cell, tmp_path: Path) -> None:
    with pytest.raises(CellError, match=r"nothing\.urdf"):
        read_chain(changed(demo, robot__urdf=str(tmp_path / "nothing.urdf")))


def test_links_beside_the_chain_weigh_in(changed: Changed, demo: Cell, tmp_path: Path) -> None:
    """A fixed box on link 3 loads joints 2 and 3 by its weight times its lever."""
    box = (
        '<link name="box"><inertial><mass value="50"/></inertial></link><joint name="on" type="fixed">'
        '<parent link="link_3"/><child link="box"/><origin xyz="0.5 0 0"/></joint></robot>'
    )
    (tmp_path / "box.urdf").write_text(demo.urdf_path.read_text().replace("</robot>", box))
    with_box = changed(demo, robot__urdf=str(tmp_path / "box.urdf"))
    torque = [
        Mechanism(read_chain(c), np.full(6, 1e12), c.gravity).equilibrium(np.zeros(6)).torque for c in (demo, with_box)
    ]
    weight = 50 * 9.80665
    assert torque[0] - torque[1] == pytest.approx([0, weight * 0.5, weight * 0.5, 0, 0, 0], abs=1e-2)


def test_configurations_of_a_seven_joint_cell(changed: Changed, small: Cell) -> None:
    rows = [
        {"a": 0.0, "alpha": s * np.pi / 2, "d": d, "theta": 0.0}
        for s, d in zip((-1, 1, 1, -1, -1, 1, 0), (0.36, 0.0, 0.42, 0.0, 0.4, 0.0, 0.13), strict=True)
    ]
    cell = _dh_cell(changed, small, rows)
    protocol = random_protocol(cell, 5, 0)
    solved = solve(cell, nominal_truth(cell), protocol)
    assert solved.states.q.shape == (45, 7)
    assert np.all(np.isfinite(solved.states.points))
