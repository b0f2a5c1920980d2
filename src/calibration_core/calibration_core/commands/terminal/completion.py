"""`calibration completion bash|zsh|fish`: the script that lets a shell complete commands, options and robots."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping

SHELLS = ("bash", "zsh", "fish")
OUT = "--out"  # takes a directory


@dataclasses.dataclass(frozen=True)
class Option:
    """An option: what it does, and what it can be; empty: anything."""

    text: str
    choices: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Command:
    """A command.

    Attributes:
        text: What it does.
        options: Its options by their names.
        words: What its first argument can be, as far as is known.
        files: Whether it can be a file.
    """

    text: str
    options: Mapping[str, Option]
    words: tuple[str, ...]
    files: bool


Commands = Mapping[str, Command]


def run(arguments: argparse.Namespace) -> str:
    """Return the script for the shell that was asked for."""
    from calibration_core.cli import argument_parser

    return completion(arguments.shell, argument_parser())


def completion(shell: str, parser: argparse.ArgumentParser) -> str:
    """Return the script for a shell, made from the program's own arguments."""
    commands = _commands(parser)
    return {"bash": _bash, "zsh": _zsh, "fish": _fish}[shell](commands)


def _commands(parser: argparse.ArgumentParser) -> Commands:
    (actions,) = (one for one in parser._actions if isinstance(one, argparse._SubParsersAction))
    helps = {one.dest: str(one.help) for one in actions._choices_actions}
    found = {}
    for name, sub in actions.choices.items():
        options = {
            option: Option(" ".join(str(one.help or "").split()), tuple(map(str, one.choices or ())))
            for one in sub._actions
            for option in one.option_strings
        }
        chosen = (tuple(map(str, one.choices)) for one in sub._actions if one.choices and not one.option_strings)
        words = next(chosen, ())
        files = not words
        if name == "init":
            from calibration_core.cell.library import library

            words = tuple(library())
        found[name] = Command(helps[name], options, words, files)
    return found


def _bash(commands: Commands) -> str:
    cases, values = [], []
    for name, command in commands.items():
        files = "" if command.files else " files=no"
        cases.append(f'    {name}) words="{" ".join([*command.options, *command.words])}"{files} ;;')
        values += [
            f'    {name}:{option}) COMPREPLY=($(compgen -W "{" ".join(one.choices)}" -- "$word")); return ;;'
            for option, one in command.options.items()
            if one.choices
        ]
    return "\n".join([
        "# bash completion of calibration; to use it: eval \"$(calibration completion bash)\"",
        "_calibration() {",
        '  local word="${COMP_WORDS[COMP_CWORD]}" before="${COMP_WORDS[COMP_CWORD-1]}" words="" files=yes',
        "  COMPREPLY=()",
        "  if [ \"$COMP_CWORD\" -eq 1 ]; then",
        f'    COMPREPLY=($(compgen -W "{" ".join([*commands, "--help", "--version"])}" -- "$word")); return',
        "  fi",
        '  case "${COMP_WORDS[1]}:$before" in',
        *values,
        f'    *:{OUT}) COMPREPLY=($(compgen -d -- "$word")); return ;;',
        "  esac",
        '  case "${COMP_WORDS[1]}" in',
        *cases,
        "  esac",
        '  COMPREPLY=($(compgen -W "$words" -- "$word"))',
        '  [ "${word:0:1}" = "-" ] || [ $files = no ] || COMPREPLY+=($(compgen -f -- "$word"))',
        "}",
        "complete -o filenames -F _calibration calibration",
        "",
    ])  # fmt: skip


def _zsh(commands: Commands) -> str:
    lines = [
        "#compdef calibration",
        "# zsh completion of calibration; to use it: source <(calibration completion zsh)",
        "_calibration() {",
        "  local -a commands",
        "  commands=(" + " ".join(_quoted(f"{name}:{one.text}") for name, one in commands.items()) + ")",
        "  if (( CURRENT == 2 )); then _describe command commands; return; fi",
        '  case "$words[2]" in',
    ]
    for name, command in commands.items():
        rows = []
        for option, one in command.options.items():
            text = one.text.replace("[", "(").replace("]", ")").replace(":", ",")
            takes = f":value:({' '.join(one.choices)})" if one.choices else ""
            rows.append(_quoted(f"{option}[{text}]{':directory:_directories' if option == OUT else takes}"))
        if command.words:
            rows.append(_quoted(f"1: :({' '.join(command.words)})"))
        arguments = " ".join([*rows, "'*:file:_files'"])
        lines.append(f"    {name}) shift words; (( CURRENT-- )); _arguments -S {arguments} ;;")
    return "\n".join([*lines, "  esac", "}", "compdef _calibration calibration", ""])


def _fish(commands: Commands) -> str:
    lines = ["# fish completion of calibration; to use it: calibration completion fish | source"]
    for name, command in commands.items():
        lines.append(f"complete -c calibration -n __fish_use_subcommand -f -a {name} -d {_quoted(command.text)}")
        here = f"complete -c calibration -n {_quoted(f'__fish_seen_subcommand_from {name}')}"
        for option, one in command.options.items():
            kind = f"-l {option[2:]}" if option.startswith("--") else f"-s {option[1:]}"
            given = f" -x -a {_quoted(' '.join(one.choices))}" if one.choices else ""
            lines.append(f"{here} {kind}{given} -d {_quoted(one.text)}")
        if command.words:
            lines.append(f"{here} -a {_quoted(' '.join(command.words))}")
    return "\n".join([*lines, ""])


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "’") + "'"
