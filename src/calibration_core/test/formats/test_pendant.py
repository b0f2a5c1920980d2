"""A plan as a program for the pendant: read back by the project's own reader, as slow as stated, in the run's order."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.cell.library import library
from calibration_core.cell.serial_chain import serial_chain
from calibration_core.cli import main
from calibration_core.files.yaml_file import read_yaml, yaml_text
from calibration_core.formats.pendant import MAKERS, plain
from calibration_core.measurement import messages as m
from calibration_core.measurement.sequence import Sequence
from calibration_core.model.nominal import nominal_parameters, tool_point
from calibration_core.model.robot import chain_of
from calibration_core.motion.speed import Monitored
from calibration_core.planning.plans.measurement_queue import SequenceRules
from calibration_core.planning.plans.plan import Plan, PlannedConfiguration, Reference
from calibration_core.planning.plans.plan_file import plan_text, read_plan
from calibration_core.planning.route import stops
from calibration_core.recording.foreign.mapping import ImportMap, import_map
from calibration_core.recording.foreign.source import read_source

COUPLED = {"joint_coupling": {"q3": {"q2": 1.0}}}
RAIL = {"files": [{"match": "calib*", "columns": {"E1": "q1"}, "units": {"q1": "mm", "q": "deg"}}]}
SPEEDS = {
    "kuka": "156 156 156 330 330 615",
    "yaskawa": "210 210 265 420 420 885",
}  # deg/s: data sheets, KR 16-2 and GP25
PULSES = "1434.5 1434.5 1290.9 1022.9 980.3 454.8"
ROBOTS = {
    "kuka": "kuka_kr16_2", "abb": "abb_irb4600_40_255", "fanuc": "fanuc_m20ia", "yaskawa": "yaskawa_gp25",
    "ur": "ur_ur10e",
}  # fmt: skip
LIMIT = 0.2375  # m/s: what the sequencer plans its own motions for


def write_cell(folder: Path, maker: str, title: str = "a cell", **robot: Any) -> Path:
    """Write a cell with the maker's robot, or with other entries of a robot."""
    one = library()[ROBOTS[maker]]
    about = serial_chain(one.urdf)
    usual = {"name": one.name, "maker": one.maker, "urdf": str(one.urdf), "base_link": about.base_link,
             "flange": about.flange, "joints": list(about.joints), "rated_load": one.rated_load}  # fmt: skip
    content = {
        "name": title,
        "robot": robot if "dh" in robot else {**usual, **robot},
        "frames": {"measurement_points": {"mp1": [0.1, 0.0, 0.1]}, "wrench_point": [0.0, 0.1, 0.2]},
        "instruments": {"tracker": {"sigma": 2e-5}},
        "end_effector": {"mass": 1.0, "com": [0.0, 0.0, 0.1]},
    }
    path = folder / "cell.yaml"
    path.write_text(yaml_text(content), "utf-8")
    return path


def write_plan(cell: Cell, path: Path) -> Plan:
    """Write a plan with everything that a plan may hold."""
    rng, (low, high) = np.random.default_rng(3), chain_of(cell).limits.T
    q = 0.5 * (low + high) + 0.4 * (high - low) * rng.uniform(-1.0, 1.0, (12, len(low)))
    loads = np.zeros((3, 6))
    loads[1, 2] = -10.0
    plan = Plan(
        cell.robot.name,
        cell.robot.joints,
        tuple(PlannedConfiguration(k, q[k], loads, spare=k > 4) for k in range(1, 7)),
        q[7:9],
        Reference(q[0], 2),
        preparation=tuple(PlannedConfiguration(1000 + k, q[8 + k], np.zeros((1, 6)), phase="points") for k in (1, 2)),
    )
    path.write_text(plan_text(plan), "utf-8")
    return read_plan(path, cell)


def pendant(folder: Path, maker: str, how: dict[str, Any] | None = None, *more: str) -> int:
    """Run the program on the cell and plan of a folder."""
    options = ["--axis-speeds", SPEEDS[maker]] if maker in SPEEDS and "--axis-speeds" not in more else []
    options += ["--pulses", PULSES] if maker == "yaskawa" else []
    if how is not None:
        (folder / "map.yaml").write_text(yaml_text(how), "utf-8")
        options += ["--map", str(folder / "map.yaml")]
    files = (str(folder / "plan.yaml"), "--cell", str(folder / "cell.yaml"), "--maker", maker)
    return main(["pendant", *files, *options, *more, "--out", str(folder / "out")])


def read_back(path: Path, how: dict[str, Any] | None) -> np.ndarray:
    """Joint angles of a program by the reader of `import`, with the same map; (m, n) rad and m."""
    stated = ImportMap() if how is None else import_map(path, how)
    source = read_source(path, stated.of(path))
    q = np.column_stack([source.numbers[f"q{i + 1}"] for i in range(source.joints)])
    for name, parts in stated.joint_coupling.items():
        for other, factor in parts.items():
            q[:, int(name[1:]) - 1] += factor * source.numbers[other]
    return q


def pulses_of(text: str) -> np.ndarray:
    rows = [line.partition("=")[2].split(",") for line in text.splitlines() if re.match(r"C\d{5}=", line)]
    return np.radians(np.array(rows, dtype=float) / np.array(PULSES.split(), dtype=float))


def program(folder: Path, maker: str, part: str = "calib") -> str:
    return (folder / "out" / MAKERS[maker].file(part)).read_bytes().decode("ascii")


@pytest.fixture(params=list(ROBOTS))
def maker(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    name = str(request.param)
    cell = load_cell(write_cell(tmp_path, name, 'Zelle "Überlingen"; {1} #東'))
    write_plan(cell, tmp_path / "plan.yaml")
    assert pendant(tmp_path, name, COUPLED if name == "fanuc" else None) == 0
    return name


def test_a_program_holds_the_postures_of_the_run_in_its_order(maker: str, tmp_path: Path) -> None:
    cell = load_cell(tmp_path / "cell.yaml")
    plan = read_plan(tmp_path / "plan.yaml", cell)
    route = [item.q for item in stops(plan, SequenceRules())]
    parts = {"calib": route, "calib_s": [*(c.q for c in plan.spares), plan.reference.q], "calib_w": plan.startup_cycle}
    for part, q in parts.items():
        path, text = tmp_path / "out" / MAKERS[maker].file(part), program(tmp_path, maker, part)
        found = pulses_of(text) if maker == "yaskawa" else read_back(path, COUPLED if maker == "fanuc" else None)
        np.testing.assert_allclose(found, q, atol=2e-5 if maker == "yaskawa" else 2e-6)  # half a pulse
        halts = re.findall(r"^HALT ; stop|^ +Stop;|: +PAUSE ;|^PAUSE|blocking=True", text, re.MULTILINE)
        assert len(halts) - (maker == "abb") == len(q)  # its check of the mode stops, too


def asked_for(plan: Plan, blocked: int) -> list[np.ndarray]:
    """Postures that the procedure asks the operator for; one configuration cannot be reached, at no try."""
    sequence, waiting, asked = Sequence(plan, SequenceRules(startup_period=math.inf)), [], []
    for event in (m.Start(0.0), m.GuardHearing(0.0, hears=True), m.PermissionChanged(0.0, True, "", True)):
        waiting += sequence.handle(event)
    answers = {m.RequestLoad: m.LoadReached, m.AwaitSettled: m.Settled, m.TakeReading: m.ReadingConfirmed}
    while waiting:
        command = waiting.pop(0)
        if isinstance(command, m.Move):
            asked.append(command.q)
            here = command.configuration == blocked
            event = m.Blocked(0.0, command.request, "") if here else m.Arrived(0.0, command.request)
        elif type(command) in answers:
            event = answers[type(command)](0.0, command.request)
        else:
            continue
        waiting += sequence.handle(event)
    assert sequence.state is m.RunState.FINISHED
    return asked


def test_program_and_procedure_go_hand_in_hand(tmp_path: Path) -> None:
    """Whatever the procedure asks for is the next stop, or the same again, or the first of the spares."""
    cell = load_cell(write_cell(tmp_path, "abb"))
    plan = write_plan(cell, tmp_path / "plan.yaml")
    assert pendant(tmp_path, "abb") == 0
    main_one, spares = (read_back(tmp_path / "out" / f"{name}.mod", None) for name in ("calib", "calib_s"))
    np.testing.assert_allclose(asked_for(plan, blocked=-1), main_one, atol=1e-6)
    asked = asked_for(plan, blocked=3)
    again = next(k for k in range(1, len(asked)) if np.array_equal(asked[k], asked[k - 1]))
    del asked[again]
    spare = next(k for k, q in enumerate(asked) if np.abs(q - spares[0]).max() < 1e-6)
    np.testing.assert_allclose(asked[:spare], main_one[:spare], atol=1e-6)
    np.testing.assert_allclose(asked[spare + 1 :], [plan.reference.q] * len(asked[spare + 1 :]), atol=1e-6)


def test_a_program_says_what_the_sequencer_asks_for_within_the_makers_lengths(maker: str, tmp_path: Path) -> None:
    text = program(tmp_path, maker)
    sha256 = json.loads((tmp_path / "out" / "result.json").read_text())["input"]["sha256"]
    digest = next(one["sha256"] for one in sha256 if one["role"] == "plan")
    flat = re.sub(r"\s*;?\r?\n(\s*\d+: +)?[!']?", "", text)
    assert digest in flat
    for word in ("MANUAL REDUCED SPEED", "hold-to-run", "1 kg", "Uberlingen"):
        assert word in re.sub(r"\s*;?\r?\n(\s*\d+: +)?[!'] *", " ", text)
    assert ("\r\n" in text) == (maker != "ur")
    if maker in {"fanuc", "yaskawa"}:
        assert re.search(r"[\[']\d+/\d+ C3 LOADED", text)
        assert re.search(r"[\[']\d+/\d+ C1001 UNLOADED", text)
        assert max(map(len, re.findall(r"MESSAGE\[(.*)\]", text)), default=0) <= 24
        assert max(map(len, re.findall(r"(?:: +!|^')(.*?)(?: ;)?\r$", text, re.MULTILINE))) <= 32
    else:
        assert re.search(r"stop \d+ of \d+: configuration 3 \(compliance\), 3 readings, 1 of them loaded", text)
        assert re.search(r"stop \d+ of \d+: reference, 1 reading, unloaded", text)
        assert max(map(len, re.findall(r'"(.*?)"', text)), default=0) <= 80


def test_no_monitored_point_is_faster_than_stated_by_the_makers_definition(maker: str, tmp_path: Path) -> None:
    """Speeds at many places of every line, by the speed that the program states for it, at its peak."""
    cell = load_cell(tmp_path / "cell.yaml")
    q = np.stack([item.q for item in stops(read_plan(tmp_path / "plan.yaml", cell), SequenceRules())])
    text = program(tmp_path, maker)
    pattern = r"SVEL_JOINT\((.*?)\)|VJ=(\S+)|slow\\T:=([\d.]+)|J P\[\d+\] ([\d.]+)sec|v=([\d.]+)"
    stated = [float("".join(groups)) for groups in re.findall(pattern, text)]
    stated = stated[len(stated) - len(q) + 1 :]  # the first motion begins anywhere
    monitored = Monitored.of(chain_of(cell), nominal_parameters(cell), tool_point(cell))
    largest = []
    for start, end, speed in zip(q[:-1], q[1:], stated, strict=True):
        line = end - start
        pace = speed / np.abs(line).max()  # UR: rad/s of the fastest axis
        if maker in SPEEDS:  # % of the largest axis speeds
            pace = speed / 100.0 / (np.abs(np.degrees(line)) / np.array(SPEEDS[maker].split(), dtype=float)).max()
        elif maker != "ur":  # s; at worst it speeds up for half of it
            pace = 2.0 / speed
        places = start + np.linspace(0.0, 1.0, 500)[:, None] * line
        largest.append(float(monitored.speeds(places, np.broadcast_to(pace * line, places.shape)).max()))
    assert max(largest) <= LIMIT
    assert max(largest) > 0.9 * LIMIT
    first = float("".join(re.findall(pattern, text)[0]))
    if maker in {*SPEEDS, "ur"}:  # and from anywhere in any direction, all axes at once
        rates = first / 100.0 * np.radians(np.array(SPEEDS[maker].split(), dtype=float)) if maker != "ur" else first
        assert 0.5 * LIMIT < (monitored.lever @ np.broadcast_to(rates, 6)).max() <= LIMIT


@pytest.mark.parametrize("maker", ["kuka", "abb", "fanuc"])
def test_a_linear_unit_is_an_external_axis_in_mm(maker: str, tmp_path: Path) -> None:
    rows = [{"a": 0.0, "alpha": 1.57, "d": 0.4}] + [{"a": 0.4, "alpha": 1.57, "d": 0.1}] * 6
    robot = {
        "name": "on a rail", "dh": rows, "joints": [f"j{k}" for k in range(7)], "rated_load": 20.0,
        "joint_types": ["prismatic"] + ["revolute"] * 6, "joint_limits": [[0.0, 3.0]] + [[-2.0, 2.0]] * 6,
    }  # fmt: skip
    cell = load_cell(write_cell(tmp_path, maker, **robot))
    plan = write_plan(cell, tmp_path / "plan.yaml")
    letter = "A" if maker == "kuka" else "J"
    columns = RAIL["files"][0]["columns"] | {f"{letter}{k}": f"q{k + 1}" for k in range(1, 7)}
    how = {**COUPLED, "files": [{**RAIL["files"][0], "columns": columns}]}
    speeds = ("--axis-speeds", f"2000 {SPEEDS['kuka']}") if maker == "kuka" else ()
    assert pendant(tmp_path, maker, how, *speeds) == 0
    found = read_back(tmp_path / "out" / MAKERS[maker].file("calib"), how)
    np.testing.assert_allclose(found, [item.q for item in stops(plan, SequenceRules())], atol=2e-6)


def refused(folder: Path, capsys: pytest.CaptureFixture[str], *arguments: Any) -> str:
    capsys.readouterr()
    assert pendant(folder, *arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert not (folder / "out").exists()
    return error


def test_what_leaves_the_axes_open_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell = load_cell(write_cell(tmp_path, "fanuc"))
    write_plan(cell, tmp_path / "plan.yaml")
    assert "found 'FANUC M-20iA', expected a robot of this maker, or --maker fanuc" in refused(tmp_path, capsys, "abb")
    assert "robot.joint_coupling: found nothing, expected how J3 counts" in refused(tmp_path, capsys, "fanuc")
    for how, said in (
        ({"joint_coupling": {"q3": {"q9": 1.0}}}, "joint_coupling: found 'q9', expected two of q1"),
        ({"joint_coupling": {"q3": {"q2": 1.0}, "q2": {"q3": 1.0}}}, "couplings that undo each other"),
        ({**COUPLED, "files": [{"match": "*.src"}]}, "expected a pattern that fits calib.ls"),
        ({**COUPLED, "files": [{"units": {"q": "rad"}}]}, "files.units.q1: found rad, expected deg"),
        ({**COUPLED, "files": [{"columns": {"J1": "q1", "J2": "q2"}}]}, "files.columns: found J1, J2, nothing"),
        ({"sign": {"q1": -1}}, "an unknown key"),
    ):
        assert said in refused(tmp_path, capsys, "fanuc", how)
    write_cell(tmp_path, "fanuc", joint_coupling={cell.robot.joints[2]: {cell.robot.joints[1]: 1.0}})
    assert "joint_coupling: found a coupling, as in the cell file" in refused(tmp_path, capsys, "fanuc", COUPLED)
    assert pendant(tmp_path, "fanuc") == 0
    own = program(tmp_path, "fanuc")
    write_cell(tmp_path, "fanuc")
    assert pendant(tmp_path, "fanuc", COUPLED) == 0
    assert program(tmp_path, "fanuc") == own
    assert pendant(tmp_path, "fanuc", {"joint_coupling": {"q3": {"q2": 0.0}}}) == 0
    assert program(tmp_path, "fanuc") != own


def test_numbers_and_plans_that_cannot_be_used_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell = load_cell(write_cell(tmp_path, "kuka"))
    write_plan(cell, tmp_path / "plan.yaml")
    for text in ("", "1 2 3", "1 2 3 4 5 x", "1 2 3 4 5 nan", "1 2 3 4 5 -6", "1,5 2,5 3 4 5 6"):
        assert "--axis-speeds: found" in refused(tmp_path, capsys, "kuka", None, "--axis-speeds", text)
    fast = " ".join(["90000"] * 6)
    assert "mm/s on the way to configuration" in refused(tmp_path, capsys, "kuka", None, "--axis-speeds", fast)
    assert "no effect for kuka" in refused(tmp_path, capsys, "kuka", None, "--pulses", PULSES)
    good = read_yaml(tmp_path / "plan.yaml", 1 << 20, "plan").data
    for change, said in (
        ({"robot": "another"}, "expected the cell's robot"),
        ({"configurations": []}, "configurations: found []"),
        ({"startup_cycle": [[9.0] * 6]}, "within the joint's limits"),
    ):
        (tmp_path / "plan.yaml").write_text(yaml_text({**good, **change}), "utf-8")
        assert said in refused(tmp_path, capsys, "kuka")
    (tmp_path / "plan.yaml").write_bytes(b"\x00\xff" * 40)
    assert "plan.yaml" in refused(tmp_path, capsys, "kuka")


def test_remarks_are_plain() -> None:
    assert plain('Zelle "Überlingen";\r\n{1}') == "Zelle _Uberlingen_____1_"
    assert plain("東京") == "__"
