"""The arguments that name what is known of robots of the same type."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from calibration_core.engine.command_line import group, path
from calibration_core.errors import InputError

if TYPE_CHECKING:
    from calibration_core.cell import Cell
    from calibration_core.fleet.next_robot.population_file import TypePopulation


def population_arguments(parser: argparse.ArgumentParser) -> None:
    """State the arguments."""
    known = group(parser, "robots of the same type")
    known.add_argument(
        "--population",
        type=path,
        metavar="POPULATION.yaml",
        help="what is known of robots of this type, from calibration fleet: stands beside what is found, and into it",
    )
    known.add_argument("--type", metavar="TYPE", help="which type of the population file (default: the only one)")


def asked_population(arguments: argparse.Namespace, cell: Cell) -> TypePopulation | None:
    """Return the population that the arguments ask for; None where they ask for none.

    Raises:
        InputError: The file cannot be used, has no such type, or lacks a joint of the robot.
    """
    path: Path | None = getattr(arguments, "population", None)
    if path is None:
        if getattr(arguments, "type", None) is not None:
            raise InputError("--type", "", "no --population", "a population file, of which it chooses the type")
        return None
    from calibration_core.fleet.next_robot.population_file import read_population  # late: arguments need no numerics

    return read_population(path, arguments.type, tuple(cell.robot.joints))
