"""What effects say of themselves is what their columns do, and no list of names elsewhere says it again."""

from __future__ import annotations

import ast
import dataclasses
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from robots import STIFFNESS, write_cell

import calibration_core
from calibration_core.cell import Frames, Robot
from calibration_core.model.chain import Chain
from calibration_core.model.effects import catalogue, effect_named, effects_with
from calibration_core.model.effects.candidate import OF_A_FAMILY, Candidate, Trait
from calibration_core.model.effects.state import State, state_of
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import Load
from calibration_core.timeseries import Float1D, Float2D, Float3D

N = 6
COMPLIANCE = 1 / np.array(STIFFNESS)
TIP = np.array([0.15, 0.05, 0.3])
LEVELS = np.array([0.0, 0.004, 0.5, 1.0, 0.5])  # of a configuration's load
CONFIGURATIONS = 8
STEPS = len(LEVELS)
M = CONFIGURATIONS * STEPS
SILENT = {"clock_offset"}  # of which readings at rest show nothing


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Chain:
    return chain_of(write_cell(tmp_path_factory.mktemp("cell")))


def pulls(levels: Float1D = LEVELS) -> Float2D:
    """Return the (M, 6) N and N*m of loads up and down."""
    full = np.random.default_rng(3).normal(size=(CONFIGURATIONS, 6)) * [900, 900, 900, 150, 150, 150]
    return np.repeat(full, STEPS, axis=0) * np.tile(levels, CONFIGURATIONS)[:, None]


def state(chain: Chain, wrench: Float2D | None, **other: np.ndarray) -> State:
    """Return a recording of configurations with five steps, and of further ones with one, as many as loads there are.

    Args:
        chain: The robot.
        wrench: (m, 6) N and N*m; None: M configurations at rest.
        other: What shall be different: time, temperature.
    """
    m = M if wrench is None else len(wrench)
    q = np.random.default_rng(11).uniform(-1.2, 1.2, (M + m, N))
    if wrench is not None:
        q = np.concatenate([np.repeat(q[:CONFIGURATIONS], STEPS, axis=0), q[M:]])
    steps = np.tile(np.arange(STEPS), CONFIGURATIONS)
    numbers = np.repeat(np.arange(CONFIGURATIONS), STEPS)
    more = np.arange(m - M)
    known = {"time": np.arange(m) * 40.0, "temperature": 20 + 0.1 * np.arange(m), **other}
    return state_of(
        chain, q[:m], COMPLIANCE, None if wrench is None else Load(wrench[:, :3].T, wrench[:, 3:].T, TIP, None),
        np.tile(TIP[:, None], (1, m)), point_index=np.zeros(m, dtype=np.int64), wrench=wrench,
        configuration=np.arange(m) if wrench is None else np.concatenate([numbers, CONFIGURATIONS + more]),
        step=np.zeros(m, dtype=np.int64) if wrench is None else np.concatenate([steps, 0 * more]),
        tracker=np.eye(4), rated_load=240.0, **known,
    )  # fmt: skip


def every_form(here: State) -> Iterator[Candidate]:
    """Yield all that can be said about a recording; of many orders of waves a few."""
    for effect in catalogue():
        for number, candidate in enumerate((effect.forms or effect.candidates)(here)):
            if effect.name != "transmission_error" or number < 8:
                yield candidate


def those(here: State, differs: Callable[[Float3D, Callable[[State], Float3D]], bool]) -> set[str]:
    """Return the effects of which some form differs from what it does in a recording."""
    found, seen = set(), set()
    for candidate in every_form(here):
        columns = candidate.columns(here)
        seen.add(candidate.effect)
        if differs(columns, candidate.columns):
            found.add(candidate.effect)
    assert seen >= {effect.name for effect in catalogue()} - SILENT - effects_of_what_was_not_loaded(here)
    return found


def effects_of_what_was_not_loaded(here: State) -> set[str]:
    """Return the effects that need a load to be offered at all."""
    return set() if here.loaded else {effect.name for effect in catalogue() if not effect.absolute}


def is_other(one: Float3D, other: Float3D) -> bool:
    return bool(np.abs(one - other).max(initial=0.0) > 1e-9 * np.abs(one).max(initial=0.0))


def test_laws_relative_to_the_largest_torque_change_with_it(chain: Chain) -> None:
    """A recording and the same with far larger loads at its end: which laws of the first readings are others?"""
    strong = np.random.default_rng(4).normal(size=(4, 6)) * [4e3, 4e3, 4e3, 2e3, 2e3, 2e3]
    here, more = state(chain, pulls()), state(chain, np.concatenate([pulls(), strong]))
    np.testing.assert_array_equal(here.q, more.q[:M])
    assert all(more.largest_torque(j) > 1.5 * here.largest_torque(j) for j in range(N))
    found = those(here, lambda columns, law: is_other(columns, law(more)[:M]))
    assert found == effects_with(Trait.OF_LARGEST_TORQUE)


def test_springs_beside_a_joint_act_on_it_with_a_torque(chain: Chain) -> None:
    here = state(chain, pulls())
    assert {c.effect for c in every_form(here) if c.torques is not None} == effects_with(Trait.SPRING)


def test_drifts_grow_in_proportion_to_time(chain: Chain) -> None:
    here = state(chain, pulls())
    later = dataclasses.replace(here, time=2 * here.time)
    found = those(here, lambda one, law: bool(np.any(one)) and not is_other(2 * one, law(later)))
    assert found == effects_with(Trait.DRIFT)


def test_what_has_memory_shows_an_earlier_load(chain: Chain) -> None:
    """Step 1 with another load, still below the largest one: whose steps 2 to 4 are others?"""
    here, other = state(chain, pulls()), state(chain, pulls(np.array([0.0, 0.9, 0.5, 1.0, 0.5])))
    np.testing.assert_allclose(here.largest_torques(), other.largest_torques(), rtol=1e-12)
    later = here.step > 1
    found = those(here, lambda one, law: is_other(one[later], law(other)[later]))
    assert found == effects_with(Trait.MEMORY)


def test_joints_that_lag_lag_by_as_much_under_all_torques_twice_as_large(chain: Chain) -> None:
    """Friction and clearance are laws of a joint that have a width, whatever the load is."""
    here = state(chain, pulls())
    twice = dataclasses.replace(here, load_torque=2 * here.load_torque, gravity_torque=2 * here.gravity_torque)
    same = those(here, lambda one, law: not is_other(one, law(twice)))
    assert same & {effect.name for effect in catalogue() if effect.family == "joint law"} == effects_with(Trait.LAG)


def test_what_a_posture_at_rest_alone_tells(chain: Chain) -> None:
    """Postures at rest at other times, at another warmth, and reached from another side: what moves?

    What remembers torques does so, too, but shows in postures in which the weight pulls otherwise.
    """
    here = state(chain, None)
    back = np.arange(M)[::-1]
    at, answer = here.at, here.answer[:, :, back]
    posture = dataclasses.replace(
        at, before=at.before[..., back], origin=at.origin[..., back], body=at.body[..., back],
        body_origin=at.body_origin[..., back], flange=at.flange[..., back], flange_origin=at.flange_origin[..., back],
    )  # fmt: skip
    turned = dataclasses.replace(
        here, q=here.q[back], at=posture, answer=answer, point=here.point[:, back],
        gravity_torque=here.gravity_torque[:, back], temperature=here.temperature + 7, time=1.7 * here.time + 3,
    )  # fmt: skip
    found = those(here, lambda one, law: is_other(one, law(turned)[back]))
    assert found - effects_with(Trait.MEMORY) == effects_with(Trait.HISTORY) - SILENT


def test_what_refitted_frames_and_geometry_take_up_is_a_matter_of_definition() -> None:
    assert effects_with(Trait.FRAMES) == {"tracker_frame_misalignment", "measurement_point_offset"}
    assert effects_with(Trait.GEOMETRY) == {"joint_zero_offset", "geometry_error"}
    assert {effect_named(name).family for name in effects_with(Trait.FRAMES)} == {"point chain"}
    assert {effect_named(name).family for name in effects_with(Trait.GEOMETRY)} == {"absolute"}


def test_what_the_weight_drives_is_larger_under_twice_the_weight(chain: Chain) -> None:
    """At rest; of effects of the robot, for load chain and point chain have sizes of their own."""
    here = state(chain, None)
    heavy = state(dataclasses.replace(chain, mass=2 * np.asarray(chain.mass)), None)
    found = those(here, lambda one, law: bool(np.abs(law(heavy)).max(initial=0) > 1.5 * np.abs(one).max(initial=0)))
    assert found - {"tool_weight"} <= effects_with(Trait.BY_WEIGHT)
    assert "joint_elasticity" in found
    bent = {"joint_elasticity", "gravity_direction"}
    geared = {effect.name for effect in catalogue() if effect.family == "absolute"} - bent
    assert not geared & effects_with(Trait.BY_WEIGHT)


def test_what_acts_in_use_and_what_is_damage_follow_from_the_family_but_for_a_few() -> None:
    families = {effect.name: effect.family for effect in catalogue()}
    assert set(families.values()) == set(OF_A_FAMILY)
    robot = {name for name, family in families.items() if family in {"structure", "joint law", "absolute"}}
    assert effects_with(Trait.ACTS_IN_USE) == robot | {"tool_weight", "cable_force"}
    laws = {name for name, family in families.items() if family in {"structure", "joint law"}}
    assert effects_with(Trait.DAMAGE) == laws | {"transmission_error"}
    assert effects_with(Trait.PATH) == {"approach_direction"}


def test_every_property_is_somebodys_and_none_is_everybodys() -> None:
    names = {effect.name for effect in catalogue()}
    assert all(set() < effects_with(trait) < names for trait in Trait)


def test_the_documentation_lists_every_property_and_the_families_that_have_it() -> None:
    text = (Path(calibration_core.__file__).parents[1] / "doc" / "extending.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `([A-Z_]+)` \|.*\|([^|]*)\|$", text, re.MULTILINE))
    assert {name: set(filter(None, families.strip().split(", "))) for name, families in rows.items()} == {
        trait.name: {family for family, own in OF_A_FAMILY.items() if trait in own} for trait in Trait
    }


SHARED = {"joint_coupling"}  # the word for an anomaly and a key of cell files, too


def listed(code: str) -> set[str]:
    """Return the effects that a file names in a set, a table, or with others in a list."""
    names, found = {effect.name for effect in catalogue()} - SHARED, set()
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Set | ast.Dict | ast.List | ast.Tuple):
            several = node.keys if isinstance(node, ast.Dict) else node.elts
            own = {one.value for one in several if isinstance(one, ast.Constant)} & names
            if len(own) > 1 or (own and isinstance(node, ast.Set | ast.Dict)):
                found |= own
    return found


def test_what_an_effect_looks_like_an_error_of_is_a_value_of_the_cell_file() -> None:
    stated = {effect.stated for effect in catalogue()} - {""}
    assert stated
    fields = {f"frames.{name}" for name in Frames.model_fields} | {f"robot.{name}" for name in Robot.model_fields}
    assert stated <= fields
    otherwise = {effect.stated_otherwise.split()[0] for effect in catalogue() if effect.stated_otherwise}
    assert otherwise
    assert otherwise <= fields


def test_no_list_of_effects_stands_anywhere() -> None:
    home = Path(calibration_core.__file__).parent
    files = {path.relative_to(home).as_posix(): path.read_text(encoding="utf-8") for path in home.rglob("*.py")}
    assert len(files) > 300
    assert {name: found for name, code in files.items() if (found := listed(code))} == {}
    assert listed('A = frozenset({"creep"})\nB = ("creep", "backlash")\nC = "soft_zone",\nD = {"hysteresis": 1}') == {
        "creep", "backlash", "hysteresis",
    }  # fmt: skip
