"""What the programs share on their command lines: one line for wrong arguments, and kinds of values."""

from __future__ import annotations

import argparse
import datetime as dt
import difflib
import math
import re
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from calibration_core.errors import InputError


class _Help(argparse.HelpFormatter):
    """States every default, and an example as it is typed."""

    def _get_help_string(self, action: argparse.Action) -> str:
        text = action.help or ""
        stated = "default" in text or action.nargs == 0 or action.default in (None, "", [], argparse.SUPPRESS)
        return text if stated else f"{text} (default %(default)s)"

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return text if text.startswith(EXAMPLE) else super()._fill_text(text, width, indent)


EXAMPLE = "example:"


class OneLineParser(argparse.ArgumentParser):
    """Says in one line what is wrong with the arguments; a command's own parser answers for its arguments."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Take the arguments of `argparse.ArgumentParser`; an option that holds one value may stand once."""
        super().__init__(*args, **{"formatter_class": _Help, **kwargs})
        self._negative_number_matcher = re.compile(r"-[\d.]")  # "-0.1,0.3" is a value, too
        self.register("action", None, _StoreOnce)
        self.register("action", "store", _StoreOnce)

    def error(self, message: str) -> NoReturn:
        """End the process with exit code 2 and one line on stderr."""
        self.exit(2, f"{_fault(self.prog, message)}\n")

    def _get_nargs_pattern(self, action: argparse.Action) -> str:
        """Take as many values as an option wants, and no other option for one, as Python 3.13 does."""
        if action.option_strings and isinstance(action.nargs, int):
            return f"({'A' * action.nargs})"
        return str(super()._get_nargs_pattern(action))

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse as usual, but refuse what is not known here, where `--help` lists what is."""
        for action in self._actions:
            if isinstance(action, _StoreOnce):
                action.stored = False
        options, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return options, unknown


def group(parser: argparse.ArgumentParser, title: str) -> argparse._ArgumentGroup:
    """Return the group of options that the help lists under a title."""
    return next((one for one in parser._action_groups if one.title == title), None) or parser.add_argument_group(title)


class _StoreOnce(argparse._StoreAction):
    """Keeps the value of an option, and refuses a second one, of which nobody knows whether it is meant."""

    stored = False

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        """Keep the value.

        Raises:
            argparse.ArgumentError: The option has one already.
        """
        if self.stored and self.option_strings:
            raise argparse.ArgumentError(self, f"the option twice, expected one {max(self.option_strings, key=len)}")
        self.stored = True
        super().__call__(parser, namespace, values, option_string)


KINDS = {"int": "a whole number", "float": "a number, with a decimal point"}


def _fault(program: str, message: str) -> InputError:
    """Return what argparse says of wrong arguments as place, what was found and what was expected."""
    named = re.fullmatch(r"argument (\S+?)(?:/\S+)?: (.*)", message, re.DOTALL)
    place, text = (named.group(1), named.group(2)) if named else ("", message)
    found, expected = text, "arguments"
    if kind := re.fullmatch(r"invalid (int|float) value: (.*)", text, re.DOTALL):
        found, expected = kind.group(2), KINDS[kind.group(1)]
    elif count := re.fullmatch(r"expected (one|\d+|at least one) arguments?", text):
        values = "value" if count.group(1).endswith("one") else "values"
        found, expected = "another number of values", f"{count.group(1)} {values}"
    elif lacking := re.fullmatch(r"the following arguments are required: (.*)", text):
        place, found, expected = lacking.group(1), "nothing", "a value"
    elif unknown := re.fullmatch(r"unrecognized arguments: (.*)", text, re.DOTALL):
        found = f"'{unknown.group(1)}'"
    elif ", expected " in text:  # by a type or an action of this module
        found, _, expected = text.partition(", expected ")
    elif choice := re.fullmatch(r"invalid choice: (.*) \(choose from (.*)\)", text, re.DOTALL):
        names = re.findall(r"[\w-]+", choice.group(2))  # Python 3.12 and later quote none of them
        near = difflib.get_close_matches(choice.group(1).strip("'"), names, n=1)
        found = choice.group(1) + (f" (did you mean {near[0]}?)" if near else "")
        expected = f"one of {', '.join(names)}"
    return InputError(program, place, found, f"{expected} as in {program} --help")


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


def separate(text: str) -> tuple[float, ...]:
    """Return numbers that blanks or commas separate.

    Raises:
        ValueError: One is none, or blanks separate and commas stand within: they may be decimal marks.  The text goes
            on where the caller says what it expected.
    """
    if re.search(r"\S,\S", text) and re.search(r"[^\s,]\s+[^\s,]", text):
        raise ValueError(", with a decimal point, separated by blanks or by commas")
    try:
        return tuple(float(part) for part in re.split(r"[\s,]+", text.strip(" ,")))
    except ValueError:
        raise ValueError("") from None


def path(text: str) -> Path:
    """Return a path.

    Raises:
        argparse.ArgumentTypeError: The text is empty, which would mean the working directory.
    """
    if not text:
        msg = "an empty name, expected a path"
        raise argparse.ArgumentTypeError(msg)
    return Path(text)


def day(text: str) -> str:
    """Return a day as it is written in ISO 8601.

    Raises:
        argparse.ArgumentTypeError: It is none.
    """
    try:
        return dt.date.fromisoformat(text).isoformat()
    except ValueError:
        msg = f"{text!r}, expected a day, for example 2026-05-31"
        raise argparse.ArgumentTypeError(msg) from None


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
