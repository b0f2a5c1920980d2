"""What `calibration fleet` writes and says."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from typing import Any

from calibration_core.fleet.next_robot.population_file import population_text
from calibration_core.fleet.plant import CONSPICUOUS, Plant
from calibration_core.fleet.proposals import Proposal, proposals
from calibration_core.fleet.recordings.rows import Row
from calibration_core.fleet.tables import table_files
from calibration_core.report.results.provenance import software
from calibration_core.report.results.result import SCHEMA, plain, result_json
from calibration_core.report.rounding import counted
from calibration_core.report.writing.output import RESULT, Content

POPULATION = "population.yaml"
SHOWN = 5  # robots and failures named in the summary


def fleet_files(plant: Plant, rows: Sequence[Row], source: str, *, report: bool) -> dict[str, Content]:
    """Return all files but the data set: file name -> content."""
    proposed = proposals(plant)
    result = result_json(fleet_result(plant, rows, source, proposed))
    digest = data_set_digest(rows)
    files: dict[str, Content] = {RESULT: result, POPULATION: population_text(plant, source, digest).encode()}
    files |= table_files(plant)
    if report:
        from calibration_core.commands.fleet.fleet_document import fleet_report

        files |= fleet_report(plant, rows, source, proposed, result)
    return files


def data_set_digest(rows: Sequence[Row]) -> str:
    """Return the SHA-256 over the keys of all results, in the order of their recordings."""
    return hashlib.sha256("\n".join(row.key for row in rows).encode()).hexdigest()


def fleet_result(plant: Plant, rows: Sequence[Row], source: str, proposed: Sequence[Proposal]) -> dict[str, Any]:
    """Return the content of result.json."""
    robots = [
        {
            "type": robot.type, "robot": robot.robot, "state": robot.state, "score": robot.score,
            "reasons": [{"text": one.text, "score": one.score, "kind": one.kind} for one in robot.reasons],
            "measurements": len(robot.dates), "failures": robot.failures, "last_failure": robot.last_failure,
        }
        for robot in plant.robots
    ]  # fmt: skip
    types = {
        kind: {
            "robots": sum(robot.type == kind for robot in plant.robots),
            "conspicuous": sum(robot.type == kind and robot.state == CONSPICUOUS for robot in plant.robots),
            "effects": dict(plant.effects.get(kind, {})),
        }
        for kind in plant.types
    }
    content = {
        "schema": SCHEMA,
        "command": "fleet",
        "source": source,
        "recordings": {"all": plant.rows, "failed": plant.failed, "data_set": data_set_digest(rows)},
        "types": types,
        "robots": robots,
        "failures": [
            {"recording": row.recording, "error": row.error or row.reason}
            for row in rows
            if not row.measured or row.usable == "no"
        ],
        "next_measurements": [{"type": one.type, "robot": one.robot, "why": one.why} for one in proposed],
        "summary": fleet_summary(plant, proposed),
        "software": software(),
    }
    return {key: plain(value) for key, value in content.items()}


def fleet_summary(plant: Plant, proposed: Sequence[Proposal]) -> list[str]:
    """Return what came out, a few lines; arguments as for `fleet_result`."""
    states = Counter(robot.state for robot in plant.robots)
    lines = [
        f"{counted(plant.rows, 'recording')}, {plant.failed} of them not usable",
        f"{counted(len(plant.robots), 'robot')} of {counted(len(plant.types), 'type')}",
        f"{counted(states[CONSPICUOUS], 'robot')} conspicuous",
    ]
    lines += [
        f"  {robot.type} {robot.robot}: {robot.reasons[0].text}" for robot in plant.robots[:SHOWN] if robot.reasons
    ]
    if plant.failed:
        return [*lines, "next: put right the recordings that are not usable (failures), then run fleet again"]
    return [*lines, *(f"next: measure {one.type} {one.robot}: {one.why}" for one in proposed[:1])]
