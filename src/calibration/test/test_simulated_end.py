"""The simulated cell ends like a cell: not before its robot stands, and was seen to."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy")
from calibration_sim.living_cell import process as simulated


def cell(stops_after: float) -> Any:
    """A cell whose robot moves for a while from now, s of wall time; it steps every 10 ms."""
    end = time.monotonic() + stops_after

    class Live:
        time = 0.0

        @property
        def moving(self) -> bool:
            return time.monotonic() < end

    live = Live()

    def step(until: float) -> None:
        live.time = until

    return SimpleNamespace(live=live, speed=1.0, schedule=SimpleNamespace(next=lambda now: now + 0.01), step=step)


def lived(moves: float) -> float:
    """Seconds that a cell lives on after it was told to stop."""
    stop = threading.Event()
    stop.set()
    begin = time.monotonic()
    simulated.live_on(cell(moves), stop, 0)
    return time.monotonic() - begin


def test_a_cell_whose_robot_stands_is_seen_standing() -> None:
    assert simulated.SEEN <= lived(-1.0) < simulated.SEEN + 0.5


def test_a_cell_whose_robot_moves_lives_on_until_it_was_seen_standing() -> None:
    assert 0.35 + simulated.SEEN <= lived(0.4) < 0.4 + simulated.SEEN + 1.0  # it looks once a step


def test_a_robot_that_never_stands_does_not_keep_the_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulated, "LONGEST", 0.3)
    assert 0.3 <= lived(60.0) < 1.5
