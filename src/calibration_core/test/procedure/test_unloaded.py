"""A load that was left on is seen before anything moves, whatever the sensor's bias and the tool's weight are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.errors import OutputError, SessionError
from calibration_core.measurement.load_check import Felt, LoadCheck
from calibration_core.measurement.unloaded import KEPT, LoadMemory, ProvenZero, Unloaded, memory_file
from calibration_core.planning.plans.tolerances import Tolerances
from calibration_core.timeseries import Float1D, Float2D


class Sensor:
    """A sensor with a bias and a tool, as the equations of statics say."""

    def __init__(self, cell: Cell, rng: np.random.Generator) -> None:
        self.check, self.gravity = LoadCheck(cell, Tolerances()), cell.gravity
        self.mass, self.bias = rng.uniform(0.0, 120.0), rng.uniform(-400.0, 400.0, 3)
        self.rng = rng

    def says(self, q: Float1D, pull: Float1D) -> Float1D:
        """Return (6,) under a pull (3,) N in base axes."""
        turn = np.array([self.check.pulls(Felt(q, unit))[:3] for unit in np.eye(3, 6)])  # rows: sensor axes in base
        force = turn @ (self.mass * self.gravity + pull) + self.bias + self.rng.normal(0.0, 1.0, 3)
        return np.concatenate([force, np.zeros(3)])

    def zero(self, q: Float1D) -> ProvenZero:
        return ProvenZero(0, q, self.says(q, np.zeros(3)), "test")


def postures(rng: np.random.Generator, count: int) -> Float2D:
    return rng.uniform(-1.2, 1.2, (count, 6))


@pytest.mark.parametrize("seed", range(20))
def test_what_pulls_is_told_from_bias_and_tool(demo_cell: Cell, seed: int) -> None:
    """In the posture of the one zero, and, once a few postures are known, in any other."""
    rng = np.random.default_rng(seed)
    sensor = Sensor(demo_cell, rng)
    known = postures(rng, 8)
    there = Unloaded(sensor.check, demo_cell, [sensor.zero(known[0])])
    anywhere = Unloaded(sensor.check, demo_cell, [sensor.zero(q) for q in known])
    cases = [(there, known[0]), *((anywhere, q) for q in postures(rng, 20))]
    for unloaded, q in cases:
        pull = rng.normal(size=3)
        pull *= rng.uniform(150.0, 4000.0) / np.linalg.norm(pull)
        for wanted in (np.zeros(3), pull):
            found, band = unloaded.pulling(q, sensor.says(q, wanted))
            assert sensor.check.floor < band <= 2.0 * sensor.check.floor
            assert (np.linalg.norm(found) <= band) is not wanted.any()
            np.testing.assert_allclose(found, wanted, atol=band)


def test_nothing_is_told_of_postures_that_no_zero_speaks_of(demo_cell: Cell) -> None:
    rng = np.random.default_rng(3)
    sensor = Sensor(demo_cell, rng)
    first, other = postures(rng, 2)
    assert np.isnan(Unloaded(sensor.check, demo_cell, []).pulling(first, sensor.says(first, np.zeros(3)))[1])
    one = Unloaded(sensor.check, demo_cell, [sensor.zero(first)])
    assert np.isnan(one.pulling(other, sensor.says(other, np.zeros(3)))[1])


def test_what_is_kept_comes_back(demo_cell: Cell, tmp_path: Path) -> None:
    path = tmp_path / "deep" / "load.json"
    assert LoadMemory(path).left is None
    memory = LoadMemory(path)
    memory.loading("configuration 3, step 2 of s1")
    assert LoadMemory(path).left == "configuration 3, step 2 of s1"
    memory.released()
    assert (LoadMemory(path).left, LoadMemory(path).zeros) == ("", ())
    zeros = [ProvenZero(i, np.arange(6.0) + i, np.arange(6.0), "A. Smith") for i in range(KEPT + 3)]
    for zero in zeros:
        memory.proven(zero)
    again = LoadMemory(path)
    assert [zero.time for zero in again.zeros] == [zero.time for zero in zeros[-KEPT:]]
    np.testing.assert_array_equal(again.zeros[-1].q, zeros[-1].q)
    memory.proven(zeros[0], anew=True)
    assert [zero.time for zero in LoadMemory(path).zeros] == [0]
    assert [one.name for one in path.parent.iterdir()] == ["load.json"]
    assert memory_file(demo_cell, "/left") != memory_file(demo_cell, "/right")
    assert memory_file(demo_cell, "/", str(path)) == path


@pytest.mark.parametrize("text", ["", "[]", "null", "{}", '{"schema": 1, "left": 3, "zeros": []}', "\x00",
    '{"schema": 2, "left": "", "zeros": []}', '{"schema": 1, "left": "", "zeros": [{"time": 1}]}',
    '{"schema": 1, "left": "", "zeros": [{"time": 1, "q": [0], "wrench": [NaN, 0, 0, 0, 0, 0], "proof": ""}]}',
])  # fmt: skip
def test_another_file_is_not_believed(tmp_path: Path, text: str) -> None:
    path = tmp_path / "load.json"
    path.write_text(text)
    with pytest.raises(SessionError, match="remove the file, and an operator says what pulls"):
        LoadMemory(path)


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    memory = LoadMemory.__new__(LoadMemory)
    memory.path, memory.left, memory.zeros = tmp_path / "file" / "load.json", None, ()
    with pytest.raises(OutputError):
        memory.loading("here")
    assert memory.left is None
