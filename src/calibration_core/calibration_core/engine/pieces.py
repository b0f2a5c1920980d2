"""The work itself: pieces handed to a cluster, and handed on as they come to their ends."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Iterator, Mapping
from typing import Any, Generic, TypeVar

from calibration_core.engine.cluster import ALLOWED_FAILURES
from calibration_core.errors import InputError

BATCH = 1000  # pieces handed to the scheduler in one message

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

    Args:
        client: Of the cluster.
        work: A function that workers can import.
        pieces: Key -> argument of `work`.

    Raises:
        InputError: The scheduler has gone.
    """
    from distributed import as_completed

    name = f"{work.__module__}.{work.__qualname__}"  # so that pieces of other work on the same scheduler differ
    futures = client.map(work, list(pieces.values()), key=[(name, key) for key in pieces], pure=False, batch_size=BATCH)
    ended = as_completed(futures, loop=client.loop, raise_errors=False)
    del futures  # a result is forgotten by the cluster as soon as it has been handed on
    for batch in ended.batches():
        values = _values(client, [future for future in batch if future.status == "finished"])
        for future in batch:
            done = Done(future.key[1], values.pop(future.key)) if future.key in values else _ended(future)
            future.release()
            yield done


def _values(client: Any, finished: list[Any]) -> dict[Any, Any]:
    """Return what several pieces returned, by their keys; nothing where it cannot be had of all: each is asked then."""
    try:
        return dict(zip((future.key for future in finished), client.gather(finished), strict=True))
    except Exception:  # noqa: BLE001 - a worker was lost with a value, and the piece failed when it was done again
        return {}


def _ended(future: Any) -> Done[Any]:
    key = future.key[1]
    if future.status == "finished":
        return Done(key, future.result())
    if future.status != "error":
        raise InputError("the cluster", "", "no scheduler any more", "one that stays; run this again to go on")
    from distributed import KilledWorker

    error = future.exception()
    if isinstance(error, KilledWorker):
        return Done(key, None, f"ended {ALLOWED_FAILURES + 1} workers that worked on it: out of memory, or a crash")
    return Done(key, None, " ".join(f"{type(error).__name__}: {error}".split()))
