"""The proof of the fleet on a simulated plant: damaged robots found, speed, memory, the same answer after every kill.

`FLEET_ROBOTS` says how large the plant is (default 600, three dates each); bars of time are scaled with it.  The
figures are printed.
"""

from __future__ import annotations

import csv
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("distributed")
pytest.importorskip("pyarrow")

from plant import HEALTHY, TRUTH, plant, write_plant

from calibration_core.fleet.recordings.store import read_dataset

pytestmark = pytest.mark.slow

BIN = Path(sys.executable).parent
ROBOTS = int(os.environ.get("FLEET_ROBOTS", "600"))
FULL = 1800  # recordings to which the bars of time belong
JOBS = 2
SEED = 20261
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
APART = {"seconds", "megabytes", "host"}
KILLED = int(os.environ.get("FLEET_KILLED", "24"))  # robots of the plant whose workers and client are killed


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("proof")
    begun = time.monotonic()
    write_plant(plant(SEED, ROBOTS, 3, 0.03), folder / "plant", JOBS)
    print(f"\n{3 * ROBOTS} recordings made in {time.monotonic() - begun:.0f} s")
    return folder


@pytest.fixture(scope="module")
def evaluated(made: Path) -> tuple[Path, float]:
    """The output folder, and how long it took, s."""
    begun = time.monotonic()
    fleet(made / "plant" / "plant.csv", made / "out")
    return made / "out", time.monotonic() - begun


def fleet(manifest: Path, out: Path, *options: str) -> str:
    command = [BIN / "calibration", "fleet", manifest, "--out", out, "--jobs", str(JOBS), *options]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def said(out: Path) -> list[dict[str, object]]:
    rows = [row.to_dict() for row in read_dataset(out / "fleet.parquet")]
    return [{name: value for name, value in row.items() if name not in APART} for row in rows]


def test_damaged_robots_are_found(made: Path, evaluated: tuple[Path, float]) -> None:
    truth = json.loads((made / "plant" / TRUTH).read_text(encoding="utf-8"))
    damaged = {one["robot"]: one["damage"] for one in truth if one["damage"] != HEALTHY}
    healthy = {one["robot"] for one in truth} - set(damaged)
    ranking = list(csv.DictReader((evaluated[0] / "ranking.csv").open(encoding="utf-8")))
    accused = {one["robot"]: one["reasons"] for one in ranking if one["state"] == "conspicuous"}
    found, wrong = len(damaged.keys() & accused), len(healthy & accused.keys())
    print(f"\ndamaged found {found} of {len(damaged)}, healthy accused {wrong} of {len(healthy)}")
    print("missed:", {robot: damage for robot, damage in damaged.items() if robot not in accused})
    print("accused:", {robot: reasons for robot, reasons in accused.items() if robot in healthy})
    assert found >= 0.95 * len(damaged)
    assert wrong <= max(0.005 * len(healthy), 1)  # of fewer than 200 one: no smaller share can be seen


def test_broken_recordings_and_wrong_cell_files_are_rows(made: Path, evaluated: tuple[Path, float]) -> None:
    truth = json.loads((made / "plant" / TRUTH).read_text(encoding="utf-8"))
    rows = {row.recording: row for row in read_dataset(evaluated[0] / "fleet.parquet")}
    assert len(rows) == len(truth)
    faulty = [rows[str(made / "plant" / one["recording"])] for one in truth if one["fault"]]
    refused = sum(not row.measured or row.usable == "no" for row in faulty)
    print(f"\nbroken recordings and wrong cell files that gave no stiffness: {refused} of {len(faulty)}")
    assert refused == len(faulty)


def test_a_run_without_anything_new_is_quick(made: Path, evaluated: tuple[Path, float]) -> None:
    before = said(evaluated[0])
    begun = time.monotonic()
    fleet(made / "plant" / "plant.csv", evaluated[0])
    took = time.monotonic() - begun
    print(f"\nagain, unchanged: {took:.1f} s")
    assert said(evaluated[0]) == before
    assert took <= 20.0 * max(1.0, 3 * ROBOTS / FULL)


def test_the_plant_is_done_in_time(evaluated: tuple[Path, float]) -> None:
    """Forty-five minutes for 1,800 recordings; `test_fleet_speed.py` says what of it is the engine's."""
    out, whole = evaluated
    rows = read_dataset(out / "fleet.parquet")
    busy = sum(row.seconds for row in rows) / JOBS
    print(
        f"\n{len(rows)} recordings with {JOBS} processes: {whole / 60:.1f} min, {busy / 60:.1f} of them processor time"
    )
    assert whole <= 45 * 60 * len(rows) / FULL + 30


def test_the_memory_of_a_worker_stays_flat(evaluated: tuple[Path, float]) -> None:
    """Over its first 600 recordings."""
    workers: dict[str, list[tuple[str, float]]] = defaultdict(list)
    for path in sorted((evaluated[0] / "results").rglob("row.json"), key=lambda path: path.stat().st_mtime_ns):
        row = json.loads(path.read_text(encoding="utf-8"))
        workers[row["host"]].append((row["type"], row["megabytes"]))
    assert workers
    for host, used in workers.items():
        sizes = np.array([size for _, size in used[:600]])
        third = len(sizes) // 3
        early, late = np.median(sizes[:third]), np.median(sizes[-third:])
        print(f"\n{host}: {early:.0f} MB, {late:.0f} MB: first and last third of {len(sizes)} recordings")
        assert late <= 1.05 * early


def test_kills_change_nothing(made: Path) -> None:
    """A worker killed every 20 s, the client killed and started again three times: the same data set, to the bit."""
    folder = made / "killed"
    manifest = write_plant(plant(SEED + 1, KILLED, 3, 0.03), folder / "plant", JOBS)
    fleet(manifest, folder / "quiet", "--no-report")
    chance = random.Random(SEED)
    out = folder / "out"
    command = [BIN / "calibration", "fleet", manifest, "--out", out, "--jobs", str(JOBS), "--no-report", "-q"]
    for life in range(4):
        process = subprocess.Popen(command, env=ENVIRONMENT, stderr=subprocess.DEVNULL)
        ends = time.monotonic() + 35.0
        next_kill = time.monotonic() + 20.0
        while process.poll() is None and (life == 3 or time.monotonic() < ends):
            if time.monotonic() >= next_kill:
                workers = children(process.pid)
                if workers:
                    os.kill(chance.choice(workers), signal.SIGKILL)
                next_kill += 20.0
            time.sleep(0.2)
        if life < 3:
            process.kill()
        process.wait()
    assert process.returncode == 0
    assert said(out) == said(folder / "quiet")
    shutil.rmtree(folder)


def children(parent: int) -> list[int]:
    """Return the workers: descendants of a process that were spawned to work."""
    found, waiting = [], [parent]
    while waiting:
        for path in Path(f"/proc/{waiting.pop()}/task").glob("*/children"):
            try:
                inner = [int(text) for text in path.read_text(encoding="ascii").split()]
            except OSError:  # it has ended meanwhile
                continue
            waiting += inner
            found += [child for child in inner if is_worker(child)]
    return found


def is_worker(process: int) -> bool:
    try:
        return b"spawn_main" in Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:
        return False
