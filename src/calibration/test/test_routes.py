"""Every route of doc/real_cell.md, from messages of the drivers' own types to the permission that lasts."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_drivers import SUPERVISION, UR, gpio, loaded

from calibration.guard.parameters import PARAMETERS, guard_rules
from calibration.robot_state import GENERIC, NAMES
from calibration.robot_state.adapter import (
    CONFIRMABLE,
    Confirmation,
    Received,
    assemble,
    checked,
    confirmed,
    load_adapter,
)
from calibration_core.cell import Safety, load_cell
from calibration_core.model.nominal import nominal_parameters, tool_point
from calibration_core.model.robot import chain_of
from calibration_core.motion.guard import Guard
from calibration_core.motion.robot_status import OperatingMode, Reason
from calibration_core.motion.speed import Monitored
from calibration_core.motion.stop_proof import RequestedStop
from calibration_core.timeseries import NANOSECONDS

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "src/calibration/doc/real_cell.md").read_text("utf-8")
TABLE = PAGE.partition("is permitted with |\n|---|---|---|---|---|\n")[2].partition("\n\n")[0].splitlines()
ROUTES = [tuple(cell.strip(" `") for cell in row.strip("|").split("|")[1:]) for row in TABLE]
NOBODY = "at no time"
PERIODS = {"kuka_kss": 1.0, "abb": 0.2}  # s, between two messages, as the tables' evidence says; 20 ms else
LAGS = {"kuka_kss": 0.9, "fanuc": 0.9, "industrial": 0.1, "staubli": 0.06}  # s, that "in motion" lasts beside that
SLOW_JOINTS = {("abb", "external"): (0.2, {"max_joints_age": 0.5})}  # s, and what the page has the reader state for it
CASES = [
    pytest.param(*route, release, id="-".join((route[0], release or "no driver", *route[1:3])))
    for route in ROUTES
    for release in load_adapter(route[0]).releases or [""]
]


def messages(adapter: str, release: str, switch: str, *, jogged: bool, moving: bool) -> dict[str, Any]:
    """What a driver says of a robot about which all is well, by the words of the page for its mode selector."""
    automatic = switch in {"AUTO", "AUT", "EXT", "PLAY and REMOTE", "automatic", "REMOTE"}
    if adapter == "ur":
        mode = {"success": True, "operational_mode": {"mode": "AUTOMATIC" if automatic else "MANUAL"}}
        known = UR | {"program": {"data": not jogged}, "operational_mode": mode}
        return {key: known[key] for key in known if key in loaded(adapter, release)[0].sources}
    if adapter == "kuka_kss":
        said = {"operation_mode": {"T1": 1, "EXT": 4}[switch], "drives_powered": True, "in_motion": moving,
                "motion_possible": not jogged}  # fmt: skip
        return {"status": {"robot_names": [""], "statuses": [said]} if release == "master" else said}
    if adapter == "kuka_fri":
        said = {"session_state": 4, "drive_state": 2, "operation_mode": {"T1": 0, "AUT": 2}[switch]}
        return {"state": {"states": [said]} if release == "master" else said}
    if adapter == "abb":
        return {"system": {"motors_on": True, "auto_mode": automatic, "rapid_running": not jogged}}
    if adapter == "fanuc":
        return {"status": {"tp_enabled": not automatic, "motion_possible": not jogged},
                "extended": {"drives_powered": True, "in_motion": moving, "gen_override": 10}}  # fmt: skip
    if adapter == "industrial":
        said = {"mode": 2 if automatic else 1, "drives_powered": 1, "motion_possible": int(not jogged),
                "in_motion": int(moving), "e_stopped": 0, "in_error": 0}  # fmt: skip
        return {"status": {key: {"val": value} for key, value in said.items()}}
    if adapter == "staubli":
        mode = {"manual": 1.0, "automatic": 2.0, "REMOTE": 3.0}[switch]
        return gpio(**SUPERVISION | {"operation_mode": mode, "in_motion": float(moving)})
    return {}


class Given:
    """Parameters of a guard: the usual ones, but for some."""

    def __init__(self, **changed: Any) -> None:
        self._values = {one.name: one.default for one in PARAMETERS} | changed

    def value(self, name: str) -> Any:
        """Return a parameter's value."""
        return self._values[name]


@pytest.fixture(scope="module")
def arm() -> Monitored:
    cell = load_cell(ROOT / "config/cells/demo.cell.yaml")
    return Monitored.of(chain_of(cell), nominal_parameters(cell), tool_point(cell))


@pytest.mark.parametrize(("adapter", "backend", "switch", "needs", "release"), CASES)
def test_a_route_reaches_the_permission_and_keeps_it(
    arm: Monitored, adapter: str, backend: str, switch: str, needs: str, release: str
) -> None:
    """The robot stands, moves from 6 to 11 s and stands again, while its driver says so as late as it may."""
    table, vendored = loaded(adapter, release) if release else (load_adapter(adapter), None)
    declared, asked = "limit" in needs, "confirmation" in needs
    period, given = SLOW_JOINTS.get((adapter, backend), (0.01, {}))
    modes = re.findall("AUTOMATIC|EXTERNAL", needs) or ["MANUAL_REDUCED"]
    cell = load_cell(ROOT / "config/cells/demo.cell.yaml")
    safety = Safety(speed_limit=0.25, source="checksum 8A3F") if declared else None
    rules = guard_rules(Given(allowed_modes=modes, **given), cell.model_copy(update={"safety": safety}), table)
    stop = RequestedStop.NONE if backend == "external" else RequestedStop.CANCEL
    guard = Guard(arm, rules, stop)
    guard.proof.proven = True  # which has tests of its own
    word: Confirmation | None = None
    received: dict[str, Received] = {}
    heard = measured = -math.inf
    q, late = np.zeros(6), LAGS.get(adapter, 0.0)
    against: set[Reason] = set()
    for i in range(800):
        now = 1.0 + 0.02 * i
        moving = 6.0 < now < 11.0
        q = q + (4e-4 if moving else 0.0)
        if now >= heard + PERIODS.get(adapter, 0.02) - 1e-9:
            heard = now
            said = messages(adapter, release, switch, jogged=backend == "external", moving=6.0 < now < 11.0 + late)
            for key, values in said.items():
                assert vendored is not None
                received[key] = Received(vendored.make(table.sources[key].kind, values), round(now * NANOSECONDS))
        report = assemble(table, received, round(now * NANOSECONDS))
        if word is None and asked and report.status.operating_mode in CONFIRMABLE and i == 10:
            mode = OperatingMode[modes[0]]
            word = checked("A. Smith", int(mode), 3600.0, report.status.operating_mode, now)
        if word is not None:
            word = word.after(report.status, now)
        report = confirmed(report, word, now)
        if report.received_time and (table.awaited or word is not None):
            guard.on_status(report.status, report.received_time / NANOSECONDS, report.max_age, report.first)
        if needs.partition(":")[0] != NOBODY and now >= measured + period - 1e-9:
            measured = now
            guard.on_joints(q, now, now)
        decision = guard.decide(now)
        if i > 30:
            against |= set(decision.reasons)
    expected = {Reason.JOINTS_ABSENT} if needs.startswith(NOBODY) else set()
    assert against == expected, decision.text
    assert not decision.latched


def test_the_page_has_routes_for_every_driver_and_says_what_each_needs() -> None:
    assert {adapter for adapter, *_ in ROUTES} == set(NAMES) - {"native", GENERIC}
    kinds = rf"nothing|confirmation|limit, (AUTOMATIC|EXTERNAL)(, and a confirmation before 3\.8\.0)?|{NOBODY}: .*"
    assert [needs for *_, needs in ROUTES if not re.fullmatch(kinds, needs)] == []
