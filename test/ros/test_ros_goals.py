"""Goals that are ended at random moments, in a shipped tree of processes, with each needed node absent in turn.

`test_goal.py` does the same 500 times with stand-ins; here driver, instruments and recorder are processes.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.msg import Outcome
from live_tree import LONG, SIMULATED, LiveTree, long_ways
from std_srvs.srv import Trigger

NEEDED = ("", "tracker", "force_torque", "recorder", "guard")  # one is absent when the goal is accepted; "": none
WAYS = ("cancel", "stop", "both")
LATEST = (0.05, 0.5, 8.0)  # s, a goal is ended between its acceptance and that
REACTION = 0.5  # s after the answer, by which the robot has been told to stop


class Ending(LiveTree):
    """Ends one goal after another."""

    def end(self, absent: str, way: str, latest: float) -> float:
        """End a goal; see that nothing moves afterwards; return how long the result took, s."""
        if absent:
            self.suite.processes[absent].kill()
            self.suite.processes.pop(absent).wait()
        self.begin()
        time.sleep(self.rng.uniform(0.0, latest))
        over, asked = self.run.over, []
        if way != "stop":
            asked.append(self.run.cancel())
        if way != "cancel":
            self.suite.call(Trigger, "sequencer/stop")
        self.wait(lambda: all(one.done() for one in asked), f"{way}: no answer")
        answered = time.monotonic_ns()
        time.sleep(self.rng.uniform(0.0, 1.5))
        if absent:
            self.suite.again(absent)
        code = self.run.result(LONG).outcome.code
        took = (time.monotonic_ns() - answered) / 1e9
        assert over or code in (Outcome.CANCELLED, Outcome.STOPPED), (absent, way, code)
        if absent:
            self.await_active(absent, self.suite.processes[absent].pid)
        how = f"{way}, without {absent or 'nothing'}"
        self.see_quiet(how)
        late = [at for at, _ in self.events(answered + round(REACTION * 1e9), "motion")]
        assert not late, f"{how}: moved {(late[0] - answered) / 1e9:.2f} s after the answer"
        return took


@pytest.mark.slow
def test_goals_that_are_ended_at_random_moments(suite: Any, plan: Path) -> None:
    ending = Ending(suite, long_ways(plan), SIMULATED)
    suite.call(Trigger, "sequencer/stop")
    ending.run.result(LONG)
    draws = [(absent, latest) for absent in NEEDED for latest in LATEST]
    took = []
    for number in ending.rng.permutation(len(draws)):
        absent, latest = draws[number]
        took.append(ending.end(absent, str(ending.rng.choice(WAYS)), latest))
        print(f"without {absent or 'nothing'}, within {latest:g} s: result after {took[-1]:.2f} s", flush=True)
    print(f"\n{len(took)} goals ended, result after {np.median(took):.2f} s, {max(took):.2f} s at most")
    assert ending.moved == []
