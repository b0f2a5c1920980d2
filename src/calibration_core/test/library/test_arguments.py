"""Every function of the library refuses arguments that make no sense as it documents: an InputError in one line."""

from __future__ import annotations

import datetime as dt
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calibration_core as cal

ROOT = Path(__file__).resolve().parents[4]
BAG = ROOT / "bags" / "small_loaded"
CELL = ROOT / "config" / "cells" / "small.cell.yaml"
Q = [0.1, 0.5, 0.2, 0.3, 0.7, 0.1]
PULL = [50.0, 0.0, -60.0, 0.0, 0.0, 1.0]
FUNCTIONS = tuple(name for name in cal.__all__ if inspect.isfunction(getattr(cal, name)))


class Given:
    """What is right, by the names of the arguments."""

    def __init__(self) -> None:
        self.cell = cal.load_cell(CELL)
        self.recording = cal.load_recording(BAG, self.cell)
        self.model = cal.identify(self.recording)
        self.other = cal.simulate(self.cell, model=self.model, seed=5).recording
        self.right: dict[str, dict[str, Any]] = {
            "compare": {"first": self.recording, "second": self.other},
            "compensate": {"cell": self.cell, "model": self.model, "task": Q, "wrench": PULL},
            "deflect": {"cell": self.cell, "model": self.model, "task": Q, "wrench": PULL},
            "diagnose": {"recording": self.recording},
            "export": {"cell": self.cell, "model": self.model, "form": "dh"},
            "identify": {"recording": self.recording},
            "load_cell": {"path": CELL},
            "load_recording": {"source": BAG, "cell": self.cell},
            "plan": {"cell": self.cell},
            "predict": {"recording": self.other, "model": self.model},
            "simulate": {"cell": self.cell},
            "verify": {"recording": self.other, "model": self.model, "tolerance": 1e-3},
        }

    def call(self, name: str, /, **changes: Any) -> Any:
        return getattr(cal, name)(**{**self.right[name], **changes})


@pytest.fixture(scope="module")
def given() -> Given:
    return Given()


def refused(call: Callable[[], Any], *words: str) -> None:
    with pytest.raises(cal.InputError) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text
    assert ": found " in text
    assert ", expected " in text
    for word in words:
        assert word in text, text


class Strange:
    """A value of no kind that a function knows."""


ALL = [(name, one) for name in FUNCTIONS for one in inspect.signature(getattr(cal, name)).parameters]


@pytest.mark.parametrize(("name", "argument"), [pair for pair in ALL if pair != ("compare", "further")])
def test_a_value_of_no_kind(given: Given, name: str, argument: str) -> None:
    """Whatever the argument: a value that is of no kind is refused by function, argument and kind."""
    refused(lambda: given.call(name, **{argument: Strange()}), name, argument, "Strange")


@pytest.mark.parametrize(
    ("name", "changes", "words"),
    [
        ("export", {"form": "foo"}, "form: found 'foo', expected one of urdf, dh, ur, mjcf, table"),
        ("export", {"form": "table", "points": 2.5}, "points: found 2.5, expected a whole number"),
        ("export", {"form": "table", "joints": 3}, "joints: found 3, expected several, each a whole number"),
        ("export", {"form": "table", "q": [0.0, "a"]}, "q: found [0.0, 'a'], expected several, each a finite number"),
        ("export", {"points": 11}, "--points: found an option that has no effect on the format dh"),
        ("identify", {"method": "foo"}, "method: found 'foo', expected one of equilibrium, linear"),
        ("identify", {"readmit": [(1, 2)]}, "readmit: found [(1, 2)], expected several, each (a whole number"),
        ("identify", {"readmit": [(1, 2, "mpX")]}, "--readmit: found '1:2:mpX', expected a reading of"),
        ("identify", {"readmit": [(1, 2, "mp1")], "robust": False}, "--readmit: found an option that has no effect"),
        ("identify", {"recording": []}, "found none, expected at least one"),
        ("identify", {"model": "no\0file"}, "expected a path or the result of identify or diagnose or None"),
        ("identify", {"model": ""}, "model: found '', expected a path"),
        ("deflect", {"plane": "zz"}, "plane: found 'zz', expected one of xy, xz, yz"),
        ("deflect", {"task": ["a"]}, "task: found ['a'], expected a path or numbers"),
        ("deflect", {"task": [[1.0], [1.0, 2.0]]}, "expected a path or numbers"),
        ("deflect", {"payload": [5]}, "payload"),
        ("compensate", {"seed_q": [0.0]}, "seed_q"),
        ("plan", {"box": "0 1 0 1 0 1"}, "box: found '0 1 0 1 0 1', expected several, each a finite number"),
        ("plan", {"load_levels": []}, "--load-levels: found []"),
        ("plan", {"seed": -1}, "seed: found -1, expected a whole number of at least 0"),
        ("plan", {"configurations": True}, "configurations: found True, expected a whole number"),
        ("plan", {"spares": float("nan")}, "spares: found nan, expected a finite number"),
        ("verify", {"tolerance": "0.1 mm"}, "tolerance: found '0.1 mm', expected a finite number"),
        ("predict", {"cell": CELL}, None),
        ("compare", {"dates": ["2026-01-01", "2026-01-02"]}, "each a datetime or None"),
    ],
)
def test_a_value_that_makes_no_sense(given: Given, name: str, changes: dict[str, Any], words: str | None) -> None:
    if words is None:  # an argument that there is none of is a fault of the program, as in any function of Python
        with pytest.raises(TypeError, match="unexpected keyword argument"):
            given.call(name, **changes)
    else:
        refused(lambda: given.call(name, **changes), words)


def test_options_of_load_steps_need_them(given: Given) -> None:
    single = given.recording.readings
    rows = np.flatnonzero(single.step == 0)
    columns = {name: np.asarray(values)[rows] for name, values in given.recording.tables["measurements"].items()}
    rest = cal.load_recording({k: v for k, v in columns.items() if k[0] not in "ft" or k == "time"}, given.cell)
    refused(lambda: cal.identify(rest, method="linear"), "--method: found an option that has no effect")


def test_what_numpy_and_generators_hold_is_taken(given: Given, plan: cal.PlanResult) -> None:
    """Values of other types that mean the same are the same."""
    numbers = given.call("deflect", task=np.array(Q), wrench=tuple(PULL))
    np.testing.assert_array_equal(numbers.moved, given.call("deflect", task=tuple(Q), wrench=np.array(PULL)).moved)
    first, second = (given.call("simulate", plan=plan, seed=seed).recording for seed in (np.int64(3), 3))
    np.testing.assert_array_equal(first.position, second.position)
    grid = given.call("export", form="table", points=np.int64(3), joints=np.array([2, 3]), q=np.array(Q))
    assert len(grid.exported.files["corrections.csv"].splitlines()) == 10
    keys = ((1, 1, point) for point in given.cell.points[:1])
    assert given.call("identify", readmit=keys).stiffness.shape == (6,)
    dates = [dt.datetime(2026, k, 1, tzinfo=dt.UTC) for k in (1, 2)]
    assert given.call("compare", dates=iter(dates)).differences


def test_further_recordings_are_looked_at_too(given: Given) -> None:
    refused(lambda: cal.compare(given.recording, given.other, 5), "further: found 5, expected a recording")  # type: ignore[arg-type]
