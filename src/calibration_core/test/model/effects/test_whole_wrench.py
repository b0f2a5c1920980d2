"""Columns of what gives way, under load and weight, against the full equilibrium of a chain with one more joint."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from states import TIP, state_at

from calibration_core.model.chain import Chain, rotation_rpy, rotation_x, rotation_y
from calibration_core.model.effects import candidates
from calibration_core.model.effects.state import State
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.statics import Load
from calibration_core.timeseries import Float1D, Float2D, Float3D

SENSOR = rotation_rpy(0.1, -0.2, 0.4)
WRENCH_POINT = np.array([0.1, -0.05, 0.25])
M = 20
SOFT = 2e-6  # rad/(N*m): so soft that loads shift and K_CSM matters
SMALL = 1e-11
KINDS = {"at rest": None, "sensor axes": SENSOR, "base axes": "base"}


def readings(chain: Chain, kind: str) -> tuple[Float2D, Float2D | None, Load | None]:
    rng = np.random.default_rng(5)
    q = rng.uniform(-1.5, 1.5, (M, chain.n))
    if kind == "at rest":
        return q, None, None
    wrench = rng.normal(size=(M, 6)) * [900, 900, 900, 150, 150, 150]
    rotation = None if kind == "base axes" else SENSOR
    return q, wrench, Load(wrench[:, :3].T, wrench[:, 3:].T, WRENCH_POINT, rotation)


def state(chain: Chain, kind: str) -> State:
    q, wrench, load = readings(chain, kind)
    return state_at(chain, q, SOFT, load, wrench=wrench)


def columns(chain: Chain, kind: str, effect: str, variant: str, **location: str) -> Float3D:
    here = state(chain, kind)
    found = [c for c in every_candidate(here) if c.effect == effect and c.variant == variant]
    found = [c for c in found if all(c.location.get(key) == value for key, value in location.items())]
    assert len(found) == 1
    return found[0].columns(here)


def every_candidate(here: State) -> list:
    from calibration_core.model.effects import catalogue

    return [c for effect in catalogue() for c in effect.candidates(here)]


@pytest.mark.parametrize("kind", KINDS)
def test_columns_of_some_readings_are_those_of_all(chain: Chain, kind: str) -> None:
    """To the bit, of every candidate that says that its columns may be written for some readings alone."""
    here, rows = state(chain, kind), np.array([1, 4, 5, 17])
    several = [one for one in every_candidate(here) if one.row_by_row]
    assert {one.effect for one in several} == {
        "transmission_error", "off_axis_compliance", "link_bending", "base_compliance",
    }  # fmt: skip
    for one in several:
        assert np.array_equal(one.columns(here.of_rows(rows)), one.columns(here)[rows]), one.key


@pytest.mark.parametrize("kind", KINDS)
def test_an_effect_that_only_turns_a_joint_moves_the_points_by_its_lever(chain: Chain, kind: str) -> None:
    here = state(chain, kind)
    several = [one for one in every_candidate(here) if one.turns is not None]
    assert {one.effect for one in several} == {"transmission_error"}
    for one in several:
        lever = here.joint_column(chain.joints.index(str(one.location["joint"])), np.ones(here.m))
        assert np.array_equal(one.columns(here), lever[:, :, None] * one.turns(here)[:, None]), one.key


def inserted(chain: Chain, place: int, rotation: Float2D, translation: Float1D, *, takes: bool = False) -> Chain:
    """Return the chain with one more joint, about z of a frame in the body frame of link `place` - 1.

    Args:
        chain: The robot.
        place: Index of the new joint; at the number of joints it sits before the flange.
        rotation: (3, 3) of the new frame in that body frame.
        translation: (3,) m, its origin there.
        takes: Whether the weight of link `place` - 1 lies beyond the new joint.
    """

    def split(list_of: np.ndarray, value: object) -> np.ndarray:
        return np.insert(list_of, place, value, axis=0)

    rotations, translations = split(chain.rotation, rotation), split(chain.translation, translation)
    flange_rotation, flange_translation = chain.flange_rotation, chain.flange_translation
    if place < chain.n:
        rotations[place + 1] = rotation.T @ chain.rotation[place]
        translations[place + 1] = rotation.T @ (chain.translation[place] - translation)
    else:
        flange_translation = rotation.T @ (chain.flange_translation - translation)
        flange_rotation = rotation.T @ chain.flange_rotation
    mass, com = split(chain.mass, 0.0), split(chain.com, np.zeros(3))
    if takes:
        mass[place], com[place] = chain.mass[place - 1], rotation.T @ (chain.com[place - 1] - translation)
        mass[place - 1] = 0.0
    return dataclasses.replace(
        chain, joints=(*chain.joints, "virtual"), rotation=rotations, translation=translations,
        offset=split(chain.offset, 0.0), flange_rotation=flange_rotation, flange_translation=flange_translation,
        limits=split(chain.limits, [-1.0, 1.0]), mass=mass, com=com,
        prismatic=(*chain.prismatic[:place], False, *chain.prismatic[place:]),
    )  # fmt: skip


def slope(chain: Chain, kind: str, virtual: Chain, place: int) -> Float2D:
    """Return the (M, 3) movement per unit compliance of the new joint, of the full equilibrium."""
    q, _, load = readings(chain, kind)
    compliance = np.insert(np.full(chain.n, SOFT), place, 0.0)
    wide = np.insert(q, place, 0.0, axis=1)
    both = []
    for sign in (1, -1):
        compliance[place] = sign * SMALL
        both.append(solve_equilibrium(virtual, wide, compliance, load).at.point(TIP).T)
    return (both[0] - both[1]) / (2 * SMALL)


def close(seen: Float2D, expected: Float2D) -> None:
    np.testing.assert_allclose(seen, expected, atol=2e-4 * np.abs(expected).max())
    assert np.abs(expected).max() > 0


ABOUT: dict[str, Callable[[], Float2D]] = {
    "x": lambda: rotation_y(np.pi / 2), "y": lambda: rotation_x(-np.pi / 2), "z": lambda: np.eye(3)
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("joint", [0, 1, 2])
def test_a_bearing_tilts_under_load_and_weight(chain: Chain, kind: str, joint: int) -> None:
    name = chain.joints[joint]
    before = columns(chain, kind, "off_axis_compliance", "before", joint=name)
    for k, axis in enumerate("xy"):
        frame = chain.rotation[joint] @ ABOUT[axis]()
        virtual = inserted(chain, joint, frame, chain.translation[joint])
        close(before[..., k], slope(chain, kind, virtual, joint))
    behind = columns(chain, kind, "off_axis_compliance", "behind", joint=name)
    for k, axis in enumerate("xy"):
        virtual = inserted(chain, joint + 1, ABOUT[axis](), np.zeros(3), takes=True)
        close(behind[..., k], slope(chain, kind, virtual, joint + 1))
    one = columns(chain, kind, "off_axis_compliance", "isotropic", joint=name)
    np.testing.assert_allclose(one[..., 0], before[..., 0] + before[..., 1], rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_the_base_rocks_under_load_and_weight(chain: Chain, kind: str) -> None:
    seen = columns(chain, kind, "base_compliance", "rotation")
    for k, axis in ((0, "x"), (1, "y"), (3, "z")):
        virtual = inserted(chain, 0, ABOUT[axis](), np.zeros(3))
        close(seen[..., k], slope(chain, kind, virtual, 0))


@pytest.mark.parametrize("kind", ["sensor axes", "base axes"])
def test_the_tool_gives_way_under_the_load(chain: Chain, kind: str) -> None:
    seen = columns(chain, kind, "tool_compliance", "rotation")
    for k, axis in enumerate("xyz"):
        virtual = inserted(chain, chain.n, chain.flange_rotation @ ABOUT[axis](), chain.flange_translation)
        close(seen[..., k], slope(chain, kind, virtual, chain.n))


def test_nothing_of_the_robot_weighs_on_its_flange(chain: Chain) -> None:
    np.testing.assert_array_equal(columns(chain, "at rest", "tool_compliance", "six springs"), 0.0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("centre", [-0.2, 0.3, 1.4])
@pytest.mark.parametrize("chain", [(1, 3), (3, 7)], indirect=True)
def test_a_link_twists_under_all_that_lies_beyond_each_section(chain: Chain, kind: str, centre: float) -> None:
    """Torsion of link 1 as many hinges about its length, the link's weight at a share of it or outside."""
    span = chain.translation[1]
    com = np.array(chain.com)
    com[0] = centre * span + np.cross(span, [0.1, 0.2, -0.3])
    chain = dataclasses.replace(chain, com=com)
    seen = columns(chain, kind, "link_bending", "bending and torsion", link="link_1")[..., 3]
    first = np.cross(span, [0.0, 0.3, 1.0])
    first = first / np.linalg.norm(first)
    along = span / np.linalg.norm(span)
    frame = np.stack([first, np.cross(along, first), along], axis=1)
    nodes = (np.arange(20) + 0.5) / 20
    parts = [slope(chain, kind, inserted(chain, 1, frame, s * span, takes=s < centre), 1) for s in nodes]
    expected = np.mean(parts, axis=0) * np.linalg.norm(span)
    np.testing.assert_allclose(seen, expected, atol=2e-2 * np.abs(expected).max())


def test_structure_is_offered_at_rest(chain: Chain) -> None:
    effects = {c.effect for c in candidates(state(chain, "at rest"))}
    assert {"off_axis_compliance", "link_bending", "base_compliance", "joint_coupling"} <= effects
