"""Where pieces of work are done: processes of this machine, or a scheduler of somebody else's."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import os
import re
import signal
from collections.abc import Iterator
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

from calibration_core import __version__
from calibration_core.errors import InputError, quoted

ALLOWED_FAILURES = 3  # workers that a piece of work may end before it is given up
STARTS = 3  # of the processes of this machine, before their failure is reported
PATIENCE = 60.0  # s until a worker has to be there
CONNECT = 10.0  # s until a scheduler has to answer
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), 1)
ADDRESS = re.compile(r"(tcp|tls|ucx|ws|wss)://[^/\s]+:\d{1,5}")
INSTALL = "make setup-fleet in the checkout, or pip install './src/calibration_core[fleet]' there"


@dataclasses.dataclass(frozen=True)
class Cluster:
    """Where the work is done.

    Attributes:
        address: Of a scheduler, `tcp://HOST:PORT` or `tls://HOST:PORT`; empty: processes of this machine.
        jobs: Processes of this machine.
        tls: Files of the authority's certificate, of the own one and of its key; None: as Dask is configured.
    """

    address: str = ""
    jobs: int = 1
    tls: tuple[Path, Path, Path] | None = None


def require(who: str) -> None:
    """Refuse where Dask is missing.

    Raises:
        InputError: It is.
    """
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        raise InputError(who, "", f"no package {error.name}", INSTALL) from None


@contextlib.contextmanager
def connected(cluster: Cluster) -> Iterator[Any]:
    """Yield a client of the cluster; a local one ends with it.

    Raises:
        InputError: No scheduler or no worker answers, or workers have another version of this package.
    """
    import dask
    import distributed

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    settings = {
        "distributed.scheduler.allowed-failures": ALLOWED_FAILURES,
        "distributed.scheduler.worker-saturation": 1.0,
        "distributed.comm.timeouts.connect": CONNECT,
        "distributed.admin.system-monitor.gil.enabled": False,
        # Without Dask's MALLOC_TRIM_THRESHOLD_: giving memory back and fetching it took a third of a recording's time.
        "distributed.nanny.pre-spawn-environ": ONE_THREAD,
        "distributed.worker.profile.enabled": False,  # its samples of the stack grow for 1,000 s, to 100 MB
    }
    with dask.config.set(settings):
        if not cluster.address:
            with _local(distributed, cluster.jobs) as local, distributed.Client(local, set_as_default=False) as client:
                yield client
            return
        with _client(distributed, cluster) as client:
            _check_workers(client, cluster.address)
            yield client


def _local(distributed: Any, jobs: int) -> Any:
    """Start the processes; they hear no Ctrl-C, for it is meant for the program that started them, and ends them."""
    resource_tracker.ensure_running()  # whoever starts it later hears Ctrl-C again: it unblocks the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # threads and processes begin with this mask
    try:
        for left in reversed(range(STARTS)):
            try:
                return distributed.LocalCluster(
                    n_workers=jobs, threads_per_worker=1, processes=True, host="127.0.0.1",
                    dashboard_address=None, scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
                    silence_logs=logging.CRITICAL,
                )  # fmt: skip
            except RuntimeError as error:  # one of them has ended before it was there
                if not left:
                    found = quoted(" ".join(str(error.__cause__ or error).split()), 160)
                    raise InputError("this machine", "workers", found, "processes that start and stay") from None
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    raise AssertionError("the last start returns or raises")


def _client(distributed: Any, cluster: Cluster) -> Any:
    security = None
    if cluster.tls is not None:
        for path in cluster.tls:
            if not path.is_file():
                raise InputError(path, "", "no such file", "a certificate or key in PEM format")
        authority, certificate, key = (str(path) for path in cluster.tls)
        security = distributed.Security(
            tls_ca_file=authority, tls_client_cert=certificate, tls_client_key=key, require_encryption=True
        )
    expected = "the address of a Dask scheduler, tcp://HOST:PORT, or tls://HOST:PORT with its certificates"
    if not ADDRESS.fullmatch(cluster.address):  # a client with such an address would not end without noise
        raise InputError("--cluster", "", quoted(cluster.address), expected)
    try:
        return distributed.Client(
            cluster.address, security=security, timeout=CONNECT, set_as_default=False, direct_to_workers=False
        )
    except (OSError, ValueError, TimeoutError, RuntimeError, TypeError) as error:
        raise InputError(cluster.address, "", quoted(" ".join(str(error).split()), 160), expected) from None


def _check_workers(client: Any, address: str) -> None:
    expected = f"workers with calibration_core {__version__} ({INSTALL})"
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        raise InputError(address, "workers", f"none within {PATIENCE:g} s", expected) from None
    try:
        versions = client.run(_version)
    except Exception as error:  # noqa: BLE001 - whatever a worker of other software raises
        found = quoted(" ".join(f"{type(error).__name__}: {error}".split()), 160)
        raise InputError(address, "workers", found, expected) from None
    wrong = {place: version for place, version in versions.items() if version != __version__}
    for place, version in wrong.items():
        raise InputError(address, place, f"version {version}", expected)


def _version() -> str:
    return __version__


def dashboard_of(client: Any, address: str) -> str:
    """Return the address of the scheduler's dashboard; empty where there is none."""
    if not address:
        return ""
    services = client.scheduler_info(n_workers=0).get("services", {})
    return str(client.dashboard_link) if "dashboard" in services else ""


def default_jobs() -> int:
    """Return the number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # which macOS does not have
    return os.cpu_count() or 1 if affinity is None else max(1, len(affinity(0)))
