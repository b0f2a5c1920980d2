"""`calibration describe`: what a result says, in words."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from calibration_core.commands.files.describe_preparation import OF_PREPARATION
from calibration_core.commands.files.describe_use import OF_USE
from calibration_core.commands.files.result_parts import Content, records
from calibration_core.errors import InputError, quoted
from calibration_core.files.regular import read_regular
from calibration_core.identification.result.estimate import DECLARED_RIGID
from calibration_core.model.effects.words import effect_words
from calibration_core.report.results.result import SCHEMA
from calibration_core.report.rounding import STIFFNESS, counted, decimals, fixed, phrase, significant
from calibration_core.report.writing.output import RESULT

MOST = 1 << 28  # bytes of a result.json
EVALUATED = ("identify", "diagnose")
OF_ROWS = ("compare", "compensate", "deflect")  # their `recording` is no recording: they read tasks, or several
VERDICTS = {
    "consistent": "The model explains the recording to its noise.",
    "missing_physics": "The model leaves out physics, which was found; what remains is noise.",
    "partly_explained": "The model leaves out physics; a part of what remains is not explained.",
    "unexplained": "A significant part of the recording is not explained, and no cause is defensible.",
}


def run(arguments: argparse.Namespace) -> str:
    """Return the description of a result; nothing is written.

    Raises:
        InputError: There is no result.json, or it is none of this program's.
    """
    path = arguments.result / RESULT if arguments.result.is_dir() else arguments.result
    return "\n".join(describe(read_result(path)))


def read_result(path: Path) -> dict[str, Any]:
    """Read a result.json.

    Raises:
        InputError: It cannot be read or is no result.
    """
    expected = f"result.json of schema {SCHEMA}"
    try:
        content = json.loads(read_regular(path, MOST, "result.json"))
    except json.JSONDecodeError as error:
        raise InputError(path, "", "no JSON", expected).at(error.lineno, error.colno) from None
    except (ValueError, RecursionError) as error:
        raise InputError(path, "", str(error).splitlines()[0], expected) from None
    if not isinstance(content, dict) or content.get("schema") != SCHEMA or not isinstance(content.get("command"), str):
        raise InputError(
            path, "schema", quoted(content.get("schema") if isinstance(content, dict) else content), expected
        )
    return content


def describe(result: Mapping[str, Any]) -> list[str]:
    """Return a result in words, a line each; what it does not have is passed over."""
    lines = [f"{result['command']}: {result.get('robot', '')}".rstrip(": ")]
    lines += _recording(result) if result["command"] not in OF_ROWS else []
    lines += _recordings(result)
    if "usable" in result:
        lines += [f"Usable: {str(result['usable']).replace('_', ' ')}. {_sentence(result.get('reason'))}".rstrip()]
        lines += [f"Next step: {result['next_step']}"] if result.get("next_step") else []
    verdict = result.get("verdict")
    if isinstance(verdict, str) and verdict in VERDICTS and result["command"] in EVALUATED:
        lines.append(f"Verdict: {verdict}. {VERDICTS[verdict]}")
    lines += [_joint(joint) for joint in records(result, "stiffness")]
    sentences = SENTENCES.get(str(result["command"]), _evaluated)
    stated = [text for text in sentences(result) if text]
    named = [_named("Finding", one, "effect", "explanation") for one in records(result, "findings")]
    named += [_named("Anomaly", one, "kind", "text") for one in records(result, "anomalies")]
    if result["command"] not in EVALUATED:
        return [*lines, *named, *stated]
    lines += [*stated, *named]
    proposals = records(result, "next_measurements")
    if proposals:
        why = proposals[0].get("why") or "see the report"
        lines.append(f"Proposed next measurements: {len(proposals)}; the first: {why}")
    if result.get("usable") == "yes":
        lines.append("Next step: use model.yaml, which calibration verify, deflect, compensate and export read.")
    return lines


def _recording(result: Mapping[str, Any]) -> list[str]:
    """Return the line of the recording, or of the plan; what it does not have is passed over."""
    recording = result.get("recording")
    if not isinstance(recording, Mapping):
        return []
    counts = [
        counted(value, noun)
        for key, noun in (("configurations", "configuration"), ("steps", "step"), ("readings", "reading"))
        if isinstance(value := recording.get(key), int)
    ]
    points = recording.get("points")
    names = [f"points {', '.join(map(str, points))}"] if isinstance(points, list) and points else []
    kind = "with load steps" if recording.get("loaded") else "without load steps"
    title = "Plan" if result["command"] == "plan" else "Recording"
    return [f"{title} {recording.get('file')}: {', '.join([*counts, *names, kind])}."]


def _raised(by: object) -> str:
    return f" (numbers raised by {by})" if by else ""


def _recordings(result: Mapping[str, Any]) -> list[str]:
    """Return a line for each of several recordings, and one that says whether they agree."""
    lines = [
        f"Recording {one.get('number')}: {one.get('file')}: {one.get('configurations')} configurations"
        f"{_raised(one.get('numbered_from'))}, {one.get('readings')} readings, measured in {one.get('cell')}."
        for one in records(result, "recordings")
    ]
    agreement = result.get("agreement")
    if isinstance(agreement, Mapping):
        places = dict.fromkeys(str(one.get("location")) for one in records(agreement, "differences"))
        lines.append(f"The recordings differ at {', '.join(places)}." if places else "The recordings agree.")
    return lines


def _named(title: str, of: Mapping[str, Any], name: str, text: str) -> str:
    return f"{title}: {effect_words(str(of.get(name)))} at {_place(of)}. {of.get(text) or ''}".rstrip()


def _joint(joint: Mapping[str, Any]) -> str:
    value, std, unit = joint.get("value"), joint.get("std"), str(joint.get("unit", "")).replace("*", "·")
    if joint.get("reason") == DECLARED_RIGID:
        return f"Stiffness of {joint.get('joint')}: {DECLARED_RIGID}."
    if not isinstance(value, int | float) or not joint.get("identifiable", True):
        return f"Stiffness of {joint.get('joint')}: not identifiable. {_sentence(joint.get('reason'))}".rstrip()
    half = STIFFNESS.factor * 1.96 * std if isinstance(std, int | float) else math.nan
    known = math.isfinite(half) and half > 0
    size = STIFFNESS.factor * value
    number = f"({fixed(size, decimals(half))} ± {fixed(half, decimals(half))})" if known else significant(size, 4)
    return f"Stiffness of {joint.get('joint')}: {number}·10⁵ {unit}" + (" (95 %)" if known else "")


def _sentence(text: Any) -> str:
    """Return a text as a sentence, with a capital and a full stop; nothing for nothing."""
    return f"{text[0].upper()}{text[1:].removesuffix('.')}." if isinstance(text, str) and text else ""


def _fit(fit: Any) -> list[str]:
    if not isinstance(fit, Mapping):
        return []
    known = {key: value for key, value in fit.items() if isinstance(value, int | float)}
    names = {
        "rms_after": "residual",
        "held_out_rms_after": "on configurations left out",
        "noise": "noise",
    }
    shown = [f"{text} {1e6 * known[key]:.1f} µm" for key, text in names.items() if key in known]
    return ["Fit per coordinate: " + ", ".join(shown) + "."] if shown else []


def _evaluated(result: Content) -> Iterable[str]:
    return _fit(result.get("fit"))


def _place(of: Mapping[str, Any]) -> str:
    location = of.get("location")
    if not isinstance(location, Mapping) or not location:
        return "the whole recording"
    return ", ".join(_at(str(key), value) for key, value in location.items())


def _at(key: str, value: Any) -> str:
    """Return a place: `joint joint_2`, `joints joint_2 and joint_3`, `all joints`, or what is there once, `tracker`."""
    named = phrase([*map(str, value)]) if isinstance(value, list) else str(value)
    return f"all {key}" if named == "all" else key if named == key else f"{key} {named}"


SENTENCES: Mapping[str, Callable[[Content], Iterable[str]]] = {
    **OF_PREPARATION,
    "identify": _evaluated,
    "diagnose": _evaluated,
    **OF_USE,
}
"""Command -> what its results say beside what all have; every command that writes a result has an entry."""
