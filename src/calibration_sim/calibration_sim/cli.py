"""`calibration-sim`: records a measurement of a simulated cell.  Arguments only."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from calibration_core.cell import load_cell
from calibration_core.errors import InputError, RecordingError
from calibration_core.recording.bags.writer import write_bag
from calibration_core.recording.tables.table import write_table
from calibration_sim.cell.configurations import random_protocol
from calibration_sim.cell.protocol import read_plan
from calibration_sim.cell.streams import simulate_recording
from calibration_sim.cell.table import simulate_readings
from calibration_sim.cell.truth import ROUGH, WORKSHOP, draw_truth, write_truth
from calibration_sim.plant import DAYS, plant, write_plant

UNUSABLE_INPUT = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; return 0, or 2 with one line on stderr where the input cannot be used."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.action is _record and options.storage == "sqlite3" and options.compression == "lz4":
        parser.error("--compression lz4 exists for mcap alone")
    try:
        options.action(options)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return UNUSABLE_INPUT
    return 0


def _record(options: argparse.Namespace) -> None:
    for path in (options.out, options.table, options.truth_out):
        if path is not None and path.exists():
            raise RecordingError(path, "", "something", "a path that does not exist yet")
    cell = load_cell(options.cell)
    truth = draw_truth(cell, options.seed, spread=WORKSHOP if options.imperfect else ROUGH)
    if options.plan is None:
        protocol = random_protocol(cell, options.configurations, options.seed)
    else:
        protocol = read_plan(options.plan, cell)
    recording = simulate_recording(cell, truth, protocol, options.seed, markers=not options.no_markers)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_bag(options.out, recording, cell, storage=options.storage, compression=_compression(options))
    if options.table is not None:
        options.table.parent.mkdir(parents=True, exist_ok=True)
        write_table(options.table, simulate_readings(cell, truth, protocol, options.seed))
    if options.truth_out is not None:
        options.truth_out.parent.mkdir(parents=True, exist_ok=True)
        write_truth(options.truth_out, truth, cell, seed=options.seed)
    count, steps = len(protocol.configurations), protocol.steps
    messages = sum(recording.provenance.messages.values())
    sys.stdout.write(f"{options.out}: {count} configurations, {steps} steps, {messages} messages\n")


def _compression(options: argparse.Namespace) -> str | None:
    """Return the writer's name of the compression: chunks of mcap, whole files of sqlite3."""
    if options.storage == "sqlite3" and options.compression == "zstd":
        return "zstd_file"
    return None if options.compression is None else str(options.compression)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="calibration-sim", description="A simulated measurement cell.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _plant_arguments(commands)
    record = commands.add_parser(
        "record", help="record a measurement of a simulated cell", description="Writes a rosbag2 directory."
    )
    record.add_argument("--cell", type=Path, required=True, help="cell file (YAML)")
    record.add_argument("--out", type=Path, required=True, help="directory to write, must not exist yet")
    record.add_argument("--plan", type=Path, help="plan.yaml; default: random configurations, oblique pulls")
    record.add_argument("--configurations", type=_positive, default=18, help="how many, without a plan (default 18)")
    record.add_argument("--seed", type=_natural, default=0, help="of truth, configurations and noise (default 0)")
    record.add_argument("--storage", choices=("mcap", "sqlite3"), default="mcap")
    record.add_argument("--compression", choices=("zstd", "lz4"))
    record.add_argument("--no-markers", action="store_true", help="leave out the step markers")
    record.add_argument("--imperfect", action="store_true", help="frames, points and geometry differ from the cell's")
    record.add_argument("--table", type=Path, metavar="FILE.csv", help="write a measurement table besides")
    record.add_argument("--truth-out", type=Path, metavar="FILE.yaml", help="write down what is hidden")
    record.set_defaults(action=_record)
    return parser


def _plant_arguments(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "plant", help="measure the robots of a simulated plant", description="Writes plant.csv for calibration fleet."
    )
    parser.add_argument("--out", type=Path, required=True, help="directory to write, must not exist yet")
    parser.add_argument("--robots", type=_positive, default=600, help="how many, of six types (default 600)")
    parser.add_argument("--dates", type=_positive, choices=range(1, len(DAYS) + 1), default=3, metavar="N",
                        help="how many, half a year apart (default 3)")  # fmt: skip
    parser.add_argument("--spread", type=float, default=0.03, help="between sisters, of ln stiffness (default 0.03)")
    parser.add_argument("--seed", type=_natural, default=0, help="of everything (default 0)")
    parser.add_argument("--jobs", type=_positive, default=1, help="processes (default 1)")
    parser.set_defaults(action=_plant)


def _plant(options: argparse.Namespace) -> None:
    if options.out.exists():
        raise RecordingError(options.out, "", "something", "a path that does not exist yet")
    recordings = plant(options.seed, options.robots, options.dates, options.spread)
    manifest = write_plant(recordings, options.out, options.jobs)
    sys.stdout.write(f"{manifest}: {len(recordings)} recordings of {options.robots} robots\n")


def _natural(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text}, expected an integer of at least zero")
    return value


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text}, expected an integer of at least one")
    return value


if __name__ == "__main__":
    sys.exit(main())
