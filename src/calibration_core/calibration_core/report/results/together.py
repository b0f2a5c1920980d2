"""Several recordings in result.json: what each contributed, and whether they agree."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calibration_core.identification.result.estimate import Contribution, Together


def together_dict(together: Together) -> dict[str, Any]:
    """Return the keys of several recordings: the first, all of them, and what differs between them."""
    records = [contribution_record(one) for one in together.contributions]
    return {
        "recording": records[0],
        "recordings": records,
        "agreement": {
            "agree": not together.disagreements if together.compared else None,
            "compared": list(together.compared),
            "differences": [vars(one) for one in together.disagreements],
            "taken_off": [vars(one) for one in together.taken_off],
        },
    }


def contribution_record(one: Contribution) -> dict[str, Any]:
    """Return one recording as result.json has it, with what it contributed."""
    pose = None if one.tracker is None else {"xyz": list(one.tracker[:3]), "rpy": list(one.tracker[3:])}
    return {
        "file": one.file,
        "configurations": one.configurations,
        "steps": one.steps,
        "points": list(one.points),
        "loaded": one.kind == "loaded",
        "readings": one.readings,
        "number": one.number,
        "numbered_from": one.first_number,
        "cell": one.cell,
        "excluded": one.excluded,
        "noise": one.noise,
        "noise_factor": one.scale,
        "rms_after": one.rms,
        "tracker": pose,
        "stiffness": [{"joint": joint, "value": v, "std": s} for joint, (v, s) in one.stiffness.items()],
    }


def cell_digests(together: Together) -> dict[str, Mapping[str, str]]:
    """Return the cell files of further recordings: role -> file -> SHA-256; empty where all share the first's."""
    first = together.contributions[0]
    others = {one.cell: one.cell_sha256 for one in together.contributions if one.cell_sha256 != first.cell_sha256}
    return {"cell": others} if others else {}
