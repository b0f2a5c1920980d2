"""What the engine costs: beside two processes without one, and, in a model, with a hundred workers."""

from __future__ import annotations

import itertools
import os
import pickle
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("distributed")

from plant import plant, write_plant
from scaling import Nap, busy, calibrated, nap, simulated

from calibration_core.engine.cluster import Cluster, connected
from calibration_core.engine.pieces import run_all
from calibration_core.fleet.recordings.manifest import Entry, read_entries
from calibration_core.fleet.recordings.store import keep
from calibration_core.fleet.recordings.task import EvaluatedRecording, measure

pytestmark = pytest.mark.slow

SEED = 20263
JOBS = 2
ROBOTS, PARTS = int(os.environ.get("FLEET_SPEED_ROBOTS", "48")), 3  # one date each; every part is done both ways
NAPS, REPEATS = 300, 3
ALL = 20_000  # recordings of the plant that a hundred workers would do
WORKERS, SLICES = 100, 200


@pytest.fixture(scope="module")
def entries(tmp_path_factory: pytest.TempPathFactory) -> tuple[Entry, ...]:
    """Recordings of all types, those of one type never side by side."""
    folder = tmp_path_factory.mktemp("speed")
    found = read_entries(write_plant(plant(SEED, ROBOTS, 1, 0.03), folder, JOBS))
    return tuple(sorted(found, key=lambda entry: entry.robot))


@pytest.fixture(scope="module")
def beside(
    entries: Sequence[Entry], tmp_path_factory: pytest.TempPathFactory
) -> tuple[list[Any], list[EvaluatedRecording]]:
    """(recordings, s by plain processes, s by the engine) of every part, in turns, and what was measured."""
    out = tmp_path_factory.mktemp("out")
    parts, outcomes = [entries[k::PARTS] for k in range(PARTS)], []
    took = []
    with connected(Cluster(jobs=JOBS)) as client, ProcessPoolExecutor(JOBS) as pool:
        list(pool.map(plain, itertools.repeat(out / "warm"), [entries[:1], entries[1:2]]))  # all have imported
        list(kept(client, entries[:2], out / "warm"))  # what they need
        for k, part in enumerate(parts):
            begun = time.monotonic()
            list(pool.map(plain, itertools.repeat(out / f"plain{k}"), [part[0::2], part[1::2]]))
            middle = time.monotonic()
            outcomes += list(kept(client, part, out / f"engine{k}"))
            took.append((len(part), middle - begun, time.monotonic() - middle))
    return took, outcomes


def plain(out: Path, entries: Sequence[Entry]) -> None:
    for entry in entries:
        outcome = measure(entry)
        keep(out, entry, outcome.row, outcome.result)


def kept(client: Any, entries: Sequence[Entry], out: Path) -> Iterator[EvaluatedRecording]:
    """Yield what the engine has measured, after it was written as `calibration fleet` writes it."""
    pieces = {entry.recording: entry for entry in entries}
    for done in run_all(client, measure, pieces):
        assert done.value is not None, done.error
        keep(out, pieces[str(done.key)], done.value.row, done.value.result)
        yield done.value


def test_the_engine_costs_little(beside: tuple[list[Any], list[EvaluatedRecording]]) -> None:
    """Beside two independent processes with the same recordings, in the same run."""
    counts, plain_times, engine_times = np.array(beside[0]).T
    ratios, overheads = plain_times / engine_times, 1e3 * (engine_times - plain_times) * JOBS / counts
    ratio = plain_times.sum() / engine_times.sum()
    overhead = (engine_times - plain_times).sum() * JOBS / counts.sum()
    print(f"\nspeed-up beside {JOBS} plain processes: {ratio:.3f} ({', '.join(f'{x:.3f}' for x in ratios)})")
    print(f"overhead: {1e3 * overhead:.0f} ms a recording ({', '.join(f'{x:.0f}' for x in overheads)})")
    assert ratio >= 0.95
    assert overhead <= 0.05


def test_a_hundred_workers_stay_busy(
    beside: tuple[list[Any], list[EvaluatedRecording]], entries: Sequence[Entry], tmp_path: Path
) -> None:
    """In a model whose times are those of 1, 2 and 4 workers with pieces that take none, and with all that is kept."""
    outcomes = beside[1]
    answer = tmp_path / "answer"
    answer.write_bytes(pickle.dumps(outcomes[0]))
    rounds, predicted, measured = {}, 0.0, 0.0
    durations = np.array([outcome.row.seconds for outcome in outcomes])
    rng = np.random.default_rng(SEED)
    for workers in (1, 2, 4):
        with connected(Cluster(jobs=workers)) as client:
            napped(client, entries, np.zeros(4 * workers), answer, tmp_path / "kept")
            took = [
                napped(client, entries, np.zeros(NAPS), answer, tmp_path / "kept") * workers / NAPS
                for _ in range(REPEATS)
            ]
            rounds[workers] = min(took)
            if workers == 4:  # the model beside what it was not made from
                short = rng.choice(durations, NAPS) / 20
                measured = min(napped(client, entries, short, answer, tmp_path / "kept") for _ in range(REPEATS))
                predicted = float(simulated(calibrated(rounds), 4, short)[:, 1].max())
    times = calibrated(rounds)
    rounded = ", ".join(f"{n}: {1e3 * took:.1f}" for n, took in rounds.items())
    print(f"\nworkers: ms a round {rounded}; scheduler {1e3 * times.serve:.1f} ms, turn {1e3 * times.turn:.1f} ms")
    print(f"four workers, {NAPS} naps: {measured:.2f} s, predicted {predicted:.2f} s")
    assert measured <= 1.15 * predicted
    for count in (1800, ALL):
        spans = simulated(times, WORKERS, rng.choice(durations, count))
        at_work = busy(spans, SLICES)
        last = int(np.flatnonzero(at_work >= 0.9 * WORKERS)[-1]) + 1
        least, end = at_work[1:last].min(), 100 * (1 - last / SLICES)
        print(f"{WORKERS} workers, {count} recordings of {durations.mean():.2f} s: {spans[:, 1].max():.0f} s;")
        print(f"  once all have begun, {least:.1f} or more are busy until the last {end:.1f} % of the time")
    assert at_work[1 : round(0.98 * SLICES)].min() >= 0.9 * WORKERS  # the last of the loop: the whole plant


def napped(client: Any, entries: Sequence[Entry], seconds: Any, answer: Path, out: Path) -> float:
    """Return how long pieces take that last `seconds`, with what is kept of them, s."""
    begun = time.monotonic()  # part of the keys, too: a scheduler need not have forgotten the last ones
    pieces = {f"{begun} {k}": Nap(float(one), answer) for k, one in enumerate(seconds)}
    for done in run_all(client, nap, pieces):
        assert done.value is not None, done.error
        entry = entries[int(str(done.key).split()[1]) % len(entries)]
        keep(out, entry, done.value.row, done.value.result)
    return time.monotonic() - begun
