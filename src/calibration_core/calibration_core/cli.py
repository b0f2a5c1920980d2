"""The command line: arguments in, core called, summary printed.

How a command ends, and with which exit code, stands in `commands.outcome`.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from calibration_core import __version__
from calibration_core.commands.planning.arguments import plan_arguments
from calibration_core.commands.shared.population_arguments import population_arguments
from calibration_core.commands.terminal.outcome import NOTHING, carry_out, tolerate
from calibration_core.engine.arguments import cluster_arguments
from calibration_core.engine.command_line import EXAMPLE, OneLineParser, day, group, path, stated_options, whole

SECTIONS = {
    "First steps": ("init", "check", "import"),
    "Measuring": ("plan", "pendant", "simulate"),
    "Evaluating": ("identify", "diagnose", "predict"),
    "Judging": ("verify", "compare", "fleet"),
    "Using": ("deflect", "compensate", "export"),
    "Besides": ("describe", "completion"),
}
MODEL = "--model build/calibration/identify/model.yaml"
EXAMPLES = {
    "init": "init my_robot.urdf --rated-load 210",
    "check": "check my.cell.yaml",
    "import": "import points.txt robot.csv",
    "plan": "plan --cell my.cell.yaml --configurations 18",
    "pendant": "pendant build/calibration/plan/plan.yaml --cell my.cell.yaml --maker abb",
    "simulate": "simulate --cell my.cell.yaml --plan build/calibration/plan/plan.yaml --seed 1",
    "identify": "identify my_bag --cell my.cell.yaml",
    "diagnose": "diagnose my_bag --cell my.cell.yaml",
    "predict": f"predict other.csv --cell my.cell.yaml {MODEL}",
    "verify": f"verify other.csv --cell my.cell.yaml {MODEL} --tolerance 0.0001",
    "compare": "compare spring.csv autumn.csv --cell my.cell.yaml --dates 2026-03-02 2026-09-01",
    "fleet": "fleet plant.csv --jobs 4",
    "deflect": f'deflect --cell my.cell.yaml {MODEL} --q "0 0.5 -1 0 0.5 0" --wrench "0 0 -500 0 0 0"',
    "compensate": f"compensate task.csv --cell my.cell.yaml {MODEL}",
    "export": f"export --cell my.cell.yaml {MODEL} --format urdf",
    "describe": "describe build/calibration/identify",
    "completion": "completion bash",
}
INPUT, RESULTS = "input", "results"  # titles of groups of options
RECORDING_KINDS = "rosbag2 directory, .mcap file, measurement table (.csv), or a session (its directory or session.db)"

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # more threads cost time on these small problems


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return the exit code."""
    gc.set_threshold(50_000, 20, 20)  # to look for garbage every 700 objects takes a twentieth of a short command
    tolerate(sys.stdout, sys.stderr)
    options = parse(arguments)
    options.stays = NOTHING  # what a command has written already when it is ended before its time

    def action() -> str:
        from calibration_core import commands  # imported late: `--help` needs no numerics
        from calibration_core.commands.terminal.display import display_of

        with display_of(options) as display:
            options.report_progress = display.report_progress
            summary = commands.command(options.command)(options)
        if options.json:
            return commands.result_of(options)
        return "" if options.quiet else summary

    source = options.recording or getattr(options, "plan", None) or options.cell or options.command
    return carry_out(options.command, source, options.out, action, lambda: options.stays)


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the options of one command; end the process if the arguments make no sense."""
    parser = argument_parser()
    if not (sys.argv[1:] if arguments is None else arguments):
        parser.print_help()
        parser.exit()
    options = parser.parse_args(arguments)
    options.stated = stated_options(parser, arguments)
    if getattr(options, "recordings", None):  # of one robot: the first stands for all of them
        options.recording, options.cell = options.recordings[0], options.cells[0]
    options.out = options.out or Path("build/calibration") / options.command
    return options


class _Program(OneLineParser):
    """Lists the commands by what they are for, instead of in one row."""

    def format_help(self) -> str:
        """Return the help, with the commands in sections."""
        (commands,) = (one for one in self._actions if isinstance(one, argparse._SubParsersAction))
        texts = {one.dest: one.help for one in commands._choices_actions}
        lines = [self.format_usage(), str(self.description)]
        for title, names in SECTIONS.items():
            lines += ["", f"{title}:", *(f"  {name:<11} {texts[name]}" for name in names)]
        more = ["", "calibration COMMAND --help says more, with an example; --version prints the version.", ""]
        return "\n".join([*lines, *more])


def _output(parser: argparse.ArgumentParser) -> None:
    either = group(parser, RESULTS).add_mutually_exclusive_group()
    either.add_argument("-q", "--quiet", action="store_true", help="print nothing but errors")
    either.add_argument("--json", action="store_true", help="print result.json instead of the summary")


def argument_parser() -> argparse.ArgumentParser:
    """Return the arguments of every command."""
    from calibration_core.commands.files.init_arguments import init_arguments

    parser: argparse.ArgumentParser = _Program(
        prog="calibration", description="Elastostatic compliance calibration of industrial robots (CWA 17384)."
    )
    parser.add_argument("--version", action="version", version=f"calibration {__version__}")
    commands: argparse._SubParsersAction[argparse.ArgumentParser] = parser.add_subparsers(
        dest="command", required=True, metavar="COMMAND", parser_class=OneLineParser
    )
    plan_arguments(_command(commands, "plan", "choose measurement configurations (Table 1 of the standard)"))
    _pendant(_bare(commands, "pendant", "a plan as a program for the robot's pendant: KUKA, ABB, FANUC, Yaskawa, UR"))
    _simulate(_command(commands, "simulate", "write a recording as the cell's model predicts it"))
    _identify(_bare(commands, "identify", "joint stiffness, frames and geometry from recordings of one robot"))
    _diagnose(_bare(commands, "diagnose", "where simulation and recording differ, and which physics the model lacks"))
    _verify(_command(commands, "verify", "a model on places that were not used for it, against a tolerance"))
    _compare(_bare(commands, "compare", "one robot at different times, or twins: what has changed"))
    _predict(_command(commands, "predict", "predicted points and residuals of a recording"))
    _deflect(_command(commands, "deflect", "where points and tool go under a load, and how certain that is"))
    _compensate(_command(commands, "compensate", "corrected targets for the calibrated, loaded robot"))
    _export(_bare(commands, "export", "the calibrated robot as URDF, DH rows, UR kinematics, MuJoCo model or table"))
    init_arguments(_bare(commands, "init", "a commented cell file for a robot: from its URDF, a bag, or its name"))
    _check(_bare(commands, "check", "everything wrong with a cell file at once, what it means, and a drawing of it"))
    _fleet(_bare(commands, "fleet", "every recording of a plant in parallel: robots that age, stand out, or are alike"))
    _import(_bare(commands, "import", "tables of tracker software and controllers into a measurement table"))
    _describe(commands)
    _completion(commands)
    for one in commands.choices.values():
        one._action_groups.sort(key=lambda titled: titled.title == RESULTS)  # last, as they are the same everywhere
    return parser


def _completion(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    text = "the script by which a shell completes this program's arguments"
    parser = _added(commands, "completion", text)
    parser.add_argument("shell", choices=("bash", "zsh", "fish"), help="which shell")
    parser.set_defaults(recording=None, cell=None, out=None, json=False, quiet=False)


def _describe(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    text = "what a result says, in words"
    more = "It prints again what the command printed that made the result, and writes nothing."
    parser = _added(commands, "describe", text, more)
    parser.add_argument("result", type=path, metavar="RESULT", help="a result.json, or the directory that holds it")
    _output(parser)
    parser.set_defaults(recording=None, cell=None, out=None)


def _added(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], name: str, text: str, more: str = ""
) -> argparse.ArgumentParser:
    described = f"{text[0].upper()}{text[1:]}. {more}".strip()
    epilog = f"{EXAMPLE}\n  calibration {EXAMPLES[name]}"
    return commands.add_parser(name, help=text, description=described, epilog=epilog)


def _check(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cell", type=path, metavar="CELL.yaml", help="the cell file")
    parser.add_argument("recording", type=path, nargs="?", metavar="RECORDING", help="a recording to be read with it")
    _no_report(parser)


def _no_report(parser: argparse.ArgumentParser) -> None:
    group(parser, RESULTS).add_argument(
        "--no-report", dest="report", action="store_false", help="result and tables only, without report.html and .pdf"
    )


def _bare(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], name: str, text: str
) -> argparse.ArgumentParser:
    """Add a command that needs no cell file."""
    parser = _added(commands, name, text)
    where = f"where results go (default build/calibration/{name})"
    group(parser, RESULTS).add_argument("--out", type=path, metavar="DIR", help=where)
    _output(parser)
    parser.set_defaults(recording=None, cell=None)
    return parser


def _command(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], name: str, text: str
) -> argparse.ArgumentParser:
    parser = _bare(commands, name, text)
    _cell(parser)
    _no_report(parser)
    return parser


def _cell(parser: argparse.ArgumentParser) -> None:
    group(parser, INPUT).add_argument("--cell", type=path, required=True, metavar="CELL.yaml", help="the cell file")


def _recording(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "recording",
        type=path,
        metavar="RECORDING",
        help=RECORDING_KINDS,
    )
    _date(parser)


def _date(parser: argparse.ArgumentParser) -> None:
    group(parser, INPUT).add_argument(
        "--date", type=day, metavar="DAY", help="when it was measured, for a recording that does not say: 2026-05-31"
    )


def _recordings(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "recordings",
        type=path,
        nargs="+",
        metavar="RECORDING",
        help=f"{RECORDING_KINDS}; several recordings of one robot are evaluated together",
    )
    _cells(parser, "recording")
    _date(parser)
    _no_report(parser)


def _cells(parser: argparse.ArgumentParser, each: str) -> None:
    group(parser, INPUT).add_argument(
        "--cell",
        dest="cells",
        type=path,
        action="append",
        required=True,
        metavar="CELL.yaml",
        help=f"the cell file; given once, or once for each {each}",
    )


def _of_one_set_up(parser: argparse.ArgumentParser) -> None:
    text = "the recordings are of one set-up: neither tracker, targets nor sensor were moved between them"
    group(parser, INPUT).add_argument("--same-setup", action="store_true", help=text)


def _given(parser: argparse.ArgumentParser) -> None:
    group(parser, INPUT).add_argument(
        "--model",
        type=path,
        metavar="MODEL.yaml",
        help="start from this model instead of the cell's; its effects are known: they are taken off the readings",
    )


def _test(parser: argparse.ArgumentParser) -> None:
    text = "a second recording: predicted, not fitted"
    group(parser, INPUT).add_argument("--test", type=path, metavar="OTHER", help=text)


def _model(parser: argparse.ArgumentParser) -> None:
    text = "an identified model"
    group(parser, INPUT).add_argument("--model", type=path, required=True, metavar="MODEL.yaml", help=text)


def _identify(parser: argparse.ArgumentParser) -> None:
    _recordings(parser)
    _of_one_set_up(parser)
    _given(parser)
    _test(parser)
    parser.add_argument(
        "--method",
        choices=("equilibrium", "linear"),
        default="equilibrium",
        help="deformed geometry with K_CSM and gravity, or the standard's equations (6) and (7), which neglect K_CSM",
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
        help="use this reading after all (repeatable); of several recordings POINT@NUMBER, numbered as in the result",
    )


def _diagnose(parser: argparse.ArgumentParser) -> None:
    _recordings(parser)
    _of_one_set_up(parser)
    _given(parser)
    group(parser, INPUT).add_argument(
        "--simulation",
        dest="simulations",
        type=path,
        action="append",
        default=[],
        metavar="SIM",
        help="what a simulation says of the same measurement, to compare with; repeatable, for each recording",
    )
    _test(parser)
    parser.add_argument("--no-robust", action="store_true", help="use every reading, gross errors too")
    population_arguments(parser)


def _predict(parser: argparse.ArgumentParser) -> None:
    _recording(parser)
    _model(parser)


def _use(parser: argparse.ArgumentParser, payload: str) -> None:
    """Add what both commands take that use a model on a load."""
    _model(parser)
    parser.add_argument(
        "--wrench",
        metavar='"fx fy fz tx ty tz"',
        help="of the environment on the robot at the wrench point, N and N·m, all rows",
    )
    parser.add_argument("--axes", choices=("base", "tool"), default="base", help="axes of the wrenches (default base)")
    parser.add_argument("--payload", metavar='"mass cx cy cz"', help=f"{payload}: kg, and m in the flange frame")


def _deflect(parser: argparse.ArgumentParser) -> None:
    _use(parser, "what hangs on the flange before the load pulls, and is no part of the answer")
    parser.add_argument("--q", metavar='"q1 ... qn"', help="joint angles, rad (m where a joint slides)")
    parser.add_argument(
        "--poses", type=path, metavar="FILE.csv", help="places of the tool or joint angles, and wrenches"
    )
    parser.add_argument("--plane", choices=("xy", "xz", "yz"), default="xz", help="plane of the map (default xz)")


def _compensate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "task",
        type=path,
        metavar="TASK.csv",
        help="places of the tool (x y z roll pitch yaw) or q1 ... qn, and wrenches",
    )
    _use(parser, "what hangs on the flange, and is compensated")
    parser.add_argument(
        "--seed-q", metavar='"q1 ... qn"', help="chooses the branch of places (default: middle of the limits)"
    )


def _export(parser: argparse.ArgumentParser) -> None:
    _cell(parser)
    _model(parser)
    parser.add_argument(
        "--format",
        choices=("urdf", "dh", "ur", "mjcf", "table"),
        required=True,
        help="URDF; Denavit-Hartenberg rows; Universal Robots' kinematics file; MuJoCo; table of angle corrections",
    )
    group(parser, INPUT).add_argument(
        "--template", type=path, metavar="FILE", help="ur: the kinematics file extracted from this robot's controller"
    )
    parser.add_argument(
        "--joints", type=int, nargs="+", default=[2, 3], metavar="N", help="table: joints it runs over (default 2 3)"
    )
    parser.add_argument(
        "--points", type=int, default=21, metavar="N", help="table: nodes per joint, over its limits (default 21)"
    )
    parser.add_argument(
        "--q", metavar='"Q1 Q2 ..."', help="table: where the other joints stand, rad (default: middle of the limits)"
    )
    parser.add_argument(
        "--range", metavar='"LOW HIGH ..."', help="table: ends for each of --joints, rad (default: their limits)"
    )


def _pendant(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("plan", type=path, metavar="PLAN.yaml", help="the plan")
    _cell(parser)
    parser.add_argument(
        "--maker", choices=("kuka", "abb", "fanuc", "yaskawa", "ur"), required=True, help="whose controller runs it"
    )
    group(parser, INPUT).add_argument(
        "--map", type=path, metavar="MAP.yaml", help="as of import: which axis is which joint, and coupled joints"
    )
    parser.add_argument(
        "--axis-speeds",
        metavar='"V1 V2 ..."',
        help="kuka, yaskawa: largest speed of every axis by the data sheet, deg/s",
    )
    parser.add_argument(
        "--pulses",
        metavar='"P1 P2 ..."',
        help="yaskawa: pulses per degree of S L U R B T",
    )


def _import(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "files",
        type=path,
        nargs="+",
        metavar="FILES",
        help="a table with everything, or tables of points, of joint angles and of wrenches, or a robot program",
    )
    group(parser, INPUT).add_argument(
        "--map", type=path, metavar="MAP.yaml", help="states what is not recognised: columns, units, names"
    )


def _fleet(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "recording",
        type=path,
        metavar="MANIFEST",
        help="CSV or Parquet with recording, cell, robot, type, date; or a folder TYPE/ROBOT/DATE with recordings",
    )
    parser.add_argument("--jobs", type=whole(1), metavar="N", help="processes on this machine (default: its cores)")
    cluster_arguments(parser)
    parser.add_argument(
        "--alone", nargs="+", default=[], metavar="ROBOT", help="robots that are not pooled with their sisters"
    )
    _no_report(parser)


def _verify(parser: argparse.ArgumentParser) -> None:
    _recording(parser)
    _model(parser)
    parser.add_argument(
        "--tolerance", type=float, required=True, metavar="M", help="what the error of a point may not exceed, m"
    )
    parser.add_argument(
        "--fit-tracker", action="store_true", help="fit the tracker's pose first: it was set up anew since the model"
    )


def _compare(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "measurements",
        type=path,
        nargs="+",
        metavar="MEASUREMENT",
        help="two or more: recordings, or output folders of identify or diagnose; the first beside the others",
    )
    _cells(parser, "measurement")
    parser.add_argument(
        "--dates", nargs="+", metavar="DATE", help="when each was measured, ISO 8601 (default: recorded)"
    )
    group(parser, RESULTS).add_argument(
        "--no-report", dest="report", action="store_false", help="result alone, without report.html and .pdf"
    )


def _simulate(parser: argparse.ArgumentParser) -> None:
    group(parser, INPUT).add_argument("--plan", type=path, metavar="PLAN.yaml", help="the plan; without it one is made")
    group(parser, INPUT).add_argument(
        "--model",
        type=path,
        metavar="MODEL.yaml",
        help="an identified or extended model, effects included, instead of the cell's",
    )
    parser.add_argument("--seed", type=whole(0), help="add instrument noise from this seed (default: none)")


if __name__ == "__main__":
    sys.exit(main())
