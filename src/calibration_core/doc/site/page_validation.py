"""The validation table, made from what `make prove` and `make bench` wrote, and from the record of further runs."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.special import betaincinv

HEAD = """# Validation

Every figure stands with the command that repeats it, its date and, where the repository has it, the commit. A share
of n cases has a 95 % interval (binomial, Clopper and Pearson). Times depend on the machine: tests check ratios to a
reference in the same run; seconds are stated as seen. The real recordings are others' (their sources stand in the
tests) and not part of this project.
"""
NUMBER = re.compile(r"(?<![\w.])\d[\d,]*(?:\.\d+)?")
RUNS = 3  # of the benchmarks, from which on their spread is stated


def page(folder: Path) -> str:
    """Return the page, Markdown.

    Args:
        folder: With `measured.yaml`, and `prove*.json` and `bench.json` where they were collected.
    """
    parts = [HEAD]
    parts += [proof(json.loads(path.read_text("utf-8"))) for path in sorted(folder.glob("prove*.json"))]
    bench = folder / "bench.json"
    if bench.is_file():
        parts.append(benchmarks(json.loads(bench.read_text("utf-8"))))
    parts.append(recorded(yaml.safe_load((folder / "measured.yaml").read_text("utf-8"))))
    return "\n".join(parts)


def proof(content: Mapping[str, Any]) -> str:
    """Return the section of one proof on concealed effects."""
    rows = []
    for one in content["measures"]:
        value, count = one["value"], one["count"]
        shown = "–" if value is None else f"{value:.3f}"
        interval = ""
        if value is not None and 0.0 <= value <= 1.0 and count and abs(value * count - round(value * count)) < 1e-6:
            low, high = binomial(round(value * count), count)
            interval = f"{low:.3f} to {high:.3f}"
        met = {True: "yes", False: "**no**", None: ""}[one["met"]]
        rows.append(f"| {one['text']} | {shown} | {interval} | {count} | {one['bar']} | {met} |")
    head = (
        f"## Concealed effects, seed {content['seed']}\n\n{content['recordings']} recordings; `{content['command']}`, "
        f"{content['date']}, commit `{content['commit']}`.\n\n"
        "| measure | value | 95 % interval | cases | bar | met |\n|---|---|---|---|---|---|"
    )
    return "\n".join([head, *rows, ""])


def benchmarks(runs: Sequence[Mapping[str, Any]]) -> str:
    """Return the section of the benchmarks: what each printed, with median and range of its numbers over the runs."""
    last = runs[-1]
    head = (
        f"## Benchmarks\n\n{len(runs)} run{'s' if len(runs) > 1 else ''} of `make bench`, last on {last['date']}, "
        f"commit `{last['commit']}`, {last['machine']}. "
        + ("Numbers are the median of the runs, with least and most in brackets." if len(runs) >= RUNS else "")
        + "\n\n| benchmark | passed | said |\n|---|---|---|"
    )
    rows = []
    for name in last["tests"]:
        tests = [run["tests"][name] for run in runs if name in run["tests"]]
        passed = sum(test["outcome"] == "passed" for test in tests)
        rows.append(f"| `{name}` | {passed} of {len(tests)} | {merged([test['text'] for test in tests])} |")
    return "\n".join([head, *rows, ""])


def merged(texts: Sequence[str]) -> str:
    """Return one text for several that differ in their numbers alone: median (least to most); else the last one."""
    said = [" ".join(text.split()).replace("|", "&#124;") for text in texts]
    frames = {NUMBER.sub("#", text) for text in said}
    if len(said) < RUNS or len(frames) != 1:
        return said[-1]
    columns = zip(*(NUMBER.findall(text) for text in said), strict=True)
    shown = iter([_spread(column) for column in columns])
    return re.sub("#", lambda _: next(shown), frames.pop())


def _spread(column: Sequence[str]) -> str:
    values = [float(text.replace(",", "")) for text in column]
    if len(set(values)) == 1:
        return column[0]
    middle = column[int(np.argsort(values)[len(values) // 2])]
    return f"{middle} ({column[int(np.argmin(values))]} to {column[int(np.argmax(values))]})"


def recorded(groups: Sequence[Mapping[str, Any]]) -> str:
    """Return the sections of runs on record."""
    parts = []
    for group in groups:
        rows = [f"## {group['group']}\n"]
        for one in group["figures"]:
            shares = "; ".join(_share(share) for share in one.get("shares", ()))
            said = "; ".join(text for text in (one.get("measured", ""), shares) if text)
            place = f"{one['date']}, commit `{one['commit']}`" if "commit" in one else one["date"]
            rows.append(f"**{one['what'][:1].upper()}{one['what'][1:]}:** {said}.\n<br>`{one['command']}`, {place}\n")
        parts.append("\n".join(rows))
    return "\n".join(parts)


def _share(share: Mapping[str, Any]) -> str:
    low, high = binomial(share["count"], share["of"])
    return f"{share['what']}: {share['count']} of {share['of']} ({100 * low:.1f} to {100 * high:.1f} %)"


def binomial(count: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """Return the interval of Clopper and Pearson for a share of `count` in `total`."""
    tail = (1 - level) / 2
    low = 0.0 if count == 0 else float(betaincinv(count, total - count + 1, tail))
    high = 1.0 if count == total else float(betaincinv(count + 1, total - count, 1 - tail))
    return low, high
