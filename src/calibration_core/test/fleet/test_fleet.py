"""The command as users run it: real processes, a real scheduler over TCP and TLS, and processes that are killed."""

from __future__ import annotations

import asyncio
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("distributed")
pytest.importorskip("pyarrow")

from calibration_core.cli import main
from calibration_core.engine import cluster as engine
from calibration_core.engine import pieces
from calibration_core.engine.pieces import run_all
from calibration_core.errors import InputError
from calibration_core.fleet.recordings.rows import Row
from calibration_core.fleet.recordings.store import read_dataset

BIN = Path(sys.executable).parent
CELL = Path(__file__).parents[4] / "config" / "cells" / "small.cell.yaml"
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
DATES = ("2026-01-05", "2026-07-06")
ROBOTS = ("r1", "r2", "r3")
PATIENCE = 240.0  # s; a loaded machine takes its time
Cluster = tuple[list[str], list[subprocess.Popen[bytes]]]  # options of the command, and the workers
APART = {"seconds", "megabytes", "host"}  # what may differ between two runs


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three robots at two dates, of which one recording is rubbish and one cell file is missing."""
    folder = tmp_path_factory.mktemp("plant")
    made = folder / "made"
    assert main(["simulate", "--cell", str(CELL), "--seed", "1", "--no-report", "-q", "--out", str(made)]) == 0
    lines = ["recording,cell,robot,type,date"]
    for robot in ROBOTS:
        for date in DATES:
            shutil.copy(made / "measurements.csv", folder / f"{robot}-{date}.csv")
            lines.append(f"{robot}-{date}.csv,cell.yaml,{robot},ten kg,{date}")
    (folder / "r2-2026-07-06.csv").write_text("no table\n")
    lines[-1] = lines[-1].replace("cell.yaml", "none.yaml")
    shutil.copy(CELL, folder / "cell.yaml")
    (folder / "plant.csv").write_text("\n".join(lines) + "\n")
    shutil.rmtree(made)
    return folder


@pytest.fixture(scope="module")
def reference(plant: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plant evaluated by two processes of this machine, without any disturbance."""
    out = tmp_path_factory.mktemp("reference")
    done = fleet(plant, out, "--jobs", "2", report=True)
    assert done.returncode == 0, done.stderr
    assert "6 recordings, 2 of them not usable" in done.stdout
    return out


def fleet(plant: Path, out: Path, *options: str, report: bool = False) -> subprocess.CompletedProcess[str]:
    command = [BIN / "calibration", "fleet", plant / "plant.csv", "--out", out, *options]
    command += [] if report else ["--no-report"]
    return subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False, timeout=PATIENCE)


def said(out: Path) -> list[dict[str, object]]:
    """What the data set says; when a file was last written to is no part of it."""
    rows = [row.to_dict() for row in read_dataset(out / "fleet.parquet")]
    for row in rows:
        row["inputs"] = [(one["path"], one["digest"]) for one in row["inputs"]]
    return [{name: value for name, value in row.items() if name not in APART} for row in rows]


def results(out: Path) -> dict[str, bytes]:
    return {str(path.relative_to(out)): path.read_bytes() for path in sorted((out / "results").rglob("result.json"))}


def rows_on_disk(out: Path) -> list[Path]:
    """Return what is done: a row appears before its result, and what is being written stands in hidden folders."""
    return sorted(path.with_name("row.json") for path in (out / "results").glob("*/*/*/*/result.json"))


def test_every_recording_is_a_row_and_errors_are_rows(reference: Path, plant: Path) -> None:
    rows = read_dataset(reference / "fleet.parquet")
    assert [Path(row.recording).name for row in rows] == [f"{r}-{d}.csv" for r in ROBOTS for d in DATES]
    bad = {Path(row.recording).name: row.error for row in rows if not row.measured}
    assert set(bad) == {"r2-2026-07-06.csv", "r3-2026-07-06.csv"}
    assert all(len(error.splitlines()) == 1 and "expected" in error for error in bad.values())
    assert "none.yaml" in bad["r3-2026-07-06.csv"]
    good: Row = rows[0]
    assert len(good.compliance) == len(good.joints) == 6
    assert good.compliance_covariance.shape == (6, 6)
    assert good.configurations == 18
    partitions = {path.name for path in (reference / "fleet.parquet").glob("*/*")}
    assert partitions == {f"date={date}" for date in DATES}
    for path in (reference / "results").rglob("result.json"):
        content = json.loads(path.read_text())
        assert "error" in content or content["command"] == "diagnose"
    assert {"ranking.csv", "joints.csv", "population.yaml", "result.json", "joints.parquet"} <= {
        path.name for path in reference.iterdir()
    }


def test_what_is_done_is_not_done_again(reference: Path, plant: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(reference, out)
    before = {path: path.stat().st_mtime_ns for path in rows_on_disk(out)}
    os.utime(plant / "r1-2026-01-05.csv")  # with the same content
    begun = time.monotonic()
    assert fleet(plant, out, "--cluster", "tcp://127.0.0.1:9").returncode == 0  # nobody is asked
    assert {path: path.stat().st_mtime_ns for path in rows_on_disk(out)} == before
    assert time.monotonic() - begun < PATIENCE
    assert said(out) == said(reference)
    other = tmp_path / "plant"
    shutil.copytree(plant, other)
    done = fleet(other, out, "--cluster", "tcp://127.0.0.1:9")  # other recordings: somebody has to be asked
    assert done.returncode == 2
    assert "tcp://127.0.0.1:9" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert said(out) == said(reference)


def test_a_changed_recording_alone_is_done_again(reference: Path, plant: Path, tmp_path: Path) -> None:
    out, other = tmp_path / "out", plant / "r2-2026-07-06.csv"
    shutil.copytree(reference, out)
    before = {path: path.stat().st_mtime_ns for path in rows_on_disk(out)}
    try:
        other.write_text("still no table\n")
        done = fleet(plant, out, "--jobs", "3")
        assert done.returncode == 0
        assert "--jobs 3 had no effect beyond that of --jobs 1: 1 recording had to be evaluated" in done.stdout
    finally:
        other.write_text("no table\n")
    changed = [path for path, when in before.items() if path.stat().st_mtime_ns != when]
    assert [json.loads(path.read_text())["recording"] for path in changed] == [str(other)]


def test_killed_and_gone_on_with_it_is_the_same_data_set(reference: Path, plant: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [BIN / "calibration", "fleet", plant / "plant.csv", "--out", out, "--jobs", "1"]
    process = subprocess.Popen(
        command, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    deadline = time.monotonic() + PATIENCE
    while len(rows_on_disk(out)) < 2 and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGSTOP)  # it would be done before the second one has asked
    second = fleet(plant, out)
    assert second.returncode == 2  # two runs never write to one folder
    assert "another run at work" in second.stderr
    process.kill()
    process.wait()
    os.killpg(process.pid, signal.SIGCONT)  # its processes see that it is gone
    kept = rows_on_disk(out)
    assert 2 <= len(kept) < 6
    before = {path: path.stat().st_mtime_ns for path in kept}
    done = fleet(plant, out, "--jobs", "1")
    assert done.returncode == 0, done.stderr
    assert {path: path.stat().st_mtime_ns for path in kept} == before
    assert said(out) == said(reference)
    assert results(out) == results(reference)


def test_what_a_killed_run_left_half_written_is_done_again(reference: Path, plant: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(reference, out)
    half, other = (path.parent for path in rows_on_disk(out)[:2])
    (half / "result.json").unlink()  # killed between the two renames
    (other / ".calibration-x" / "new").mkdir(parents=True)
    (other / ".calibration-x" / "new" / "result.json").write_text("{")
    assert fleet(plant, out, "--jobs", "1").returncode == 0
    assert results(out) == results(reference)


def process_group(leader: int) -> bool:
    """Whether any process of the group is left."""
    try:
        os.killpg(leader, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)]
)
def test_ended_by_hand_says_what_stays(
    number: signal.Signals, code: int, reference: Path, plant: Path, tmp_path: Path
) -> None:
    """SIGINT as a terminal sends it, to the workers too; SIGTERM to the program alone."""
    out = tmp_path / "out"
    process = subprocess.Popen(
        [BIN / "calibration", "fleet", plant / "plant.csv", "--out", out, "--jobs", "1", "--no-report"],
        env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    deadline = time.monotonic() + PATIENCE
    while len(rows_on_disk(out)) < 2 and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.05)
    os.killpg(process.pid, number) if number == signal.SIGINT else process.send_signal(number)
    _, error = process.communicate(timeout=PATIENCE)
    assert process.returncode == code, error
    (line,) = (one for one in error.splitlines() if not re.fullmatch(r"fleet: .* \(\d+% done\)", one))  # progress
    while process_group(process.pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not process_group(process.pid)
    found = re.search(r"(\d) of 6 recordings are done and stay; the same command goes on with the others", line)
    assert found, line
    kept = rows_on_disk(out)
    assert len(kept) - 1 <= int(found[1]) <= len(kept)  # one may have been written when the signal came
    before = {path: path.stat().st_mtime_ns for path in kept}
    assert fleet(plant, out, "--jobs", "1").returncode == 0
    assert {path: path.stat().st_mtime_ns for path in kept} == before
    assert said(out) == said(reference)


@pytest.mark.slow
def test_a_worker_that_is_killed_while_it_starts_is_started_again(reference: Path, plant: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [BIN / "calibration", "fleet", plant / "plant.csv", "--out", out, "--jobs", "1", "--no-report"]
    process = subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + PATIENCE
    while not (started := spawned(process.pid)) and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.01)
    os.kill(started[0], signal.SIGKILL)
    _, error = process.communicate(timeout=PATIENCE)
    assert (process.returncode, error) == (0, "")
    assert said(out) == said(reference)


def spawned(parent: int) -> list[int]:
    """Processes that a process has started to work for it."""
    children = Path(f"/proc/{parent}/task").glob("*/children")
    found = [int(text) for path in children for text in path.read_text(encoding="ascii").split()]
    return [one for one in found if b"spawn_main" in Path(f"/proc/{one}/cmdline").read_bytes()]


# --- a scheduler of somebody else ----------------------------------------------------------------------------------


@pytest.fixture(params=[pytest.param("tcp", marks=pytest.mark.slow), "tls"])
def cluster(
    request: pytest.FixtureRequest, tmp_path: Path
) -> Iterator[tuple[list[str], list[subprocess.Popen[bytes]]]]:
    """A scheduler and two workers as processes of their own; yields options of the command and the workers."""
    port, tls, options, files = free_port(), [], [], None
    if request.param == "tls":
        if shutil.which("openssl") is None:
            pytest.skip("no openssl to make certificates with")
        files = certificates(tmp_path)
        tls = [f"--tls-{name}={file}" for name, file in zip(("ca-file", "cert", "key"), files, strict=True)]
        options = ["--tls", *map(str, files)]
    address = f"{request.param}://127.0.0.1:{port}"
    scheduler = start("dask-scheduler", f"--host={request.param}://127.0.0.1", f"--port={port}", "--no-dashboard", *tls)
    workers = [start_worker(address, tmp_path, tls) for _ in range(2)]
    try:
        wait_for_all(workers, engine.Cluster(address, 1, files), lambda: start_worker(address, tmp_path, tls))
        yield ["--cluster", address, *options], workers
    finally:
        for process in [*workers, scheduler]:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def wait_for_all(
    workers: list[subprocess.Popen[bytes]], cluster: engine.Cluster, begin: Callable[[], subprocess.Popen[bytes]]
) -> None:
    """Wait until every worker is there; one that ends itself is started again, as whoever runs a cluster has it done.

    Over TLS a connection may break while a worker registers, and Dask's workers end then (seen with Python 3.13).
    """
    deadline = time.monotonic() + PATIENCE
    with engine.connected(cluster) as client:
        while len(client.scheduler_info()["workers"]) < len(workers) and time.monotonic() < deadline:
            workers[:] = [worker if worker.poll() is None else begin() for worker in workers]
            time.sleep(0.1)


def start(program: str, *options: str) -> subprocess.Popen[bytes]:
    words = {"dask-scheduler": "distributed.cli.dask_scheduler", "dask-worker": "distributed.cli.dask_worker"}
    return subprocess.Popen(
        [sys.executable, "-m", words[program], *options],
        env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip


def start_worker(address: str, folder: Path, tls: list[str]) -> subprocess.Popen[bytes]:
    return start("dask-worker", address, "--nthreads=1", "--no-dashboard", f"--local-directory={folder}", *tls)


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def certificates(folder: Path) -> tuple[Path, Path, Path]:
    """Make an authority, and a certificate with its key signed by it."""
    authority, authority_key, certificate, key, request = (
        folder / name for name in ("ca.pem", "ca.key", "cert.pem", "cert.key", "cert.csr")
    )
    new = ["openssl", "req", "-newkey", "rsa:2048", "-nodes"]
    sign = ["openssl", "x509", "-req", "-in", request, "-CA", authority, "-CAkey", authority_key, "-CAcreateserial"]
    for command in (
        [*new, "-x509", "-subj", "/CN=plant", "-days", "2", "-keyout", authority_key, "-out", authority],
        [*new, "-subj", "/CN=127.0.0.1", "-keyout", key, "-out", request],
        [*sign, "-days", "2", "-out", certificate],
    ):
        subprocess.run(command, check=True, capture_output=True, timeout=60)
    return authority, certificate, key


def test_workers_elsewhere_give_the_same_data_set_though_one_is_killed(
    cluster: Cluster, reference: Path, plant: Path, tmp_path: Path
) -> None:
    options, workers = cluster
    out = tmp_path / "out"
    process = subprocess.Popen(
        [BIN / "calibration", "fleet", plant / "plant.csv", "--out", out, "--no-report", *options],
        env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    deadline = time.monotonic() + PATIENCE
    while not rows_on_disk(out) and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.1)
    os.killpg(workers[0].pid, signal.SIGKILL)
    _, error = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, error
    assert said(out) == said(reference)
    assert results(out) == results(reference)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--alone", "r9"), "fleet: --alone: found 'r9', expected a robot of the manifest: r1, r2, r3\n"),
        (("--cluster", "nonsense"), "--cluster: found 'nonsense'"),
        (("--cluster", "tls://127.0.0.1:9", "--tls", "a.pem", "b.pem", "c.pem"), "a.pem: found no such file"),
    ],
)
def test_a_wrong_option_is_one_line(
    plant: Path, tmp_path: Path, options: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["fleet", str(plant / "plant.csv"), "--out", str(tmp_path / "out"), "--no-report", *options]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert len(error.splitlines()) == 1


# --- the engine, with a client that behaves as asked ----------------------------------------------------------------


class Piece:
    """A future of the stand-in; `lost` has a value that is computed anew when all others have ended."""

    def __init__(self, key: tuple[str, str]) -> None:
        self.key = key
        self.released = False

    def release(self) -> None:
        self.released = True


class StandIn:
    """A client of which one value was lost with its worker, or whose workers all have gone."""

    def __init__(self, workers: int) -> None:
        self.loop = types.SimpleNamespace(asyncio_loop=asyncio.new_event_loop())
        self.workers, self.open = workers, 0
        threading.Thread(target=self.loop.asyncio_loop.run_forever, daemon=True).start()

    def map(self, _work: Any, values: list[Any], *, key: list[tuple[str, str]], **_: Any) -> list[Piece]:
        self.open = len(values)
        return [Piece(one) for one in key]

    async def gather(self, futures: list[Piece], **_: Any) -> list[str]:
        (future,) = futures
        while future.key[1] == "lost" and (self.open > 1 or not self.workers):
            await asyncio.sleep(0.01)
        self.open -= 1
        if future.key[1] == "wrong":
            raise ValueError("no such file")
        return [future.key[1]]

    def scheduler_info(self, **_: Any) -> dict[str, Any]:
        return {"workers": dict.fromkeys(range(self.workers))}


def test_a_value_that_was_lost_holds_no_other_up() -> None:
    done = list(run_all(StandIn(1), print, dict.fromkeys(("lost", "b", "wrong", "d"))))
    assert [one.key for one in done][-1] == "lost"
    assert {str(one.key): (one.value, one.error) for one in done} == {
        "lost": ("lost", ""), "b": ("b", ""), "d": ("d", ""), "wrong": (None, "ValueError: no such file"),
    }  # fmt: skip


def test_a_cluster_without_workers_is_not_waited_for_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "LOOK", 0.01)
    monkeypatch.setattr(pieces, "WORKERLESS", 0.05)
    found = run_all(StandIn(0), print, dict.fromkeys(("lost", "b")))
    assert next(found).key == "b"
    with pytest.raises(InputError, match=r"the cluster: workers: found none for .* run this again to go on"):
        next(found)
