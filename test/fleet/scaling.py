"""What a cluster of many workers would do, from times that one, two and four workers were measured to take.

A worker that has ended a piece tells the scheduler.  The scheduler handles one message after another and takes `serve`
for each; what it hands out reaches the worker, and the answer the scheduler, after `turn`, during which the worker has
nothing to do.  With pieces that take no time, n workers go round in max(serve + turn, n serve).

Both times are taken at their worst: the whole of a round, divided by the workers that share it, counts as the
scheduler's where that is least, although client, scheduler and workers share the cores of one machine, and the client
writes every result to disk beside it.
"""

from __future__ import annotations

import dataclasses
import functools
import heapq
import pickle
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration_core.fleet.recordings.task import EvaluatedRecording

Floats = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Times:
    """Of the engine: s that the scheduler takes for a piece, and s that a worker waits besides."""

    serve: float
    turn: float


def calibrated(rounds: Mapping[int, float]) -> Times:
    """Return the times of the engine.

    Args:
        rounds: Workers -> s in which one worker goes round, for pieces that take no time.
    """
    serve = min(took / workers for workers, took in rounds.items())
    return Times(serve, max(rounds[1] - serve, 0.0))


def simulated(times: Times, workers: int, durations: Floats) -> Floats:
    """Return begin and end of every piece, (n, 2) s.

    Args:
        times: Of the engine.
        workers: How many there are.
        durations: (n,) s that the pieces take, in the order in which they are handed out.
    """
    asking = [(0.0, worker) for worker in range(workers)]
    free = 0.0
    spans = np.empty((len(durations), 2))
    for k, duration in enumerate(durations):
        asked, worker = heapq.heappop(asking)
        free = max(free, asked) + times.serve
        spans[k] = free + times.turn, free + times.turn + duration
        heapq.heappush(asking, (float(spans[k, 1]), worker))
    return spans


def busy(spans: Floats, slices: int) -> Floats:
    """Return how many workers are at work on the average of every slice of the time, (slices,)."""
    edges = np.linspace(0.0, float(spans[:, 1].max()), slices + 1)
    ends = np.sort(spans, axis=0)  # what was done until an edge: begun and ended pieces count apart
    done = np.array([np.minimum(ends[:, 1], edge).sum() - np.minimum(ends[:, 0], edge).sum() for edge in edges])
    return np.asarray(np.diff(done) / np.diff(edges))


# --- pieces of a known duration, in workers ------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Nap:
    """A piece of work that takes a known time and no processor.

    Attributes:
        seconds: How long it takes.
        answer: File with what it hands back, as a recording of that size would.
    """

    seconds: float
    answer: Path


def nap(piece: Nap) -> EvaluatedRecording:
    """Take the time, and hand back what a recording would."""
    if piece.seconds > 0:
        time.sleep(piece.seconds)
    return _answer(piece.answer)


@functools.cache
def _answer(path: Path) -> EvaluatedRecording:
    found: EvaluatedRecording = pickle.loads(path.read_bytes())
    return found
