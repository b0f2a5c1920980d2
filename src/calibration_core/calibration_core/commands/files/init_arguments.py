"""The arguments of `calibration init`, and how places are written in them and in answers."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from calibration_core.engine.command_line import path


def numbers(words: list[str]) -> tuple[float, ...]:
    """Return three or six numbers.

    Raises:
        ValueError: They are none.
    """
    values = tuple(float(word) for word in words)
    if len(values) not in (3, 6):
        msg = f"{len(values)} numbers instead of 3 or 6"
        raise ValueError(msg)
    return values


def point(text: str) -> tuple[str, tuple[float, ...]]:
    """Return name and place of NAME=x,y,z.

    Raises:
        argparse.ArgumentTypeError: It is not written so.
    """
    name, sign, place = text.partition("=")
    try:
        values = tuple(float(word) for word in place.split(","))
    except ValueError:
        values = ()
    if not (sign and name.strip() and len(values) == 3):
        msg = f"{text!r} instead of NAME=x,y,z (m, flange frame)"
        raise argparse.ArgumentTypeError(msg)
    return name.strip(), values


def points(places: Sequence[tuple[str, tuple[float, ...]]]) -> dict[str, tuple[float, ...]]:
    """Return name -> place of targets.

    Raises:
        ValueError: A name stands twice.
    """
    names = [name for name, _ in places]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        msg = f"{twice[0]!r} {names.count(twice[0])} times"
        raise ValueError(msg)
    return dict(places)


def init_arguments(parser: argparse.ArgumentParser) -> None:
    """State the arguments of `init`."""
    parser.add_argument("robot", metavar="ROBOT", help="a URDF, a bag with /robot_description, or a robot's name")
    parser.add_argument("--name", help="name of the cell")
    parser.add_argument("--rated-load", type=float, metavar="KG", help="rated load (needed with a URDF)")
    parser.add_argument(
        "--meshes",
        type=path,
        metavar="DIR",
        help="where the URDF's meshes or packages lie (default: around the URDF, and where ROS looks)",
    )
    parser.add_argument("--base-link", metavar="LINK", help="the URDF's link that is the base (default: by its name)")
    parser.add_argument("--flange", metavar="LINK", help="the URDF's link that is the flange (default: by its name)")
    pose = ("X", "Y", "Z", "ROLL", "PITCH", "YAW")
    for option, text in {
        "--tracker": "the tracker in the base frame, m and rad",
        "--sensor": "the force/torque sensor in the flange frame, m and rad",
    }.items():
        parser.add_argument(option, type=float, nargs=6, metavar=pose, help=text)
    parser.add_argument("--wrench-point", type=float, nargs=3, metavar=("X", "Y", "Z"), help="where the load pulls, m")
    parser.add_argument(
        "--point",
        type=point,
        action="append",
        metavar="NAME=X,Y,Z",
        help="a target in the flange frame, m (once for each target)",
    )
    parser.add_argument("--tracker-sigma", type=float, metavar="M", help="standard deviation of a tracker coordinate")
    parser.add_argument("--force-sigma", type=float, metavar="N", help="standard deviation of a force")
    parser.add_argument("--torque-sigma", type=float, metavar="NM", help="standard deviation of a torque")
    parser.add_argument("--no-questions", action="store_true", help="ask nothing, on a terminal either")
