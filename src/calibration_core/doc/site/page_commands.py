"""The reference of the commands, made from the program's own parser."""

from __future__ import annotations

import argparse

from calibration_core.cli import argument_parser as build_parser

HEAD = """# Commands

`calibration COMMAND --help` says the same. Results go to `--out` (default `build/calibration/COMMAND`), as one set:
all files of a result appear together, or nothing changes. Exit code 0: done, whatever the verdict. 2: the input
cannot be used; one line on stderr names the file, the place, what was found and what was expected. 1: a defect of
this program; the line names a file with details.
"""


def page() -> str:
    """Return the page, Markdown."""
    return "\n".join([HEAD, *(_section(name, parser, text) for name, parser, text in commands())])


def commands() -> list[tuple[str, argparse.ArgumentParser, str]]:
    """Return name, parser and one line of help of every command."""
    action = next(one for one in build_parser()._actions if isinstance(one, argparse._SubParsersAction))
    texts = {one.dest: one.help or "" for one in action._choices_actions}
    return [(name, parser, texts.get(name, "")) for name, parser in action.choices.items()]


def _section(name: str, parser: argparse.ArgumentParser, text: str) -> str:
    rows = [_row(one) for one in parser._actions if one.dest != "help"]
    usage = " ".join(parser.format_usage().removeprefix("usage: ").split())
    table = "\n".join(["| argument | meaning |", "|---|---|", *rows])
    return f"## calibration {name}\n\n{text[:1].upper()}{text[1:]}.\n\n```text\n{usage}\n```\n\n{table}\n"


def _row(one: argparse.Action) -> str:
    shown = one.metavar if one.metavar is not None else one.dest.upper()
    values = " ".join(shown) if isinstance(shown, tuple) else str(shown)
    if one.choices is not None:
        values = " ".join(map(str, one.choices)).replace(" ", ", ")
    takes = one.nargs != 0
    names = ", ".join(f"`{name}`" for name in one.option_strings) or f"`{values}`"
    name = f"{names} `{values}`" if one.option_strings and takes else names
    text = (one.help or "").replace("|", "\\|").replace("%%", "%")
    return f"| {name} | {text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'} |"
