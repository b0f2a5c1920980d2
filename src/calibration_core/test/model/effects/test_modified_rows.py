"""A robot in modified DH rows and the same robot as a URDF: under its own weight, both offer the same effects."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from states import state_at

from calibration_core.cell import Cell, load_cell
from calibration_core.model.chain import Chain, rotation_x, rotation_z, rpy_of
from calibration_core.model.effects import candidates
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State
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


def at_rest(path: Path, compliance: float = 2e-6) -> State:
    return resting(chain_of(load_cell(path)), compliance)


def resting(chain: Chain, compliance: float) -> State:
    return state_at(chain, np.random.default_rng(2).uniform(-1.3, 1.3, (M, chain.n)), compliance)


ENDS = {"off_axis_compliance": ", other end of its axis", "link_bending": ", between the other ends of the axes"}


def by_end(state: State, effect: str, form: str) -> dict[bool, dict[object, Candidate]]:
    """Return place -> the form of an effect there, at the joints' frames (False) and at the other ends (True)."""
    offered = {c.key: c for c in candidates(state) if c.effect == effect}
    found: dict[bool, dict[object, Candidate]] = {False: {}, True: {}}
    for (_, _, variant), candidate in offered.items():
        for other in (False, True):
            if variant == form.replace("@", ENDS[effect] if other else ""):
                found[other][candidate.place] = candidate
    return found


# Not by the axes before the turn theta of a row, which modified rows state behind the frame, and a URDF before it.
@pytest.mark.parametrize(
    ("effect", "form", "apart"),
    [
        ("off_axis_compliance", "isotropic@", {"joint_1", "joint_4", "joint_6"}),
        ("off_axis_compliance", "behind@", {"joint_1", "joint_4", "joint_6"}),
        ("link_bending", "tube@", {"link_1", "link_3", "link_5"}),
        ("link_bending", "bending and torsion@", {"link_1", "link_3", "link_5"}),
        ("link_bending", "tube@, own weight on its joint", {"link_1", "link_3", "link_5"}),
    ],
)
def test_modified_rows_and_their_urdf_give_the_same_effects(
    tmp_path: Path, effect: str, form: str, apart: set[str]
) -> None:
    rows, urdf = at_rest(as_rows(tmp_path)), at_rest(as_urdf(tmp_path))
    own, turned = by_end(rows, effect, form), by_end(urdf, effect, form)
    seen = set()
    for place, one in own[True].items():  # the rows' frames before the joints are a URDF's other ends
        columns = one.columns(rows)
        np.testing.assert_allclose(
            columns, turned[False][place].columns(urdf), rtol=0, atol=1e-9 * np.abs(columns).max()
        )
        seen |= set(one.location.values())
    assert seen >= apart
    for place, one in own[False].items():
        other = turned[True].get(place) or turned[False][place]
        columns = one.columns(rows)
        np.testing.assert_allclose(columns, other.columns(urdf), rtol=0, atol=1e-9 * np.abs(columns).max())


def test_own_weight_on_the_joint_is_that_of_a_link_whose_centre_of_gravity_is_there(tmp_path: Path) -> None:
    stiff = 1e-16  # so that both stand in the same posture
    chain = chain_of(load_cell(as_rows(tmp_path)))
    assert chain.com is not None
    for link in (0, 1, 2):
        com = chain.com.copy()
        com[link] = 0.0
        moved = resting(dataclasses.replace(chain, com=com), stiff)
        as_stated = resting(chain, stiff)
        name = f"link_{link + 1}"

        def columns(state: State, variant: str, name: str = name) -> np.ndarray:
            several = (c for c in candidates(state) if c.effect == "link_bending" and c.location["link"] == name)
            return next(c for c in several if c.variant == variant).columns(state)

        on_joint = columns(as_stated, "bending and torsion, own weight on its joint")
        np.testing.assert_allclose(
            on_joint, columns(moved, "bending and torsion"), rtol=0, atol=1e-9 * np.abs(on_joint).max()
        )
        assert np.abs(on_joint - columns(as_stated, "bending and torsion")).max() > 1e-3 * np.abs(on_joint).max()


def test_recordings_of_loads_are_offered_one_end_alone(tmp_path: Path) -> None:
    resting = at_rest(as_rows(tmp_path))
    loaded = dataclasses.replace(resting, force=np.full((3, M), 100.0), moment=np.zeros((3, M)))
    words = [f"{c.effect} {c.variant}" for c in candidates(loaded)]
    assert any(word.startswith("off_axis_compliance") for word in words)
    assert not any("other end" in word or "own weight on" in word for word in words)


def test_standard_rows_have_both_ends_where_axes_are_parallel_alone() -> None:
    cell = Cell.model_validate(
        {
            "name": "standard", "frames": {"measurement_points": {"mp1": [0.1, 0, 0]}},
            "instruments": {"tracker": {"sigma": 1e-5}},
            "robot": {
                "name": "r", "joints": ["a", "b", "c"], "joint_limits": [[-3, 3]] * 3, "rated_load": 10,
                "dh": [{"a": 0.1, "alpha": 1.5707963267948966, "d": 0.4}, {"a": 0.5, "alpha": 0.0, "d": 0.2},
                       {"a": 0.4, "alpha": 0.0, "d": 0.0}],
            },
        }
    )  # fmt: skip
    np.testing.assert_allclose(chain_of(cell).other_end, [0.0, 0.0, -0.2], atol=1e-15)
