"""`calibration-sim`: records a measurement of a simulated cell.  Arguments only."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from calibration_core.cell import load_cell
from calibration_core.engine.command_line import (
    OneLineParser,
    path,
    refuse_without_effect,
    stated_options,
    whole,
)
from calibration_core.errors import EquilibriumError, InputError
from calibration_core.recording.bags.writer import write_bag
from calibration_core.recording.tables.table import write_table
from calibration_sim.cell.configurations import random_protocol
from calibration_sim.cell.protocol import read_plan
from calibration_sim.cell.streams import simulate_recording
from calibration_sim.cell.table import simulate_readings
from calibration_sim.cell.truth import ROUGH, WORKSHOP, draw_truth, write_truth
from calibration_sim.writing import refuse_existing, write_all

UNUSABLE_INPUT = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; return 0, or 2 with one line on stderr where the input cannot be used."""
    parser = _parser()
    options = parser.parse_args(arguments)
    options.stated = stated_options(parser, arguments)
    if options.action is _record and options.storage == "sqlite3" and options.compression == "lz4":
        parser.error("--compression lz4 exists for mcap alone")
    try:
        options.action(options)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return UNUSABLE_INPUT
    return 0


def _record(options: argparse.Namespace) -> None:
    if options.plan is not None:
        needed = "a recording without --plan"
        refuse_without_effect(options.stated, "calibration-sim record", ("--configurations",), "with --plan", needed)
    refuse_existing(options.out, options.table, options.truth_out)
    cell = load_cell(options.cell)
    truth = draw_truth(cell, options.seed, spread=WORKSHOP if options.imperfect else ROUGH)
    if options.plan is None:
        protocol = random_protocol(cell, options.configurations, options.seed)
    else:
        protocol = read_plan(options.plan, cell)
    with _blaming(options.plan or options.cell, "a load within the robot's capacity, in N and N·m"):
        recording = simulate_recording(cell, truth, protocol, options.seed, markers=not options.no_markers)
        readings = None if options.table is None else simulate_readings(cell, truth, protocol, options.seed)
    storage, compression = options.storage, _compression(options)
    write_all(
        (options.out, lambda path: write_bag(path, recording, cell, storage=storage, compression=compression)),
        (options.table, lambda path: None if readings is None else write_table(path, readings)),
        (options.truth_out, lambda path: write_truth(path, truth, cell, seed=options.seed)),
    )
    count, steps = len(protocol.configurations), protocol.steps
    messages = sum(recording.provenance.messages.values())
    sys.stdout.write(f"{options.out}: {count} configurations, {steps} steps, {messages} messages\n")


@contextlib.contextmanager
def _blaming(source: str | Path, expected: str) -> Iterator[None]:
    """Name what asked for a load that no joint can carry."""
    try:
        yield
    except EquilibriumError as error:
        raise InputError(source, "", str(error), expected) from None


def _compression(options: argparse.Namespace) -> str | None:
    """Return the writer's name of the compression: chunks of mcap, whole files of sqlite3."""
    if options.storage == "sqlite3" and options.compression == "zstd":
        return "zstd_file"
    return None if options.compression is None else str(options.compression)


def _parser() -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = OneLineParser(prog="calibration-sim", description="A simulated measurement cell.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    record = commands.add_parser(
        "record", help="record a measurement of a simulated cell", description="Writes a rosbag2 directory."
    )
    record.add_argument("--cell", type=path, required=True, help="cell file (YAML)")
    record.add_argument("--out", type=path, required=True, help="directory to write, must not exist yet")
    record.add_argument("--plan", type=path, help="plan.yaml; default: random configurations, oblique pulls")
    record.add_argument("--configurations", type=whole(1), default=18, help="how many, without a plan (default 18)")
    record.add_argument("--seed", type=whole(0), default=0, help="of truth, configurations and noise (default 0)")
    record.add_argument("--storage", choices=("mcap", "sqlite3"), default="mcap")
    record.add_argument("--compression", choices=("zstd", "lz4"))
    record.add_argument("--no-markers", action="store_true", help="leave out the step markers")
    record.add_argument("--imperfect", action="store_true", help="frames, points and geometry differ from the cell's")
    record.add_argument("--table", type=path, metavar="FILE.csv", help="write a measurement table besides")
    record.add_argument("--truth-out", type=path, metavar="FILE.yaml", help="write down what is hidden")
    record.set_defaults(action=_record)
    return parser


if __name__ == "__main__":
    sys.exit(main())
