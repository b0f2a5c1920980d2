"""The whole cell in one message, put together from what the nodes say."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from calibration_interfaces.msg import NodeHealth, ProcedureState, SampleCheck, State

from calibration.cell.permission import SILENT
from calibration.health import FRESH, LEASE
from calibration.status.faults import MISSED, faults

FOREIGN = 10.0  # s, for which a reading of another session is told


class Whole:
    """What was heard last of everything, and the message that it makes; times are s of the steady clock."""

    def __init__(self, names: tuple[str, ...], permission_age: float) -> None:
        """Begin with nothing heard.

        Args:
            names: Of the nodes, in their order.
            permission_age: s, that the guard's last word counts.
        """
        self._age = permission_age
        self._state = State(procedure=ProcedureState(seconds_left=math.nan, averaged=math.nan))
        self._streams: dict[tuple[str, str], SampleCheck] = {}
        self.health = {name: NodeHealth(name=name, level=NodeHealth.ABSENT) for name in names}
        self._heard = dict.fromkeys(names, -math.inf)
        self._looked = -math.inf
        self._permission_heard = -math.inf
        self._procedure_heard = False
        self._foreign = (-math.inf, "")

    def hear(self, field: str, message: Any, now: float) -> None:
        """Take a message that one field of the state shows as it came."""
        setattr(self._state, field, message)
        if field == "permission":
            self._permission_heard = now
        elif field == "procedure":
            self._procedure_heard = True

    def hear_reading(self, message: Any, now: float) -> None:
        """Take notice of a reading that is not of the session under way."""
        own, procedure = str(message.session).rpartition("@")[0], self._state.procedure
        if self._procedure_heard and own != (str(Path(procedure.session).absolute()) if procedure.session else ""):
            self._foreign = (now, str(message.session) or "no session")

    def hear_stream(self, message: SampleCheck) -> None:
        """Take the health of one stream."""
        self._streams[(str(message.topic), str(message.name))] = message

    def hear_node(self, message: NodeHealth, now: float) -> bool:
        """Take a node's sign of life; return whether it is news: it was not heard before, or was started again."""
        before = self.health.get(message.name)
        if before is None:
            return False
        self.health[message.name], self._heard[message.name] = message, now
        return before.level >= NodeHealth.ABSENT or before.identifier != message.identifier

    def silent(self, now: float) -> list[str]:
        """Return the nodes that fell silent since the last look; to be called several times within a lease.

        Whoever did not look for longer was too busy itself to hear them, and hears them first.
        """
        looked, self._looked = self._looked, now
        if now - looked > 0.5 * LEASE:
            return []
        late = [one for one in self.health.values() if one.level < NodeHealth.ABSENT]
        late = [one for one in late if now - self._heard[one.name] > LEASE]
        for one in late:
            one.level, one.text = NodeHealth.SILENT, f"silent: {MISSED.get(one.name, '')}"
        return [one.name for one in late]

    def message(self, now: float) -> State:
        """Return the state of the cell at `now`; a new run of the sequencer's process makes no old words true."""
        state = self._state
        for name, health in self.health.items():
            health.age = now - self._heard[name] if self._heard[name] > -math.inf else math.nan
        state.nodes = list(self.health.values())
        sequencer = self.health.get("sequencer")
        known = sequencer is not None and sequencer.level < NodeHealth.ABSENT and sequencer.age <= FRESH
        state.procedure_known = known and self._procedure_heard
        state.permission_known = now - self._permission_heard <= self._age
        state.streams = sorted(self._streams.values(), key=lambda one: (one.topic, one.name))
        if not state.permission_known:
            state.not_permitted = SILENT
        else:
            state.not_permitted = "" if state.permission.permitted else str(state.permission.text)
        procedure = state.procedure
        state.text, state.waiting = str(procedure.text), str(procedure.waiting)
        if not state.procedure_known:
            last = f"; it said last: {procedure.text}" if procedure.text else ""
            state.text, state.waiting = f"the sequencer is not heard{last}", "operator: start the sequencer again"
        elif procedure.waits_for == ProcedureState.GUARD and state.not_permitted:
            state.waiting = f"{procedure.waiting}: {state.not_permitted}"
        foreign = self._foreign[1] if now - self._foreign[0] <= FOREIGN else ""
        state.faults = faults(state, foreign)
        return state

    def news(self, state: State) -> dict[str, object]:
        """Return what of a state is worth a message at once; the rest of it changes all the time."""
        procedure, permission = state.procedure, state.permission
        felt = (procedure.load_felt_known, repr(procedure.load_felt), procedure.load_fault)
        return {
            "words": (state.text, state.waiting, state.not_permitted),
            "procedure": (procedure.state, procedure.moving, procedure.paused, procedure.configuration, procedure.step),
            "reading": (procedure.reading_verdict, procedure.reading_configuration, procedure.reading_step),
            "known": (state.procedure_known, state.permission_known),
            "permission": (permission.permitted, permission.latched, tuple(permission.reasons)),
            "fresh": [one.age <= FRESH for one in state.nodes],
            "nodes": [(one.identifier, one.level, one.text) for one in state.nodes],
            "faults": [(one.code, one.source, one.text) for one in state.faults],
            "streams": [(one.name, one.problem) for one in state.streams],
            "progress": state.progress.configuration,
            "conditions": [(one.name, one.verdict, one.override.operator_name) for one in state.conditions.conditions],
            "averaged": repr(procedure.averaged),
            "felt": felt if procedure.load_awaited else None,
        }
