"""The search on small linear models: one cause rather than two, and what a recording shows of a hypothesis counts."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest

from calibration_core.estimation.alternatives import strongest_first
from calibration_core.estimation.blocks import Blocks
from calibration_core.estimation.field import Field
from calibration_core.estimation.hypotheses import Offered, offer
from calibration_core.estimation.search import Search
from calibration_core.model.effects.candidate import Candidate, Parameter
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float2D, Float3D

READINGS, BLOCKS = 120, 10
FLAT = 3


def nothing(state: State) -> Float3D:
    return np.zeros((state.m, 3, 0))


def candidate(
    effect: str, joint: str, variant: str, count: int, *, positive: bool = False, family: str = "structure"
) -> Candidate:
    parameters = tuple(Parameter(f"p{k}", "1", 1.0, positive=positive) for k in range(count))
    return Candidate(effect, family, {"joint": joint}, variant, parameters, nothing)


def searched(residual: np.ndarray, flat: Float2D, columns: Float2D, candidates: list[Candidate]) -> list[str]:
    """Return the variants that are accepted."""
    search = search_of(residual, flat, columns, candidates)
    return [search.field.offered.hypotheses[i].variant for i in search.run().accepted]


def search_of(residual: np.ndarray, flat: Float2D, columns: Float2D, candidates: list[Candidate]) -> Search:
    offered: Offered = offer(candidates)
    label = np.arange(READINGS) * BLOCKS // READINGS
    partitions = (Blocks("time", label), Blocks("posture", np.arange(READINGS) % BLOCKS))
    field = Field.of(residual, flat, np.zeros((len(residual), 0)), [columns], offered, partitions)
    return Search(field, lambda _: "")


def drawn(seed: int, count: int) -> tuple[np.random.Generator, Float2D, Float2D]:
    rng = np.random.default_rng(seed)
    return rng, rng.standard_normal((3 * READINGS, FLAT)), rng.standard_normal((3 * READINGS, count))


def test_the_wider_form_of_one_cause_is_preferred_to_two_causes() -> None:
    """A simple form of the first joint enters first; the other joint resembles what it leaves."""
    rng, flat, columns = drawn(1, 5)
    simple, wide, noise = columns[:, :1], columns[:, :3].copy(), rng.standard_normal(3 * READINGS)
    wide[:, 0] = simple[:, 0]
    truth = wide @ np.array([1.0, 0.5, 0.4])
    near = wide[:, 1:] @ np.array([0.5, 0.4]) + 0.1 * columns[:, 4]
    every = np.column_stack([simple, wide, near])
    candidates = [
        candidate("bending", "joint_1", "simple", 1),
        candidate("bending", "joint_1", "wide", 3),
        candidate("bending", "joint_2", "near", 1),
    ]
    assert searched(truth + noise, flat, every, candidates) == ["wide"]


def test_a_hypothesis_is_judged_though_the_null_model_takes_up_one_of_its_columns() -> None:
    rng, flat, columns = drawn(2, 3)
    columns[:, 2] = flat[:, 0]  # as the turn of a tool about the last joint's axis
    truth = columns @ np.array([0.6, -0.5, 0.7])
    candidates = [candidate("bending", "joint_1", "three springs", 3)]
    assert searched(truth + rng.standard_normal(3 * READINGS), flat, columns, candidates) == ["three springs"]
    candidates = [candidate("bending", "joint_1", "one spring", 1)]
    assert searched(truth, flat, columns[:, 2:], candidates) == []


def test_a_search_cannot_begin_with_what_the_recording_does_not_show() -> None:
    rng, flat, columns = drawn(8, 3)
    columns[:, 0] = flat[:, 1]
    truth = columns[:, 1:] @ np.array([0.9, 0.9])
    candidates = [candidate("bending", "joint_1", "unseen", 1), candidate("bending", "joint_2", "seen", 2)]
    search = search_of(truth + rng.standard_normal(3 * READINGS), flat, columns, candidates)
    assert search.run((0, 1)).accepted == search.run((0,)).accepted == search.run().accepted == (1,)


def test_a_large_cause_is_told_from_what_resembles_it() -> None:
    """At the noise of a model without it, a large cause and what resembles it would gain alike."""
    rng, flat, columns = drawn(3, 2)
    true, like = columns[:, 0], columns[:, 0] + 0.3 * columns[:, 1]
    candidates = [candidate("bending", "joint_1", "like", 1), candidate("bending", "joint_2", "true", 1)]
    residual = 100.0 * true + rng.standard_normal(3 * READINGS)
    assert searched(residual, flat, np.column_stack([like, true]), candidates) == ["true"]


def test_nothing_is_accepted_of_noise() -> None:
    rng, flat, columns = drawn(4, 6)
    candidates = [candidate("bending", f"joint_{k}", "one", 1) for k in range(6)]
    assert searched(rng.standard_normal(3 * READINGS), flat, columns, candidates) == []


def test_what_a_later_cause_turns_negative_goes() -> None:
    """Alone the first compliance takes up most of the second, which resembles it; beside it, it would be negative."""
    rng, flat, columns = drawn(5, 2)
    second = columns[:, 0]
    first = second + 0.4 * columns[:, 1]
    truth = 30.0 * second - 2.0 * first
    candidates = [
        candidate("bending", "joint_1", "first", 1, positive=True),
        candidate("bending", "joint_2", "second", 1, positive=True),
    ]
    residual = truth + rng.standard_normal(3 * READINGS)
    search = search_of(residual, flat, np.column_stack([first, second]), candidates)
    found = search.run()
    assert [search.field.offered.hypotheses[i].variant for i in found.accepted] == ["second"]
    assert found.refused == ("Rejected: “bending at joint 1”: a compliance would be negative.",)
    free = [candidate("bending", f"joint_{k}", name, 1) for k, name in ((1, "first"), (2, "second"))]
    assert searched(residual, flat, np.column_stack([first, second]), free) == ["second", "first"]


def test_neither_a_family_nor_what_stands_in_its_stead_holds_a_negative_member() -> None:
    rng, flat, columns = drawn(6, 3)
    residual = columns @ np.array([1.5, 1.2, -0.9]) + rng.standard_normal(3 * READINGS)
    candidates = [candidate("bending", f"joint_{k}", "one", 1, positive=True) for k in range(3)]
    assert searched(residual, flat, columns, candidates) == ["one", "one"]  # of joint_0 and joint_1
    assert searched(residual, flat, columns, [candidate("bending", f"joint_{k}", "one", 1) for k in range(3)]) == [
        "one"
    ]


@pytest.mark.parametrize("seed", range(8))
def test_of_forms_that_do_exactly_as_well_the_simplest_is_named(seed: int) -> None:
    """The turn of a base about the first joint's axis, which that joint's compliance takes up, says nothing."""
    rng, flat, columns = drawn(seed, 2)
    every = np.column_stack([columns, flat[:, 0], columns])
    candidates = [candidate("rocking", "joint_1", "three", 3), candidate("rocking", "joint_1", "two", 2)]
    residual = columns @ np.array([0.8, -0.6]) + rng.standard_normal(3 * READINGS)
    assert searched(residual, flat, every, candidates) == ["two"]


@pytest.mark.parametrize("seed", range(8))
def test_a_law_of_many_forms_does_not_win_by_one_that_comes_near_by_chance(seed: int) -> None:
    """Of laws of a joint that one recording cannot distinguish, that is named of which most forms explain it."""
    rng, flat, columns = drawn(seed, 6)
    truth, noise = columns[:, 0], rng.standard_normal(3 * READINGS)
    unresolved = np.column_stack([truth, truth, truth])  # three widths below the smallest torque of the recording
    near = truth + 2e-3 * noise
    wide = np.column_stack([near, *(truth + k * columns[:, k] for k in range(1, 5))])
    several = [candidate("clearance", "joint_1", f"clearance {k}", 1, family="joint law") for k in range(3)]
    several += [candidate("zone", "joint_1", f"zone {k}", 1, family="joint law") for k in range(5)]
    found = searched(truth + noise, flat, np.column_stack([unresolved, wide]), several)
    assert [one.split()[0] for one in found] == ["clearance"]


def gears(seed: int, strength: float) -> tuple[np.ndarray, Float2D, Float2D, list[Candidate]]:
    """Four joints with zones, at the last of which a clearance gains a little more, and how strong that one is."""
    rng, flat, columns = drawn(seed, 4)
    noise = rng.standard_normal(3 * READINGS)
    near = columns[:, 3] + 2e-3 * noise / strength
    candidates = [candidate("zone", f"joint_{k}", f"zone {k}", 1, family="joint law") for k in range(4)]
    candidates.append(candidate("clearance", "joint_3", "clearance", 1, family="joint law"))
    truth = columns @ np.array([1.0, 1.0, 1.0, strength])
    return truth + noise, flat, np.column_stack([columns, near]), candidates


@pytest.mark.parametrize("seed", range(4))
def test_of_laws_that_do_as_well_a_joint_has_that_of_those_before(seed: int) -> None:
    residual, flat, every, candidates = gears(seed, 0.5)
    assert set(searched(residual, flat, every, candidates)) == {f"zone {k}" for k in range(4)}
    alone = residual - every[:, :3].sum(axis=1)
    assert searched(alone, flat, every[:, 3:], candidates[3:]) == ["clearance"]


@pytest.mark.parametrize("seed", range(4))
def test_beside_joints_whose_laws_are_open_a_cause_of_another_kind_must_gain_more(seed: int) -> None:
    """Where two joints need two forms of law each, twice as much is asked of the sensor, not of another joint."""
    rng, flat, columns = drawn(seed, 5)
    residual = columns @ np.array([1.0, 1.0, 1.0, 1.0, 0.44]) + rng.standard_normal(3 * READINGS)
    laws = [
        candidate(effect, f"joint_{k}", f"{effect} {k}", 1, family="joint law")
        for effect in ("zone", "hardening")
        for k in range(2)
    ]
    names = [one.variant for one in laws]
    offset, zone = candidate("offset", "sensor", "offset", 1), candidate("zone", "joint_2", "zone", 1)
    assert set(searched(residual, flat, columns, [*laws, offset])) == {*names}
    assert set(searched(residual, flat, columns, [*laws, zone])) == {*names, "zone"}
    settled = residual - columns[:, 3]
    assert set(searched(settled, flat, columns[:, [0, 1, 2, 4]], [*laws[:3], offset])) == {*names[:3], "offset"}


def test_of_two_laws_at_a_joint_that_one_comes_first_which_alone_gains_more() -> None:
    """A third form, of the kind of the weaker one, explains by itself what the two explain together."""
    rng, flat, columns = drawn(9, 2)
    noise = rng.standard_normal(3 * READINGS)
    both = columns @ np.array([0.6, 0.9])
    every = np.column_stack([columns, both])
    candidates = [
        candidate("hysteresis", "joint_1", "wide", 1, family="joint law"),
        candidate("creep", "joint_1", "slow", 1, family="joint law"),
        candidate("hysteresis", "joint_1", "narrow", 1, family="joint law"),
    ]
    search = search_of(both + noise, flat, every, candidates)
    found = search.result((0, 1))
    assert found.accepted == (1, 0)  # creep gains more beside the other
    assert strongest_first(search, found.accepted, ["joint_1"]) == (0, 1)
    search = search_of(both + noise, flat, every[:, :2], candidates[:2])
    assert strongest_first(search, search.result((0, 1)).accepted, ["joint_1"]) == (1, 0)


def test_a_search_is_freed_with_its_last_reference() -> None:
    """It holds hundreds of megabytes, and a process that evaluates many recordings cannot wait for the collector."""
    rng, flat, columns = drawn(6, 2)
    residual = columns @ np.array([0.6, -0.5]) + rng.standard_normal(3 * READINGS)
    gc.disable()
    try:
        search = search_of(residual, flat, columns, [candidate("bending", "joint_1", "two springs", 2)])
        assert search.run().accepted
        seen = weakref.ref(search)
        del search
        assert seen() is None
    finally:
        gc.enable()
