"""The work itself: pieces handed to a cluster, and handed on as they come to their ends."""

from __future__ import annotations

import asyncio
import concurrent.futures
import dataclasses
import functools
import queue
from collections.abc import Callable, Hashable, Iterator, Mapping
from typing import Any, Generic, TypeVar

from calibration_core.engine.cluster import ALLOWED_FAILURES
from calibration_core.errors import InputError

BATCH = 1000  # pieces handed to the scheduler in one message
LOOK = 5.0  # s between two looks at the workers while nothing ends
WORKERLESS = 300.0  # s: a batch system that gives and takes workers has brought one by then

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Done(Generic[T]):
    """A piece of work that has come to its end.

    Attributes:
        key: Which one.
        value: What it returned; None where it did not.
        error: Why it did not, in one line; empty otherwise.
    """

    key: Hashable
    value: T | None
    error: str = ""


def run_all(client: Any, work: Callable[[Any], T], pieces: Mapping[str, Any]) -> Iterator[Done[T]]:
    """Yield the pieces of work as they come to their ends, in no order.

    Each value is fetched by itself: one that was lost with its worker is computed anew, and no other waits for it.

    Raises:
        InputError: The scheduler has gone, or all workers have, and none came back.
    """
    name = f"{work.__module__}.{work.__qualname__}"  # so that pieces of other work on the same scheduler differ
    futures = client.map(work, list(pieces.values()), key=[(name, key) for key in pieces], pure=False, batch_size=BATCH)
    ended: queue.SimpleQueue[tuple[Any, concurrent.futures.Future[list[T]]]] = queue.SimpleQueue()
    for future in futures:
        fetched = asyncio.run_coroutine_threadsafe(_fetch(client, future), client.loop.asyncio_loop)
        fetched.add_done_callback(functools.partial(_put, ended, future))
    del futures  # a result is forgotten by the cluster as soon as it has been handed on
    for _ in pieces:
        future, fetched = _next(client, ended)
        done: Done[T] = _done(future.key[1], fetched)
        future.release()
        yield done


async def _fetch(client: Any, future: Any) -> list[Any]:
    return list(await client.gather([future], asynchronous=True))


def _put(ended: queue.SimpleQueue[Any], future: Any, fetched: concurrent.futures.Future[Any]) -> None:
    ended.put((future, fetched))


def _next(client: Any, ended: queue.SimpleQueue[T]) -> T:
    """Return the next piece that has come to its end.

    Raises:
        InputError: For so long there was no worker, and nothing came.
    """
    alone = 0.0
    while True:
        try:
            return ended.get(timeout=LOOK)
        except queue.Empty:
            alone = 0.0 if _workers(client) else alone + LOOK
        if alone >= WORKERLESS:
            raise InputError("the cluster", "workers", f"none for {alone:.0f} s", "some; run this again to go on")


def _workers(client: Any) -> int:
    """Return how many workers there are; none where nobody answers any more."""
    try:
        return len(client.scheduler_info(n_workers=-1)["workers"])
    except (OSError, TimeoutError):
        return 0


def _done(key: Hashable, fetched: concurrent.futures.Future[list[T]]) -> Done[T]:
    from distributed import KilledWorker

    try:
        return Done(key, fetched.result()[0])
    except (concurrent.futures.CancelledError, asyncio.CancelledError):
        raise InputError(
            "the cluster", "", "no scheduler any more", "one that stays; run this again to go on"
        ) from None
    except KilledWorker:
        return Done(key, None, f"ended {ALLOWED_FAILURES + 1} workers that worked on it: out of memory, or a crash")
    except Exception as error:  # noqa: BLE001 - whatever the work raises is the answer for this piece
        return Done(key, None, " ".join(f"{type(error).__name__}: {error}".split()))
