"""Takes what `make prove` and `make bench` have written into the record that the validation table is made from.

.venv/bin/python src/calibration_core/doc/site/collect.py
"""

from __future__ import annotations

import datetime as dt
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[4]
RECORD = Path(__file__).resolve().parents[1] / "validation"
COMMANDS = {"second": "calibration-prove --kinds all --seed {seed}", "": "calibration-prove --seed {seed}"}


def collect(build: Path, record: Path) -> list[Path]:
    """Copy tables and runs from a build folder into the record; return what was written."""
    written = []
    for path in sorted((build / "prove").glob("*/table.json")):
        content: dict[str, Any] = json.loads(path.read_text("utf-8"))
        kind = "second" if path.parent.name.endswith("-second") else ""
        day = dt.datetime.fromtimestamp(path.stat().st_mtime, dt.UTC)
        kept = {key: content[key] for key in ("seed", "labels", "recordings", "measures")}
        command = COMMANDS[kind].format(seed=content["seed"])
        kept |= {"command": command, "date": f"{day:%Y-%m-%d}", "commit": commit()}
        written.append(record / f"prove{'-' if kind else ''}{kind}.json")
        written[-1].write_text(json.dumps(kept, indent=1) + "\n", "utf-8")
    runs = build / "bench" / "runs.json"
    if runs.is_file():
        written.append(record / "bench.json")
        written[-1].write_text(runs.read_text("utf-8"), "utf-8")
    return written


def commit() -> str:
    """Return the commit that is checked out, short; empty outside a checkout."""
    answer = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return answer.stdout.strip()


if __name__ == "__main__":
    found = collect(ROOT / "build", RECORD)
    sys.stdout.write(
        "".join(f"{path.relative_to(ROOT)}\n" for path in found) or "nothing in build: run make prove, bench\n"
    )
