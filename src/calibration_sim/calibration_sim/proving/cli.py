"""`calibration-prove`: conceals effects in recordings, has them diagnosed, opens the labels, makes the table."""

from __future__ import annotations

import argparse
import dataclasses
import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from calibration_core.engine.arguments import cluster_arguments
from calibration_core.engine.cluster import Cluster, require
from calibration_core.engine.command_line import refuse_without_effect, stated_options
from calibration_core.errors import CalibrationError
from calibration_sim.proving.diagnosing import Settings
from calibration_sim.proving.measures import Case, as_table, measures, power, power_table, second_measures, wrong
from calibration_sim.proving.running import read_run, result_path, run_all
from calibration_sim.proving.scoring import score
from calibration_sim.proving.writing import open_labels, write_recordings
from calibration_sim.scenarios.grid import SECOND_KINDS, grid, sample, second_grid

ENTRY = "calibration_core.cli:main"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; return 0 whatever the table says, 2 where it cannot be made."""
    parser = _parser()
    options = parser.parse_args(arguments)
    options.stated = stated_options(parser, arguments)
    try:
        sys.stdout.write(_prove(options))
    except (CalibrationError, ValueError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


def _prove(options: argparse.Namespace) -> str:
    _refuse_idle(options)
    if not options.report:
        require("calibration-prove")
    scenarios = second_grid(options.seed) if options.kinds else grid(options.seed)
    kinds = [] if options.kinds == ["all"] else options.kinds
    chosen = sample(scenarios, options.count, [*options.only, *kinds])
    if not chosen:
        raise ValueError(f"--only {' '.join(options.only)}: found nothing of that name, expected a group or an effect")
    names, digest = write_recordings(chosen, len(scenarios), options.out, jobs=options.jobs)
    sys.stdout.write(f"SHA-256 of the labels: {digest}\n")
    sys.stdout.flush()
    if not options.report:
        run_all(names, options.out, _settings(options), Cluster(options.cluster, options.jobs, options.tls))
    labels = open_labels(options.out, digest)
    cases = []
    for name in names:
        run, path = read_run(options.out, name), result_path(options.out, name)
        done = run is not None and run.exit == 0 and path.is_file()
        outcome = score(labels[name], json.loads(path.read_text(encoding="utf-8"))) if done else None
        cases.append(Case(name, labels[name], outcome, run))
    head = f"Seed {options.seed}, {len(cases)} of {len(scenarios)} recordings, labels {digest}"
    rows = second_measures(cases) if options.kinds else measures(cases)
    text = "\n".join([head, "", *as_table(rows), "", *([] if options.kinds else power_table(cases))])
    (options.out / "table.md").write_text(text, encoding="utf-8")
    content = {
        "seed": options.seed,
        "labels": digest,
        "recordings": len(cases),
        "measures": list(map(dataclasses.asdict, rows)),
        "power": [] if options.kinds else power(cases),
        "wrong": wrong(cases),
    }
    (options.out / "table.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return text


def _refuse_idle(options: argparse.Namespace) -> None:
    """Refuse stated options that have no effect on what is asked for."""
    who = "calibration-prove"
    if options.report:
        running = ("--cluster", "--tls", "--limit", "--command", "--batch")
        refuse_without_effect(options.stated, who, running, "with --report, which runs nothing", "no --report")
    if not options.cluster:
        refuse_without_effect(options.stated, who, ("--tls",), "without --cluster", "--cluster ADDRESS")


def _settings(options: argparse.Namespace) -> Settings:
    command = tuple(shlex.split(options.command)) if options.command else ("calibration", "diagnose", "--no-report")
    return Settings(command, ENTRY if options.batch else "", options.limit)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="calibration-prove", description="Proves the diagnosis on recordings in which effects are concealed."
    )
    parser.add_argument("--seed", type=int, default=1, help="of the whole grid (default 1)")
    parser.add_argument("--out", type=Path, default=Path("build/prove"), help="directory (default build/prove)")
    parser.add_argument("--jobs", type=int, default=2, help="processes of this machine (default 2)")
    cluster_arguments(parser)
    parser.add_argument("--count", type=int, help="so many recordings, spread over the grid (default: all)")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="groups or effects alone")
    parser.add_argument(
        "--kinds",
        nargs="+",
        default=[],
        choices=["all", *SECOND_KINDS],
        metavar="KIND",
        help=f"of the second grid, instead of the first: all, or some of {', '.join(SECOND_KINDS)}",
    )
    parser.add_argument("--limit", type=float, default=120.0, help="s for one diagnosis (default 120)")
    parser.add_argument("--command", help="program to run instead of `calibration diagnose`")
    parser.add_argument("--batch", action="store_true", help="a process takes many recordings, one after another")
    parser.add_argument("--report", action="store_true", help="run nothing, make the table from what is there")
    return parser


if __name__ == "__main__":
    sys.exit(main())
