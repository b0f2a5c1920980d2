"""A reading counts only where the robot stood in its posture all the time."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.measurement.posture_check import Stood, posture_fault
from calibration_core.planning.plans.tolerances import Tolerances

JOINTS = ("a", "b", "c")
PLANNED = np.array([0.1, -0.2, 1.5])
RULES = Tolerances(posture=5e-3, hold=5e-4)


def stood(q: np.ndarray, length: float = 2.0, begin: int = 10**18) -> Stood:
    end = begin + round(length * 1e9)
    return Stood(begin, end, np.linspace(begin, end, len(q)).astype(np.int64), q)


def still(offset: float = 0.0, joint: int = 1) -> np.ndarray:
    q = np.tile(PLANNED, (201, 1))
    q[:, joint] += offset
    return q


def test_where_it_was_planned() -> None:
    assert posture_fault(stood(still()), PLANNED, None, RULES, JOINTS) == ""
    assert posture_fault(stood(still(4.9e-3)), PLANNED, None, RULES, JOINTS) == ""


@pytest.mark.parametrize("joint", [0, 1, 2])
@pytest.mark.parametrize("offset", [0.05, -0.05, 5.1e-3])
def test_elsewhere(joint: int, offset: float) -> None:
    text = posture_fault(stood(still(offset, joint)), PLANNED, None, RULES, JOINTS)
    wanted = PLANNED[joint]
    assert text == f"{JOINTS[joint]}: found {wanted + offset:.5f} rad, expected {wanted:.5f} ± 0.00500 rad of the plan"


def test_moved_since_step_0() -> None:
    """Within what is allowed of the plan, but not where the unloaded step was read."""
    text = posture_fault(stood(still(1e-3)), PLANNED, PLANNED, RULES, JOINTS)
    assert text == "b: found -0.19900 rad, expected -0.20000 ± 0.00050 rad of step 0"
    assert posture_fault(stood(still(1e-3)), PLANNED, PLANNED + np.array([0.0, 1e-3, 0.0]), RULES, JOINTS) == ""


def test_a_moment_suffices() -> None:
    q = still()
    q[100, 2] += 0.01
    assert posture_fault(stood(q), PLANNED, None, RULES, JOINTS).startswith("c: found 1.51000 rad")


@pytest.mark.parametrize("kept", [slice(0, 100), slice(102, None), slice(0, 0)])
def test_joint_states_that_stop_or_begin_late(kept: slice) -> None:
    whole = stood(still())
    part = Stood(whole.begin, whole.end, whole.stamps[kept], whole.q[kept])
    assert "no joint states" in posture_fault(part, PLANNED, None, RULES, JOINTS)


def test_slow_joint_states_are_enough() -> None:
    assert posture_fault(stood(still()[:5]), PLANNED, None, RULES, JOINTS) == ""
    assert posture_fault(stood(still()[:1], length=0.0), PLANNED, None, RULES, JOINTS) == ""


def test_what_is_not_finite_is_elsewhere() -> None:
    q = still()
    q[7, 0] = np.nan
    assert posture_fault(stood(q), PLANNED, None, RULES, JOINTS) != ""
