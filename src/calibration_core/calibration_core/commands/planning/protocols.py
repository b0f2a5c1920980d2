"""The protocol chooser: what each way of loading costs and reveals, for result and report of a plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.proposals.choose import Offer
from calibration_core.diagnosis.proposals.protocol import PROTOCOLS, Pace, Worth, worth_of
from calibration_core.model.effects.words import effect_words
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.planning.plans.measurement_queue import SequenceRules
from calibration_core.planning.plans.plan import Plan
from calibration_core.report.document import Column, Paragraph, Section, Table
from calibration_core.report.rounding import DASH, spread


def judged_protocols(plan: Plan, cell: Cell, parameters: ModelParameters) -> tuple[Worth, ...]:
    """Judge every protocol on the configurations of a plan; none where stiffness or loads are not known."""
    loaded = all(np.any(c.steps) for c in plan.primary) and cell.instruments.force_torque is not None
    if not loaded or np.any(parameters.compliance <= 0) or plan.expected is None:
        return ()
    rules = SequenceRules()
    moving = plan.expected.duration.get("moving", 0.0) / max(len(plan.primary), 1)
    pace = Pace(moving or Pace.moving, rules.load_seconds, rules.reading_seconds)
    pulls = [Offer(c.number, c.q, c.steps) for c in plan.primary]
    reference = plan.primary[0].q if plan.reference is None else plan.reference.q
    chain = chain_of(cell).corrected(parameters.geometry)
    return tuple(worth_of(one, pulls, reference, cell, chain, parameters, pace) for one in PROTOCOLS)


def protocols_result(judged: Sequence[Worth]) -> list[dict[str, Any]]:
    """Return the protocols as a part of result.json: minutes, evidence in nats, relative standard deviations."""
    return [
        {
            "name": one.protocol.name,
            "levels": list(one.protocol.levels),
            "hold": one.protocol.hold,
            "held": one.protocol.held,
            "reference_every": one.protocol.every,
            "minutes": one.minutes,
            "stiffness_std": one.stiffness_std.tolist(),
            "evidence": dict(one.evidence),
            "told_apart": dict(one.apart),
            "shown": list(one.shown),
            "told": list(one.distinguished),
        }
        for one in judged
    ]


def protocols_section(judged: Sequence[Worth]) -> tuple[Section, ...]:
    """Return the section of the report; none without a judgement."""
    if not judged:
        return ()
    base = judged[0]
    rows = []
    for one in judged:
        new = [effect for effect in one.distinguished if effect not in base.distinguished] if one is not base else []
        rows.append(
            (
                one.protocol.name,
                one.protocol.text,
                f"{one.minutes:.0f}",
                DASH if one is base else f"{one.minutes - base.minutes:+z.0f}",
                spread(100 * float(one.stiffness_std.max())),
                f"{len(one.shown)} / {len(one.distinguished)}",
                ", ".join(effect_words(effect) for effect in new) or DASH,
                _sharper(one, base),
            )
        )
    columns = (
        Column("Protocol", "left"),
        Column("Besides loading", "left", wide=True),
        Column("Minutes"),
        Column("More"),
        Column("Worst stiffness [%]"),
        Column("Effects shown / named"),
        Column("Distinguished only with it", "left", wide=True),
        Column("Distinguished most sharply (times)", "left", wide=True),
    )
    text = (
        "What each way of loading costs, and which of the effects that are usually left out it shows: how many effects "
        "of the catalogue, at their typical size, are expected to show beside the joint springs, and how many to be "
        "distinguished from every other effect (odds above 150 to 1 each). Worst stiffness: expected relative "
        "standard uncertainty, with the unknowns of sensor and geometry free. To hold, confirm the load late."
    )
    blocks = (Paragraph(text), Table("Protocols", columns, tuple(rows)))
    return (Section("What other load steps would show", "7.6", blocks),)


def _sharper(one: Worth, base: Worth) -> str:
    """Name the effects that a protocol tells at least twice as sharply as plain loading, the sharpest three."""
    gain = {
        effect: one.apart[effect] / max(base.apart[effect], 1.0)
        for effect in one.distinguished
        if effect in base.apart and one.apart[effect] >= 2 * base.apart[effect]
    }
    best = sorted(gain, key=lambda effect: -gain[effect])[:3]
    return ", ".join(f"{effect_words(effect)} {gain[effect]:.0f}" for effect in best) or DASH
