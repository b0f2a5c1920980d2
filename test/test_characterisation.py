"""What `identify` and `diagnose` answer today, and what differs from what stands written down by more than it may.

`characterisation.yaml` holds the answers of the bag that comes with the project, of the recordings of others that lie
beside it (figures alone), of sixty recordings with concealed effects, and of recordings of every kind: mixed, several,
in phases, and small.  An estimate may move by a tenth of its standard deviation, evidence by half a nat, a length by
one per cent; names and decisions may not move at all.  A change beyond that is a decision: this program prints it, and
its author says why the new answer is better before it is written down.

    export PYTHONPATH=test/phases
    python test/test_characterisation.py [CASE ...]            print what differs
    python test/test_characterisation.py --write [CASE ...]    write down what is answered now
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from phase_cases import bare_cell
from phase_cases import play as play_phases

from calibration_core.cell import Cell
from calibration_core.cli import main as calibration
from calibration_core.files.yaml_file import read_yaml, yaml_text
from calibration_core.recording.tables.table import write_table
from calibration_core.timeseries import Readings
from calibration_sim.cell.configurations import random_protocol
from calibration_sim.cell.truth import draw_truth
from calibration_sim.effects.draw import robot_cell
from calibration_sim.effects.effect import Effect, Label
from calibration_sim.effects.structure import Beam, Bearing
from calibration_sim.proving.writing import CELL, TABLE, folder_of, write_recordings
from calibration_sim.scenarios.generate import EVERYWHERE
from calibration_sim.scenarios.grid import grid, sample
from calibration_sim.scenarios.measure import Noise, look
from calibration_sim.scenarios.protocols import make_protocol
from calibration_sim.scenarios.world import World, play

ROOT = Path(__file__).resolve().parents[1]
BESIDE = Path("shared/data/real")  # beside the project, or beside the folder of its work trees
REAL = next((found for parent in ROOT.parents if (found := parent / BESIDE).is_dir()), ROOT.parent / BESIDE)
WRITTEN = Path(__file__).with_name("characterisation.yaml")
COMMANDS = ("identify", "diagnose")
SEED, COUNT = 7078, 60  # of the concealed effects; a seed of this file alone
TESTS = {"ur5_grid": "ur5_random", "wam_grid": "wam_random"}
OTHERS = ("fanuc", "motoman", "ur10_A", "ur10_B", "ur10_C", "ur10_D", *TESTS)

STANDARD_DEVIATIONS = 0.1  # by which an estimate may move: far below what anybody would notice
UNCERTAINTY = 0.05  # by which its standard deviation may, relative
NATS = 0.5  # by which evidence may: below 1, "not worth more than a bare mention" (Kass and Raftery 1995)
LENGTH, SMALLEST = 0.01, 1e-8  # by which a length may, relative, and m, where it is next to nothing

Answer = dict[str, Any]
Case = Mapping[str, Answer]  # command -> what it answers
Made = Callable[[Path], list[str]]  # writes files into a folder; returns recordings and options

BEARING = Bearing(Label("structure", "off_axis_compliance", {"joint": "joint_3"}), 2, (6e-7, 6e-7))
BENDING = Beam(Label("structure", "link_bending", {"link": "link_2"}), 1, (6e-7, 3e-7), 3e-7, 0.2)


# --- recordings that are made -----------------------------------------------------------------------------------------


def _recorded(folder: Path, kinds: Sequence[str], seed: int, *effects: Effect, count: int = 3) -> list[str]:
    """Play one robot under protocols; kinds as for `make_protocol`, or a number of configurations of two steps."""
    cell = robot_cell("heavy")
    world = World(cell, draw_truth(cell, seed, spread=EVERYWHERE)).with_effects(*effects)
    points = tuple(cell.frames.measurement_points)[:count]
    tables = []
    for k, kind in enumerate(kinds):
        if kind.isdigit():
            protocol = random_protocol(cell, int(kind), seed + k, levels=(0.0, 1.0))
        else:
            protocol = make_protocol(cell, kind, seed + k)
        readings = look(world, play(world, protocol), points, Noise(), seed + k)
        tables.append(_table(folder, readings))
    return [*tables, "--cell", _cell(folder, cell)]


def _phases(folder: Path, seed: int) -> list[str]:
    return [_table(folder, play_phases(seed)[1]), "--cell", _cell(folder, bare_cell(), "tracker")]


def _table(folder: Path, readings: Readings) -> str:
    path = folder / f"recording_{len(list(folder.glob('*.csv')))}.csv"
    write_table(path, readings)
    return str(path)


def _cell(folder: Path, cell: Cell, *unknown: str) -> str:
    """Write a cell's file without some of its frames."""
    data: dict[str, Any] = read_yaml(cell.path, 1 << 18, "cell file (YAML)").data
    if "urdf" in data["robot"]:
        data["robot"]["urdf"] = str((cell.path.parent / data["robot"]["urdf"]).resolve())
    for name in unknown:
        del data["frames"][name]
    path = folder / CELL
    path.write_text(yaml_text(data), encoding="utf-8")
    return str(path)


MADE: Mapping[str, Made] = {
    "mixed_nothing": lambda folder: _recorded(folder, ["L12A36"], 501),
    "mixed_bending": lambda folder: _recorded(folder, ["L12A36"], 502, BENDING),
    "mixed_few_at_rest": lambda folder: _recorded(folder, ["L18A1"], 503, BEARING),
    "mixed_few_loaded": lambda folder: _recorded(folder, ["L2A40"], 504, BENDING),
    "several_loaded": lambda folder: _recorded(folder, ["L9", "L9"], 511, BEARING),
    "several_at_rest": lambda folder: _recorded(folder, ["A40", "A30"], 512, BENDING),
    "several_kinds": lambda folder: _recorded(folder, ["L9", "A40"], 513, BENDING),
    "phases_1": lambda folder: _phases(folder, 1),
    "phases_2": lambda folder: _phases(folder, 2),
    "small_nothing": lambda folder: _recorded(folder, ["12"], 521, count=1),
    "small_bearing": lambda folder: _recorded(folder, ["12"], 522, BEARING, count=1),
    "small_bearing_16": lambda folder: _recorded(folder, ["16"], 523, BEARING, count=1),
    "small_bending_18": lambda folder: _recorded(folder, ["18"], 524, BENDING, count=1),
}


def _arguments(name: str, folder: Path) -> list[str]:
    """Return recordings and options of a case."""
    if name in MADE:
        own = folder / name
        own.mkdir()
        return MADE[name](own)
    if name == "small_loaded":
        return [str(ROOT / "bags" / name), "--cell", str(ROOT / "config/cells/small.cell.yaml")]
    cell = REAL / f"{name.removesuffix('_grid')}.cell.yaml"
    test = ["--test", str(REAL / f"{TESTS[name]}.csv")] if name in TESTS else []
    return [str(REAL / f"{name}.csv"), "--cell", str(cell), *test]


def cases(chosen: list[str], folder: Path) -> Iterator[tuple[str, Case]]:
    """Answer one case after another; without a choice, all whose files are there."""
    for name in ["small_loaded", *MADE, *(OTHERS if REAL.is_dir() else ())]:
        if not chosen or name in chosen:
            arguments = _arguments(name, folder)
            yield name, {command: answer(command, arguments, folder) for command in COMMANDS}
    concealed = sample(grid(SEED), COUNT)
    wanted = not chosen or any(name == "concealed" or name.startswith(("r0", "r1")) for name in chosen)
    names = write_recordings(concealed, len(grid(SEED)), folder, jobs=1)[0] if wanted else []
    for name in names:
        if not chosen or name in chosen or "concealed" in chosen:
            files = folder_of(folder, name)
            yield (
                name,
                {"diagnose": answer("diagnose", [str(files / TABLE), "--cell", str(files / CELL)], folder, brief=True)},
            )


# --- answers ----------------------------------------------------------------------------------------------------------


def answer(command: str, arguments: list[str], folder: Path, *, brief: bool = False) -> Answer:
    """Run a command in this process and return its answer; briefly: without the parameters of the model file."""
    out = folder / "out"
    said = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        code = calibration([command, *arguments, "--out", str(out), "--no-report"])
    if code != 0:
        return {"exit": code, "says": said.getvalue().strip().splitlines()[-1].replace(str(folder), "")}
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    model = yaml.safe_load((out / "model.yaml").read_text(encoding="utf-8"))
    unexplained = result.get("unexplained") or {}
    return _rounded(
        {
            "verdict": result.get("verdict"),
            "usable": result.get("usable"),
            "stiffness": {one["joint"]: _estimate(one["value"], one.get("std")) for one in result["stiffness"]},
            "rigid_or_unknown": [one["joint"] for one in result["stiffness"] if not one["identifiable"]],
            "lengths": {**_lengths(result["fit"]), "unexplained": unexplained.get("rms")},
            "blocks": _lengths(result.get("blocks") or {}),
            "test": _lengths(result.get("test") or {}),
            "unexplained": {key: unexplained.get(key) for key in ("significant", "where")},
            "findings": {f"{one['effect']} {one['location']}": _finding(one) for one in result.get("findings", ())},
            "anomalies": [[one["kind"], one.get("location"), one.get("configurations")] for one in _anomalies(result)],
            "model": {
                one["name"]: _estimate(one["value"], one.get("std")) for one in ([] if brief else model["parameters"])
            },
        }
    )


def _anomalies(result: Mapping[str, Any]) -> list[dict[str, Any]]:
    return list(result.get("anomalies") or ())


def _estimate(value: float | None, std: float | None) -> dict[str, Any]:
    return {"value": value, "std": std}


def _lengths(figures: Mapping[str, Any]) -> dict[str, float]:
    return {key: value for key, value in figures.items() if isinstance(value, float)}


def _finding(one: Mapping[str, Any]) -> Answer:
    return {
        "nats": one["evidence"].get("log_bayes_factor"),
        "magnitude": one["evidence"].get("magnitude"),
        "parameters": {p["name"]: _estimate(p["value"], p.get("std")) for p in one["parameters"]},
        "cannot_be_told_from": sorted(
            f"{other['effect']} {other['location']}" for other in one.get("cannot_be_told_from", ())
        ),
    }


def _rounded(value: Any) -> Any:
    """Return the same with numbers of five digits: far more than is compared."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value


def differences(written: Any, now: Any, place: str = "") -> list[str]:
    """Return what differs by more than it may, a line each."""
    if isinstance(written, dict) and isinstance(now, dict):
        if {*written} == {*now} == {"value", "std"}:
            return [] if _same_estimate(written, now) else [f"{place}: {_plain(written)} -> {_plain(now)}"]
        return [
            line
            for key in dict.fromkeys([*written, *now])
            for line in differences(written.get(key), now.get(key), f"{place} {key}".strip())
        ]
    return [] if _same(written, now, place) else [f"{place}: {written} -> {now}"]


def _same_estimate(written: Mapping[str, float | None], now: Mapping[str, float | None]) -> bool:
    if None in {*written.values(), *now.values()} or not written["std"]:
        return _same(written["value"], now["value"], "") and _same(written["std"], now["std"], "")
    (before, std), (value, uncertainty) = written.values(), now.values()
    moved, wider = abs(value - before) / std, abs(uncertainty / std - 1.0)  # type: ignore[operator]
    return bool(moved <= STANDARD_DEVIATIONS and wider <= UNCERTAINTY)


def _same(written: Any, now: Any, place: str) -> bool:
    numbers = all(isinstance(one, int | float) and not isinstance(one, bool) for one in (written, now))
    if not numbers or written == now:
        return bool(written == now)
    if place.endswith("nats"):
        return bool(abs(now - written) <= max(NATS, LENGTH * abs(written)))
    return bool(np.isclose(now, written, rtol=LENGTH, atol=SMALLEST))


def _plain(estimate: Mapping[str, float | None]) -> str:
    return f"{estimate['value']} ± {estimate['std']}"


def unequal_estimates(case: Case, name: str) -> list[str]:
    """Return where the model file holds another stiffness, or another uncertainty of it, than the result shows."""
    lines = []
    for command, one in case.items():
        for joint, shown in one.get("stiffness", {}).items():
            held = one["model"].get(f"compliance.{joint}")
            if held is None or joint in one["rigid_or_unknown"]:
                continue
            ratios = shown["value"] * held["value"], held["std"] * shown["value"] ** 2 / shown["std"]
            if not np.allclose(ratios, 1.0, rtol=1e-3):
                lines.append(f"{name} {command} {joint}: {_plain(shown)} shown, {_plain(held)} handed out")
    return lines


def written_answers() -> dict[str, Case]:
    """Return what stands written down."""
    text = WRITTEN.read_text(encoding="utf-8")
    return yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader)) or {}


@pytest.mark.slow
def test_every_answer_is_the_one_that_stands_written_down(tmp_path: Path) -> None:
    written = written_answers()
    changed = []
    for name, now in cases([], tmp_path):
        changed += [*differences(written.get(name, {}), dict(now), name), *unequal_estimates(now, name)]
    assert not changed, "\n".join([f"{len(changed)} lines differ", *changed])


@pytest.mark.parametrize("name", ["small_loaded", "small_bearing", "mixed_nothing", "phases_1"])
def test_the_answer_is_the_one_that_stands_written_down(name: str, tmp_path: Path) -> None:
    ((_, now),) = cases([name], tmp_path)
    assert not differences(written_answers()[name], dict(now), name)
    assert not unequal_estimates(now, name)


def test_what_may_not_move_is_shown_with_both_its_values() -> None:
    written = {
        "verdict": "consistent",
        "stiffness": {"joint_1": _estimate(1e6, 1e4)},
        "lengths": {"rms": 1e-5},
        "findings": {"backlash": {"nats": 30.0}},
    }
    near = {
        "verdict": "consistent",
        "stiffness": {"joint_1": _estimate(1.0009e6, 1.04e4)},
        "lengths": {"rms": 1.009e-5},
        "findings": {"backlash": {"nats": 30.4}},
    }
    assert not differences(written, near)
    far = {
        "verdict": "unexplained",
        "stiffness": {"joint_1": _estimate(1.0011e6, 1e4), "joint_2": _estimate(1e6, 1e4)},
        "lengths": {"rms": 1.02e-5},
        "findings": {"backlash": {"nats": 30.6}},
    }
    assert differences(written, far) == [
        "verdict: consistent -> unexplained",
        "stiffness joint_1: 1000000.0 ± 10000.0 -> 1001100.0 ± 10000.0",
        "stiffness joint_2: None -> {'value': 1000000.0, 'std': 10000.0}",
        "lengths rms: 1e-05 -> 1.02e-05",
        "findings backlash nats: 30.0 -> 30.6",
    ]


def main(arguments: list[str]) -> int:
    """Print what differs, or write it down; return 0, or 1 where something differs."""
    write = "--write" in arguments
    written = written_answers() if WRITTEN.is_file() else {}
    changed = 0
    with tempfile.TemporaryDirectory() as folder:
        for name, now in cases([one for one in arguments if one != "--write"], Path(folder)):
            lines = (
                differences(written[name], dict(now), name) if name in written else [f"{name}: not written down yet"]
            )
            changed += len(lines)
            sys.stdout.writelines(f"{line}\n" for line in lines)
            sys.stdout.flush()
            written[name] = dict(now)
    if write:
        WRITTEN.write_text(
            yaml.safe_dump(written, allow_unicode=True, width=10_000, sort_keys=False, default_flow_style=None),
            encoding="utf-8",
        )
    return 1 if changed and not write else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
