"""What `identify` and `diagnose` answer today, figure by figure, and what differs from what stands written down.

`characterisation.yaml` holds the answers of the bag that comes with the project, of the recordings of others that lie
beside it (figures alone), and of sixty recordings with concealed effects.  A change of an answer is a decision: this
program prints the lines that differ, and its author says why the new ones are better before they are written down.

    python test/test_characterisation.py [CASE ...]            print what differs, `-` written down, `+` now
    python test/test_characterisation.py --write [CASE ...]    write down what is answered now
"""

from __future__ import annotations

import contextlib
import difflib
import io
import json
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from calibration_core.cli import main as calibration
from calibration_sim.proving.writing import CELL, TABLE, folder_of, write_recordings
from calibration_sim.scenarios.grid import grid, sample

ROOT = Path(__file__).resolve().parents[1]
BESIDE = Path("shared/data/real")  # beside the project, or beside the folder of its work trees
REAL = next((found for parent in ROOT.parents if (found := parent / BESIDE).is_dir()), ROOT.parent / BESIDE)
WRITTEN = Path(__file__).with_name("characterisation.yaml")
COMMANDS = ("identify", "diagnose")
SEED, COUNT = 7078, 60  # of the concealed effects; a seed of this file alone
DIGITS = 4
TESTS = {"ur5_grid": "ur5_random", "wam_grid": "wam_random"}
OTHERS = ("fanuc", "motoman", "ur10_A", "ur10_B", "ur10_C", "ur10_D", *TESTS)

Lines = list[str]
Case = Mapping[str, Lines]  # command -> what it answers, a line each


def _arguments(name: str) -> list[str]:
    """Return recording and options of a case that lies in a file."""
    if name == "small_loaded":
        return [str(ROOT / "bags" / name), "--cell", str(ROOT / "config/cells/small.cell.yaml")]
    cell = REAL / f"{name.removesuffix('_grid')}.cell.yaml"
    test = ["--test", str(REAL / f"{TESTS[name]}.csv")] if name in TESTS else []
    return [str(REAL / f"{name}.csv"), "--cell", str(cell), *test]


def cases(chosen: list[str], folder: Path) -> Iterator[tuple[str, Case]]:
    """Answer one case after another; without a choice, all whose files are there."""
    given = ["small_loaded", *(OTHERS if REAL.is_dir() else ())]
    concealed = sample(grid(SEED), COUNT)
    for name in given:
        if not chosen or name in chosen:
            yield name, {command: _answer(command, _arguments(name), folder) for command in COMMANDS}
    names = write_recordings(concealed, len(grid(SEED)), folder, jobs=1)[0] if _wants_concealed(chosen) else []
    for name in names:
        if not chosen or name in chosen or "concealed" in chosen:
            files = folder_of(folder, name)
            arguments = [str(files / TABLE), "--cell", str(files / CELL)]
            yield name, {"diagnose": _answer("diagnose", arguments, folder, brief=True)}


def _wants_concealed(chosen: list[str]) -> bool:
    return not chosen or any(name == "concealed" or name.startswith(("r0", "r1")) for name in chosen)


def _answer(command: str, arguments: list[str], folder: Path, *, brief: bool = False) -> Lines:
    """Run a command in this process and return its answer, a line a figure."""
    out = folder / "out"
    said = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        code = calibration([command, *arguments, "--out", str(out), "--no-report"])
    if code != 0:
        return [f"exit {code}: {said.getvalue().strip().splitlines()[-1]}"]
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    model = yaml.safe_load((out / "model.yaml").read_text(encoding="utf-8"))
    return [*_result(result), *_model(model, brief=brief)]


def _result(result: Mapping[str, Any]) -> Lines:
    lines = [f"verdict: {result['verdict']}"] if "verdict" in result else []
    for row in result["stiffness"]:
        low, high = row.get("interval_95") or (None, None)
        lines.append(f"stiffness {row['joint']}: {_plain(row['value'])} [{_plain(low)}, {_plain(high)}] {_known(row)}")
    lines += [f"fit {key}: {_plain(value)}" for key, value in result["fit"].items() if isinstance(value, float)]
    lines += [f"blocks {key}: {_plain(value)}" for key, value in (result.get("blocks") or {}).items()]
    if result.get("test"):
        lines.append(f"test: {_plain({k: v for k, v in result['test'].items() if k not in {'file', 'sha256'}})}")
    lines += [f"finding: {_finding(one)}" for one in result.get("findings", ())]
    lines += [f"anomaly: {_plain({k: one.get(k) for k in ANOMALY})}" for one in result.get("anomalies", ())]
    if "unexplained" in result:
        lines.append(f"rest: {_plain({k: result['unexplained'].get(k) for k in ('rms', 'significant', 'where')})}")
    return lines


NO_ANSWERS = {"cell", "joints", "robot", "robot_sha256", "parameters", "covariance", "valid_range"}  # of a model file
ANOMALY = ("kind", "location", "configurations", "magnitude")


def _known(row: Mapping[str, Any]) -> str:
    return "identifiable" if row["identifiable"] else "not identifiable"


def _finding(one: Mapping[str, Any]) -> str:
    place, size = _plain(one["location"]), _plain(one["evidence"].get("magnitude"))
    beside = [f"{other['effect']} {_plain(other['location'])}" for other in one.get("cannot_be_told_from", ())]
    parameters = ", ".join(f"{p['name']} {_plain(p['value'])} ± {_plain(p.get('std'))}" for p in one["parameters"])
    said = f"{one['effect']} {place}, moves {size} m; {parameters}"
    return f"{said}; or {', '.join(beside)}" if beside else said


def _model(model: Mapping[str, Any], *, brief: bool) -> Lines:
    """Return the model file, a line a branch; briefly: its effects."""
    keys = ["effects"] if brief else [key for key in model if key not in NO_ANSWERS]
    lines = []
    for key in keys:
        value = model.get(key)
        items = value if isinstance(value, list) and value and isinstance(value[0], dict) else [value]
        lines += [f"model {key}: {_plain(item)}" for item in items]
    return lines


def _plain(value: Any) -> str:
    """Return a value as text, numbers to four digits."""
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.{DIGITS}g}"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_plain(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_plain, value)) + "]"
    return str(value)


def differences(name: str, now: Case) -> Lines:
    """Return the lines of a case that are no longer, and those that are new."""
    known = yaml.load(WRITTEN.read_text(encoding="utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    written: Case = known.get(name, {})
    changed = []
    for command in sorted({*now, *written}):
        lines = difflib.ndiff(written.get(command, []), now.get(command, []))
        changed += [f"{name} {command} {line}" for line in lines if line[0] in "+-"]
    return changed


@pytest.mark.slow
def test_every_answer_is_the_one_that_stands_written_down(tmp_path: Path) -> None:
    changed = [line for name, now in cases([], tmp_path) for line in differences(name, now)]
    assert not changed, "\n".join([f"{len(changed)} lines differ", *changed])


@pytest.fixture(scope="module")
def of_bag(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Case]:
    """Return the case of the bag that comes with the project, and what is answered now."""
    (answered,) = cases(["small_loaded"], tmp_path_factory.mktemp("bag"))
    return answered


def test_the_answer_for_the_bag_is_the_one_that_stands_written_down(of_bag: tuple[str, Case]) -> None:
    changed = differences(*of_bag)
    assert not changed, "\n".join(changed)


def test_a_changed_figure_is_shown_with_both_its_values(of_bag: tuple[str, Case]) -> None:
    name, now = of_bag
    other = {
        **now,
        "diagnose": [line.replace("verdict: consistent", "verdict: unexplained") for line in now["diagnose"]],
    }
    assert differences(name, other) == [
        "small_loaded diagnose - verdict: consistent",
        "small_loaded diagnose + verdict: unexplained",
    ]


def main(arguments: list[str]) -> int:
    """Print what differs, or write it down; return 0, or 1 where something differs."""
    write = "--write" in arguments
    chosen = [one for one in arguments if one != "--write"]
    changed = 0
    written = yaml.safe_load(WRITTEN.read_text(encoding="utf-8")) if WRITTEN.is_file() else {}
    with tempfile.TemporaryDirectory() as folder:
        for name, now in cases(chosen, Path(folder)):
            if write:
                written[name] = dict(now)
                continue
            lines = differences(name, now)
            changed += len(lines)
            sys.stdout.writelines(f"{line}\n" for line in lines)
            sys.stdout.flush()
    if write:
        WRITTEN.write_text(yaml.safe_dump(written, allow_unicode=True, width=10_000, sort_keys=False), encoding="utf-8")
    return 1 if changed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
