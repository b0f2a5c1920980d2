"""The command line: arguments in, core called, summary printed (contract, section 1).

How a command ends, and with which exit code, stands in `commands.outcome`.
"""

from __future__ import annotations

import argparse
import difflib
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from calibration_core import __version__
from calibration_core.commands.outcome import carry_out, tolerate
from calibration_core.errors import InputError

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # more threads cost time on these small problems


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return the exit code."""
    tolerate(sys.stdout, sys.stderr)
    options = parse(arguments)

    def action() -> str:
        from calibration_core import commands  # imported late: `--help` needs no numerics
        from calibration_core.commands.display import display_of

        with display_of(options) as display:
            options.tell = display.tell
            summary = commands.command(options.command)(options)
        if options.json:
            return commands.result_of(options)
        return "" if options.quiet else summary

    source = options.recording or getattr(options, "plan", None) or options.cell or options.command
    return carry_out(options.command, source, options.out, action)


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the options of one command; end the process if the arguments make no sense."""
    options = _parser().parse_args(arguments)
    options.out = options.out or Path("build/calibration") / options.command
    return options


def _output(parser: argparse.ArgumentParser) -> None:
    group = parser.add_mutually_exclusive_group()
    group.add_argument("-q", "--quiet", action="store_true", help="print nothing but errors")
    group.add_argument("--json", action="store_true", help="print result.json instead of the summary")


class _Parser(argparse.ArgumentParser):
    """Says in one line what is wrong with the arguments."""

    def error(self, message: str) -> NoReturn:
        message = _with_suggestion(message)
        self.exit(2, f"{InputError(self.prog, '', message, f'arguments as in {self.prog} --help')}\n")


def _with_suggestion(message: str) -> str:
    """Add the nearest choice to what argparse says of a wrong one."""
    wrong = re.search(r"invalid choice: '([^']*)' \(choose from (.*)\)", message)
    if wrong is None:
        return message
    near = difflib.get_close_matches(wrong.group(1), re.findall(r"[\w-]+", wrong.group(2)), n=1)
    return f"{message}: did you mean {near[0]}?" if near else message


def _parser() -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = _Parser(
        prog="calibration", description="Elastostatic compliance calibration of industrial robots (CWA 17384)."
    )
    parser.add_argument("--version", action="version", version=f"calibration {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _plan(_command(commands, "plan", "choose measurement configurations (Table 1 of the standard)"))
    _simulate(_command(commands, "simulate", "write a recording as the cell's model predicts it"))
    _identify(_command(commands, "identify", "joint stiffness, frames and geometry from a recording"))
    _diagnose(_command(commands, "diagnose", "where simulation and recording differ, and which physics is left out"))
    _predict(_command(commands, "predict", "predicted points and residuals of a recording"))
    _import(_bare(commands, "import", "tables of tracker software and controllers into a measurement table"))
    _describe(commands)
    return parser


def _describe(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    text = "what a result says, in words"
    parser = commands.add_parser("describe", help=text, description=text[0].upper() + text[1:] + ".")
    parser.add_argument("result", type=Path, metavar="RESULT", help="a result.json, or the directory that holds it")
    _output(parser)
    parser.set_defaults(recording=None, cell=None, out=None)


def _bare(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], name: str, text: str
) -> argparse.ArgumentParser:
    """Add a command that needs no cell file."""
    parser = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    parser.add_argument("--out", type=Path, metavar="DIR", help=f"where results go (default build/calibration/{name})")
    _output(parser)
    parser.set_defaults(recording=None, cell=None)
    return parser


def _command(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], name: str, text: str
) -> argparse.ArgumentParser:
    parser = _bare(commands, name, text)
    parser.add_argument("--cell", type=Path, required=True, metavar="CELL.yaml", help="the cell file")
    parser.add_argument(
        "--no-report", dest="report", action="store_false", help="result and tables only, without report.html and .pdf"
    )
    return parser


def _recording(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "recording",
        type=Path,
        metavar="RECORDING",
        help="rosbag2 directory, .mcap file, measurement table (.csv), or a session (its directory or session.db)",
    )


def _given(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--model",
        type=Path,
        metavar="MODEL.yaml",
        help="start from this model instead of the cell's; its effects are known: they are taken off the readings",
    )


def _identify(parser: argparse.ArgumentParser) -> None:
    _recording(parser)
    _given(parser)
    parser.add_argument("--test", type=Path, metavar="OTHER", help="a second recording: predicted, not fitted")
    parser.add_argument(
        "--method",
        choices=("equilibrium", "linear"),
        default="equilibrium",
        help="deformed geometry with K_CSM and gravity, or equations (6) and (7) as they stand in the standard",
    )
    parser.add_argument(
        "--weights",
        choices=("instrument", "plain"),
        default="instrument",
        help="weights from the instruments' uncertainties, or every coordinate alike",
    )
    parser.add_argument(
        "--deflections",
        choices=("points", "pose"),
        default="points",
        help="position deflections, or the full pose from three or more points",
    )
    parser.add_argument("--no-robust", action="store_true", help="use every reading, gross errors too")
    parser.add_argument(
        "--readmit",
        action="append",
        default=[],
        metavar="CONFIGURATION:STEP:POINT",
        help="use this reading after all (repeatable)",
    )


def _diagnose(parser: argparse.ArgumentParser) -> None:
    _recording(parser)
    _given(parser)
    parser.add_argument(
        "--simulation", type=Path, metavar="SIM", help="what a simulation says of the same measurement, to compare with"
    )
    parser.add_argument("--test", type=Path, metavar="OTHER", help="a second recording: predicted, not fitted")
    parser.add_argument("--no-robust", action="store_true", help="use every reading, gross errors too")


def _predict(parser: argparse.ArgumentParser) -> None:
    _recording(parser)
    parser.add_argument("--model", type=Path, required=True, metavar="MODEL.yaml", help="an identified model")


def _import(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "files",
        type=Path,
        nargs="+",
        metavar="FILES",
        help="a table with everything, or tables of points, of joint angles and of wrenches, or a robot program",
    )
    parser.add_argument(
        "--map", type=Path, metavar="MAP.yaml", help="states what is not recognised: columns, units, names"
    )


def _plan(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--configurations",
        type=int,
        default=18,
        metavar="N",
        help="configurations to measure (default 18, at least 12)",
    )
    parser.add_argument(
        "--spares",
        type=float,
        default=0.5,
        metavar="SHARE",
        help="spare configurations as a share of those to measure (default 0.5, as the standard asks for)",
    )
    parser.add_argument("--seed", type=_seed, default=0, help="seed of the search (default 0)")
    parser.add_argument(
        "--criterion",
        choices=("D", "A", "worst", "condition", "observability", "trace"),
        default="D",
        help="what makes a choice good: determinant, mean or worst variance, or one of CWA 17384, 5.4 (default D)",
    )
    parser.add_argument(
        "--for",
        dest="purpose",
        choices=("stiffness", "geometry"),
        default="stiffness",
        help="what is to be found: joint stiffnesses (default), or frames and geometry, without loads",
    )
    parser.add_argument(
        "--phases",
        action="store_true",
        help="plan also what finds base frame, geometry, wrist centre and points before (CWA 17384, 7.1 to 7.5)",
    )
    parser.add_argument(
        "--load-levels",
        type=float,
        nargs="+",
        metavar="SHARE",
        help="load steps as shares of the full pull, the first 0 (default 0 0.25 0.5 0.75 1 0.75 0.5 0.25 0)",
    )
    parser.add_argument(
        "--protocol",
        metavar="NAME",
        help="load steps by name: loading, unloading, small-steps, reversed or references (see the report of a plan)",
    )
    parser.add_argument(
        "--load-share",
        type=float,
        default=1.0,
        metavar="SHARE",
        help="full pull as a share of the rated load (default 1)",
    )
    parser.add_argument("--largest-force", type=float, metavar="N", help="range of the force/torque sensor, force")
    parser.add_argument("--largest-torque", type=float, metavar="NM", help="range of the force/torque sensor, torque")
    parser.add_argument(
        "--box",
        type=float,
        nargs=6,
        metavar=("XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX"),
        help="operating space of the measurement points in the base frame, m (default: all that can be reached)",
    )
    parser.add_argument(
        "--cube",
        type=float,
        nargs="?",
        const=0.0,
        metavar="SIDE",
        help="the operating space is a cube of ISO 9283, of this side in m (without SIDE: the largest that fits)",
    )
    parser.add_argument(
        "--task",
        type=Path,
        metavar="FILE.csv",
        help="the operating space is that of a task: columns x, y, z (m), or q1 ... (rad), or theta_1 ... (degrees)",
    )
    parser.add_argument("--model", type=Path, metavar="MODEL.yaml", help="an identified model instead of the cell's")


def _simulate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--plan", type=Path, metavar="PLAN.yaml", help="the plan; without it one is made")
    parser.add_argument(
        "--model",
        type=Path,
        metavar="MODEL.yaml",
        help="an identified or extended model, effects included, instead of the cell's",
    )
    parser.add_argument("--seed", type=_seed, help="add instrument noise from this seed (default: none)")


def _seed(text: str) -> int:
    seed = int(text)
    if seed < 0:
        raise argparse.ArgumentTypeError(f"{seed} is negative")
    return seed


if __name__ == "__main__":
    sys.exit(main())
