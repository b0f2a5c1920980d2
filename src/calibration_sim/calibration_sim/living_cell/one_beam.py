"""A tracker with one beam: it is aimed at one reflector after the other, over TCP.

It speaks the lines of `config/trackers/plain.yaml`, in m and in its own frame: `AIM POINT X Y Z` is answered by `OK`,
`MEASURE POINT WINDOW` by `POINT POINT X Y Z` with the mean of its readings over so many s; `ERROR WHY` is the answer
where that cannot be.
"""

from __future__ import annotations

import socketserver
import threading
from collections.abc import Callable, Sequence

import numpy as np

from calibration_core.errors import InputError, quoted
from calibration_core.timeseries import Float1D, Float2D

SLEW = 1.0  # rad/s, at which the beam turns
LOCK = 0.3  # s, from where it points to the reflector's centre
SEARCH = 0.1  # m, from where it points, beyond which it finds no reflector
LOOK = 1.0  # s of wall time between looks at whether the cell still lives


class OneBeam:
    """Where the beam looks, and what it read last; the cell gives it time, and the lock that guards it."""

    def __init__(self, names: Sequence[str], places: Callable[[], Float2D], lock: threading.RLock) -> None:
        """Take the reflectors' names, where the beam finds them, (p, 3) m, and the lock of whoever steps the cell."""
        self._names, self._places = tuple(names), places
        self._stepped = threading.Condition(lock)
        self._now = 0.0
        self._sight = np.array([1.0, 0.0, 0.0])
        self._readings: list[Float1D] = []
        self._closed = False
        self.target: int | None = None

    def step(self, now: float) -> None:
        """Let time go on to `now`, s; to be called with the lock."""
        self._now = now
        self._stepped.notify_all()

    def read(self, place: Float1D | None) -> None:
        """Take what is read of the target now, (3,) m; None: the beam is broken.  To be called with the lock."""
        if place is None:
            self.target = None
        else:
            self._readings.append(place)

    def close(self) -> None:
        """Let nobody wait any longer."""
        with self._stepped:
            self._closed = True
            self._stepped.notify_all()

    def answer(self, line: str) -> str:
        """Return the answer to a line, once it is known; empty: the cell has ended."""
        words = line.split()
        try:
            if len(words) == 5 and words[0] == "AIM" and words[1] in self._names:
                return self._aim(np.array([float(word) for word in words[2:]]))
            if len(words) == 3 and words[0] == "MEASURE" and words[1] in self._names:
                return self._measure(words[1], float(words[2]))
        except ValueError as error:
            return f"ERROR {error}"
        return f"ERROR found {quoted(line.strip())}, expected AIM POINT X Y Z or MEASURE POINT WINDOW of {self._names}"

    def _aim(self, place: Float1D) -> str:
        distance = float(np.linalg.norm(place))
        if not 0.0 < distance < np.inf:
            raise ValueError("there is no such direction")
        sight = place / distance
        with self._stepped:
            self.target = None
            there = self._now + float(np.arccos(np.clip(sight @ self._sight, -1.0, 1.0))) / SLEW + LOCK
            if not self._wait(lambda: self._now >= there):
                return ""
            self._sight = sight
            places = self._places()
            off = np.linalg.norm(np.cross(places, sight), axis=1) + SEARCH * (places @ sight <= 0.0)
            nearest = int(np.argmin(off))
            if off[nearest] >= SEARCH:
                return f"ERROR no reflector within {SEARCH:g} m"
            self.target = nearest
            return "OK"

    def _measure(self, name: str, window: float) -> str:
        with self._stepped:
            self._readings, end = [], self._now + window
            if not self._wait(lambda: self.target is None or bool(self._now >= end and self._readings)):
                return ""
            if self.target is None:
                return "ERROR beam broken"
            return " ".join(["POINT", name, *(f"{value:.9f}" for value in np.mean(self._readings, axis=0))])

    def _wait(self, done: Callable[[], bool]) -> bool:
        while not (done() or self._closed):
            self._stepped.wait(LOOK)
        return not self._closed


class BeamServer(socketserver.ThreadingTCPServer):
    """Serves one beam at an address, until it is closed."""

    allow_reuse_address = True
    daemon_threads = True
    block_on_close = False

    def __init__(self, address: str, beam: OneBeam) -> None:
        """Take host:port.

        Raises:
            InputError: It is no such address, or is not free.
        """
        self.beam = beam
        host, _, port = address.rpartition(":")
        try:
            super().__init__((host, int(port)), _Connection)
        except (ValueError, OverflowError, OSError) as error:
            expected = f"host:port of this machine that is free: {error}"
            raise InputError("simulated_cell", "tracker_address", quoted(address), expected) from None
        threading.Thread(target=self.serve_forever, name="tracker", daemon=True).start()

    def close(self) -> None:
        """End it; what waits for an answer gets none."""
        self.beam.close()
        self.shutdown()
        self.server_close()


class _Connection(socketserver.StreamRequestHandler):
    server: BeamServer

    def handle(self) -> None:
        try:
            while line := self.rfile.readline(1000):
                self.wfile.write(self.server.beam.answer(line.decode(errors="replace")).encode() + b"\n")
        except OSError:
            return  # whoever asked has gone
