"""`calibration fleet`: every recording of a plant, in parallel, and what they say together."""

from __future__ import annotations

import argparse
import functools
from collections.abc import Sequence
from pathlib import Path

from calibration_core.commands.shared.common import report_line, report_progress
from calibration_core.engine.cluster import INSTALL, Cluster, connected, dashboard_of, default_jobs, require
from calibration_core.engine.command_line import refuse_without_effect
from calibration_core.engine.pieces import run_all
from calibration_core.errors import InputError, quoted
from calibration_core.fleet.recordings.manifest import Entry, read_entries
from calibration_core.fleet.recordings.rows import Row, failed
from calibration_core.fleet.recordings.store import DATASET, claimed, keep, kept, write_dataset
from calibration_core.fleet.recordings.task import VERSION, EvaluatedRecording, measure
from calibration_core.report.rounding import counted
from calibration_core.report.writing.output import Content, write_files

MEASURING = 0.9  # share of the time that the recordings take
SHOWN = 10  # robots that an error names
STAGES = 20  # lines of progress that are printed of the recordings


def run(arguments: argparse.Namespace) -> str:
    """Evaluate what is not done yet, write data set, tables and report, and return a summary.

    Raises:
        InputError: The manifest cannot be used, Dask is not installed, the cluster does not answer, or the output
            cannot be written.
    """
    _refuse_idle(arguments)
    require_installed()
    entries = read_entries(arguments.recording)
    _refuse_unknown(arguments.alone, entries)
    cluster = Cluster(arguments.cluster, arguments.jobs or default_jobs(), arguments.tls)
    with claimed(arguments.out):
        rows, evaluated = measured(entries, arguments, cluster)
        report_progress(arguments, MEASURING, "comparing the robots")
        from calibration_core.commands.fleet.results import fleet_files, fleet_summary
        from calibration_core.fleet.plant import evaluate_plant
        from calibration_core.fleet.proposals import proposals

        plant = evaluate_plant(rows, arguments.alone)
        files: dict[str, Content] = {DATASET: functools.partial(write_dataset, rows)}
        files |= fleet_files(plant, rows, str(arguments.recording), report=arguments.report)
        write_files(arguments.out, files)
    lines = fleet_summary(plant, proposals(plant))
    if "--jobs" in arguments.stated and arguments.jobs > evaluated:
        beyond = f" beyond that of --jobs {evaluated}" if evaluated else ""
        few = counted(evaluated, "recording") if evaluated else "no recording"
        lines.append(f"--jobs {arguments.jobs} had no effect{beyond}: {few} had to be evaluated")
    return "\n".join([*lines, report_line(arguments)])


def _refuse_idle(arguments: argparse.Namespace) -> None:
    """Refuse stated options that have no effect where the work is done."""
    if arguments.cluster:
        where = "on a cluster, which has its own workers"
        refuse_without_effect(arguments.stated, "fleet", ("--jobs",), where, "no --cluster")
    else:
        refuse_without_effect(arguments.stated, "fleet", ("--tls",), "without --cluster", "--cluster ADDRESS")


def _refuse_unknown(robots: Sequence[str], entries: Sequence[Entry]) -> None:
    """Refuse robots that no recording is of."""
    known = sorted({entry.robot for entry in entries})
    for robot in robots:
        if robot not in known:
            named = ", ".join(known[:SHOWN]) + (", ..." if len(known) > SHOWN else "")
            raise InputError("fleet", "--alone", quoted(robot), f"a robot of the manifest: {named}")


def require_installed() -> None:
    """Refuse where the packages of a fleet are missing.

    Raises:
        InputError: They are.
    """
    require("calibration fleet")
    try:
        import pyarrow as pa  # noqa: F401
    except ImportError as error:
        raise InputError("calibration fleet", "", f"no package {error.name}", INSTALL) from None


def measured(entries: Sequence[Entry], arguments: argparse.Namespace, cluster: Cluster) -> tuple[list[Row], int]:
    """Return one row per recording, sorted by recording, and how many of them were evaluated now.

    What is done and unchanged is not done again.

    Raises:
        InputError: The cluster does not answer or has gone, or a result cannot be written.
    """
    out: Path = arguments.out
    rows: dict[str, Row] = {}
    open_: dict[str, Entry] = {}
    for entry in entries:
        row = kept(out, entry, VERSION)
        if row is None:
            open_[entry.recording] = entry
        else:
            rows[entry.recording] = row
    _note_what_stays(arguments, len(rows), len(entries))
    if open_:
        report_progress(arguments, 0.0, "starting the workers" if not cluster.address else f"asking {cluster.address}")
        with connected(cluster) as client:
            link = dashboard_of(client, cluster.address)
            for done in run_all(client, measure, open_):
                entry = open_[str(done.key)]
                outcome = done.value or EvaluatedRecording(failed(entry, f"{entry.recording}: {done.error}"), b"")
                keep(out, entry, outcome.row, outcome.result)
                rows[entry.recording] = outcome.row
                _note_what_stays(arguments, len(rows), len(entries))
                if len(rows) * STAGES // len(entries) > (len(rows) - 1) * STAGES // len(entries):
                    text = f"recording {len(rows)} of {len(entries)}{f', dashboard {link}' if link else ''}"
                    report_progress(arguments, MEASURING * len(rows) / len(entries), text)
    return [rows[name] for name in sorted(rows)], len(open_)


def _note_what_stays(arguments: argparse.Namespace, done: int, of: int) -> None:
    """Note what is said of the results when the run is ended before its time."""
    arguments.stays = f"{done} of {of} recordings are done and stay; the same command goes on with the others"
