"""What the programs share on their command lines: one line for wrong arguments, and kinds of values."""

from __future__ import annotations

import argparse
import difflib
import math
import re
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from calibration_core.errors import InputError


class OneLineParser(argparse.ArgumentParser):
    """Says in one line what is wrong with the arguments; a command's own parser answers for its arguments."""

    def error(self, message: str) -> NoReturn:
        """End the process with exit code 2 and one line on stderr."""
        message = _with_suggestion(message)
        self.exit(2, f"{InputError(self.prog, '', message, f'arguments as in {self.prog} --help')}\n")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse as usual, but refuse what is not known here, where `--help` lists what is."""
        options, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return options, unknown


def _with_suggestion(message: str) -> str:
    """Add the nearest choice to what argparse says of a wrong one."""
    wrong = re.search(r"invalid choice: '([^']*)' \(choose from (.*)\)", message)
    if wrong is None:
        return message
    near = difflib.get_close_matches(wrong.group(1), re.findall(r"[\w-]+", wrong.group(2)), n=1)
    return f"{message}: did you mean {near[0]}?" if near else message


def stated_options(parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> frozenset[str]:
    """Return the options that a command line states, also where they state a default, by their longest names.

    Args:
        parser: Of the program; it knows no defaults afterwards.
        arguments: The command line, which the parser accepts; None: the process's own.
    """
    names = _without_defaults(parser)
    return frozenset(names[name] for name in vars(parser.parse_args(arguments)) if name in names)


def _without_defaults(parser: argparse.ArgumentParser) -> dict[str, str]:
    """Remove the defaults of a parser and of its commands; return attribute -> option."""
    names: dict[str, str] = {}
    parser._defaults.clear()
    for action in parser._actions:
        action.default = argparse.SUPPRESS
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                names |= _without_defaults(command)
        elif action.option_strings:
            names[action.dest] = max(action.option_strings, key=len)
    return names


def refuse_without_effect(stated: Collection[str], who: str, names: Iterable[str], where: str, needed: str) -> None:
    """Refuse options that are stated and have no effect on this input.

    Args:
        stated: The options that are stated.
        who: The command, for the message.
        names: Those without effect.
        where: Where they have none: `without --population`, `on a recording at rest`.
        needed: What they would have an effect on, or with.

    Raises:
        InputError: There is one.
    """
    for name in names:
        if name in stated:
            raise InputError(who, name, f"an option that has no effect {where}", f"{needed}, or no {name}")


def path(text: str) -> Path:
    """Return a path.

    Raises:
        argparse.ArgumentTypeError: The text is empty, which would mean the working directory.
    """
    if not text:
        msg = "an empty name, expected a path"
        raise argparse.ArgumentTypeError(msg)
    return Path(text)


def whole(least: int) -> Callable[[str], int]:
    """Return what turns a text into an integer of at least `least`, or raises argparse.ArgumentTypeError."""

    def number(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if value < least:
            msg = f"{text!r}, expected an integer of at least {least}"
            raise argparse.ArgumentTypeError(msg)
        return value

    return number


def within(least: float, most: float) -> Callable[[str], float]:
    """Return what turns a text into a finite number from `least` to `most`, or raises argparse.ArgumentTypeError."""

    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            msg = f"{text!r}, expected a number from {least:g} to {most:g}"
            raise argparse.ArgumentTypeError(msg)
        return value

    return number
