"""The arguments of `calibration plan`."""

from __future__ import annotations

import argparse

from calibration_core.commands.shared.population_arguments import population_arguments
from calibration_core.engine.command_line import group, path, refuse_without_effect, whole

OF_VERIFY = ("--tolerance", "--risk")
LOAD_STEPS = ("--load-levels", "--protocol")
LOAD_SHARE = 0.9  # of the rated load: readings of a pull of 100 % scatter beyond the standard's limit (5.1)
LOAD_SIZES = ("--load-share", "--largest-force", "--largest-torque")
CHOICE = ("--configurations", "--spares", "--criterion")
WITHOUT_EFFECT = {
    "stiffness": (OF_VERIFY, "without --for verify", "--for verify"),
    "geometry": ((*OF_VERIFY, *LOAD_STEPS, *LOAD_SIZES), "on a plan without loads and tolerance", "another --for"),
    "verify": (
        (*CHOICE, *LOAD_STEPS),
        "on the 5 to 8 poses of a re-check, which are unloaded and under the full pull",
        "--for stiffness",
    ),
}
"""What is to be found -> options that have no effect on such a plan, why, and what they need."""


def plan_arguments(parser: argparse.ArgumentParser) -> None:
    """State the arguments of `plan`."""
    verify, loads, space = (group(parser, title) for title in ("with --for verify", "loads", "operating space"))
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
    parser.add_argument("--seed", type=whole(0), default=0, help="seed of the search (default 0)")
    parser.add_argument(
        "--criterion",
        choices=("D", "A", "worst", "condition", "observability", "trace"),
        default="D",
        help="what makes a choice good: determinant, mean or worst variance, or one of CWA 17384, 5.4 (default D)",
    )
    parser.add_argument(
        "--for",
        dest="purpose",
        choices=("stiffness", "geometry", "verify"),
        default="stiffness",
        help="what is to be found: joint stiffnesses (default); frames and geometry, without loads; or, with 5 to 8 "
        "poses, whether the calibration of --model still holds",
    )
    verify.add_argument("--tolerance", type=float, metavar="M", help="--for verify: error that may not be exceeded, m")
    verify.add_argument(
        "--risk", type=float, default=0.05, help="--for verify: probability of either wrong answer (default 0.05)"
    )
    parser.add_argument(
        "--phases",
        action="store_true",
        help="plan also what finds base frame, geometry, wrist centre and points before (CWA 17384, 7.1 to 7.5)",
    )
    loads.add_argument(
        "--load-levels",
        type=float,
        nargs="+",
        metavar="SHARE",
        help="load steps as shares of the full pull, the first 0 (default 0 0.25 0.5 0.75 1 0.75 0.5 0.25 0)",
    )
    loads.add_argument(
        "--protocol",
        metavar="NAME",
        help="load steps by name: loading, unloading, small-steps, reversed or references (see the report of a plan)",
    )
    loads.add_argument(
        "--load-share",
        type=float,
        default=LOAD_SHARE,
        metavar="SHARE",
        help=f"full pull and end effector as a share of the rated load (default {LOAD_SHARE:g})",
    )
    loads.add_argument("--largest-force", type=float, metavar="N", help="range of the force/torque sensor, force")
    loads.add_argument("--largest-torque", type=float, metavar="NM", help="range of the force/torque sensor, torque")
    space.add_argument(
        "--box",
        type=float,
        nargs=6,
        metavar=("XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX"),
        help="operating space of the measurement points in the base frame, m (default: all that can be reached)",
    )
    space.add_argument(
        "--cube",
        type=float,
        nargs="?",
        const=0.0,
        metavar="SIDE",
        help="the operating space is a cube of ISO 9283, of this side in m (without SIDE: the largest that fits)",
    )
    space.add_argument(
        "--task",
        type=path,
        metavar="FILE.csv",
        help="the operating space is that of a task: columns x, y, z (m), or q1 ... (rad), or theta_1 ... (degrees)",
    )
    population_arguments(parser)
    group(parser, "robots of the same type").add_argument(
        "--accuracy",
        type=float,
        default=0.01,
        metavar="SHARE",
        help="--population: wanted standard deviation of every stiffness, of its value (default 0.01)",
    )
    text = "an identified model instead of the cell's"
    group(parser, "input").add_argument("--model", type=path, metavar="MODEL.yaml", help=text)


def refuse_idle(arguments: argparse.Namespace) -> None:
    """Refuse stated options that have no effect on the plan that is asked for.

    Raises:
        InputError: There is one.
    """
    refuse_without_effect(arguments.stated, f"plan --for {arguments.purpose}", *WITHOUT_EFFECT[arguments.purpose])
    if arguments.population is None:
        refuse_without_effect(arguments.stated, "plan", ("--accuracy",), "without --population", "--population")


def refuse_idle_loads(arguments: argparse.Namespace, *, loads: bool, torque: bool) -> None:
    """Refuse stated limits of a load that cannot be applied, or is not held against them.

    Args:
        arguments: The options.
        loads: Whether the plan loads the robot.
        torque: Whether the pose of the sensor is known, and with it the torque that a pull exerts there.

    Raises:
        InputError: There is one.
    """
    who = f"plan --for {arguments.purpose}"
    if not loads:
        where = "where the robot cannot be loaded"
        needed = "frames.wrench_point and instruments.force_torque in the cell file, and a stiffness"
        refuse_without_effect(arguments.stated, who, LOAD_SIZES, where, needed)
    if not torque:
        where = "where the pose of the sensor is not known"
        needed = "frames.force_torque in the cell file"
        refuse_without_effect(arguments.stated, who, ("--largest-torque",), where, needed)
