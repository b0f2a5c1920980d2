"""Driver `emscon`: a Leica tracker by its own binary interface over TCP (emScon TPI; LTD, AT901 and AT4xx trackers).

Source of numbers and layouts: the vendor's header `ES_C_API_Def.h`, TPI V3.6, as published in `beckjac/emscon_ros`
(include/emscon_ros, commit 638c2e7) and, for the AT4xx, in `MuffinSpawn/Leica` (Include, commit afb89ce).  In all that
is used here they agree.  A packet is little-endian, without gaps before a double (pack 4): size, kind, the rest.
A `long` of the header has 4 bytes: early states of both clients had 8, or gaps, and could not read a packet.
No device was at hand, and no recorded exchange is public.
"""

from __future__ import annotations

import contextlib
import math
import struct
from typing import NamedTuple

import numpy as np

from calibration.instruments.drivers import Connection, DriverError, Seen, Wait
from calibration_core.timeseries import Float1D, Float2D

SMALLEST, LARGEST = 8, 1 << 16  # bytes of a packet
COMMAND, ERROR, EVENT, PLAIN, EXTENDED = 0, 1, 8, 2, 9  # kinds of packets
SHORTEST = {COMMAND: 16, ERROR: 16, EVENT: 12, PLAIN: 16, EXTENDED: 16}  # bytes of those that are read
RESULTS = {PLAIN: (156, "<3i17d"), EXTENDED: (204, "<3i23d")}  # bytes; status, mode, trial, numbers
ROWS, COLUMNS = [0, 0, 1], [1, 2, 2]  # of the covariances 12, 13, 23
SYSTEM_STATUS, START, STOP, GO_POSITION = 1, 49, 52, 55
STATIONARY, INITIALIZED = 0, 5
WARMED_UP = 10018  # an error that is none
EVENTS = {
    25: "the beam is broken, or the tracker is not ready",
    997: "the connection to its controller ends",
    998: "it is being shut down",
}  # after which nothing is measured
LASER = {
    0: "does not reach its laser",
    1: "has no laser",
    2: "warms up its laser: wait",
    4: "cannot make its laser stable",
    5: "has its laser switched off",
}
STATUS = {
    1: "it is busy with another command",
    23: "the reflector that is set in it is another one",
    35: "another program uses it",
    37: "no distance is known: bring the reflector to the home position",
    38: "no tracker is connected to its controller",
    39: "it is not initialized",
    46: "it is under the control of another program",
    57: "temperature, pressure or humidity are out of its range",
    58: "a compensation is under way",
    10004: "it is not ready to measure: look at beam and reflector",
    10005: "its distance meter is starting up",
    10009: "there is no result: the beam was broken, or the target moved",
    10010: "it is not level",
    10011: "another program is connected to it",
    10012: "it is not warmed up",
    10013: "it does not stand stably",
    10014: "it is not ready to measure",
    10015: "its controller does not reach it",
}  # that somebody can do something about


class Setting(NamedTuple):
    """So many integers that a command sets, and the next number reads; `given` has what has to be at which place."""

    name: str
    command: int
    size: int
    given: dict[int, int]

    def adjusted(self, values: tuple[int, ...]) -> list[int]:
        """Return the values as they have to be; empty: they are."""
        wanted = [self.given.get(place, value) for place, value in enumerate(values)]
        return [] if wanted == list(values) else wanted


SETTINGS = (
    Setting("units", 5, 5, {0: 0, 1: 0, 2: 0}),  # metre, radian, Celsius
    Setting("coordinate system", 26, 1, {0: 0}),  # right-handed, Cartesian
    Setting("system settings", 47, 9, {1: 0, 2: 0, 4: 1, 5: 0, 6: 0}),  # no frames, but messages; no positions, trials
    Setting("measurement mode", 24, 1, {0: STATIONARY}),
    Setting("statistics", 80, 2, {0: 1}),  # with covariances
)


class Emscon(Connection):
    """Asks one command at a time."""

    _measuring = False

    def aim(self, point: str, place: Float1D, wait: Wait) -> None:  # noqa: ARG002  # the tracker knows places alone
        """Connect, if need be, see whether it is ready, set it up, and have it look for a reflector."""
        with self.closing_on_errors():
            _last, processor, laser = self._ask(SYSTEM_STATUS, "state how it is", wait, size=3)
            if processor != INITIALIZED:
                raise DriverError(f"{self.name} is not initialized: do that with its own program")
            if laser in LASER:
                raise DriverError(f"{self.name} {LASER[laser]}")
            for setting in SETTINGS:
                self._set(setting, wait)
            self._ask(GO_POSITION, "look for a reflector there", wait, struct.pack("<3di", *place, 1))

    def measure(self, window: float, wait: Wait) -> list[Seen]:
        """Have it measure once, for as long; what it is set to has to be the same before and after."""
        settings = (*SETTINGS, Setting("measuring time", 28, 2, {0: math.ceil(1e3 * window)}))  # ms
        with self.closing_on_errors():
            for setting in settings:
                self._set(setting, wait)
            begin = wait()
            self._measuring = True
            self._command(START)
            place, covariance = self._result(wait)
            self._measuring = False
            end = max(wait(), begin + 1)
            for setting in settings:
                if setting.adjusted(self._read(setting, wait)):
                    raise DriverError(f"another program changed the {setting.name} of {self.name} meanwhile")
        return [Seen(begin, end, place, covariance)]

    def close(self) -> None:
        """End what it measures, and the connection."""
        if self._measuring and self.connected:
            with contextlib.suppress(OSError):  # the connection may be what is lost
                self._command(STOP)
        self._measuring = False
        super().close()

    def _set(self, setting: Setting, wait: Wait) -> None:
        """Have a setting be as it has to be, and read whether it is."""
        values = setting.adjusted(self._read(setting, wait))
        if not values:
            return
        self._ask(setting.command, f"set its {setting.name}", wait, struct.pack(f"<{setting.size}i", *values))
        if setting.adjusted(found := self._read(setting, wait)):
            raise DriverError(f"{self.name} keeps its {setting.name}: found {list(found)}, expected {values}")

    def _read(self, setting: Setting, wait: Wait) -> tuple[int, ...]:
        return self._ask(setting.command + 1, f"state its {setting.name}", wait, size=setting.size)

    def _ask(self, command: int, what: str, wait: Wait, body: bytes = b"", size: int = 0) -> tuple[int, ...]:
        """Return so many integers of the answer; what else comes meanwhile answers nothing."""
        self._command(command, body)
        self.awaited = f"{self.name} does not answer"
        while True:
            kind, packet = self._packet(wait)
            if kind not in (COMMAND, ERROR):
                continue
            number, status = struct.unpack_from("<2i", packet, 8)
            if number == command:
                if status:
                    raise DriverError(f"{self.name} refuses to {what}: {reason(status)}")
                spare = len(packet) - 16 - 4 * size
                if spare < 0 or (spare and size and command != SYSTEM_STATUS):  # that one may have grown at its end
                    raise DriverError(f"{self.name} answers {len(packet)} bytes when asked to {what}: another version")
                return struct.unpack_from(f"<{size}i", packet, 16)
            if kind == ERROR:
                self.awaited = f"{self.name} does not answer, but says: {reason(status)}"

    def _result(self, wait: Wait) -> tuple[Float1D, Float2D | None]:
        """Wait for the place, and return it with its covariance, m and m^2; what happens meanwhile ends it."""
        self.awaited = f"{self.name} states no result"
        while True:
            kind, packet = self._packet(wait)
            if kind in RESULTS:
                return self._place(kind, packet)
            if kind == EVENT and (change := struct.unpack_from("<i", packet, 8)[0]) in EVENTS:
                raise DriverError(f"{self.name} says: {EVENTS[change]}")
            if kind in (COMMAND, ERROR):
                number, status = struct.unpack_from("<2i", packet, 8)
                if (status and number == START) or (kind == ERROR and status != WARMED_UP):
                    raise DriverError(f"{self.name} does not measure: {reason(status)}")

    def _place(self, kind: int, packet: bytes) -> tuple[Float1D, Float2D | None]:
        size, layout = RESULTS[kind]
        if len(packet) != size:
            raise DriverError(f"{self.name} states a result of {len(packet)} bytes, expected {size}: another version")
        status, mode, trial, *numbers = struct.unpack_from(layout, packet, 8)
        if status:
            raise DriverError(f"{self.name} does not measure: {reason(status)}")
        if mode != STATIONARY or trial:
            raise DriverError(f"{self.name} measures in mode {mode}{' on trial' * bool(trial)}, expected {STATIONARY}")
        covariance = np.diag(np.square(numbers[3:6]))
        if kind == EXTENDED:
            covariance[ROWS, COLUMNS] = covariance[COLUMNS, ROWS] = numbers[7:10]
        if not np.all(np.isfinite(covariance)) or np.linalg.eigvalsh(covariance)[0] < -1e-6 * np.trace(covariance):
            raise DriverError(f"{self.name} states deviations and covariances that cannot be: {numbers[3:10]}")
        return np.array(numbers[:3]), covariance if covariance.any() else None

    def _command(self, number: int, body: bytes = b"") -> None:
        self.send(struct.pack("<3i", 12 + len(body), COMMAND, number) + body)

    def _packet(self, wait: Wait) -> tuple[int, bytes]:
        """Wait for a whole packet whose kind is known; return its kind, and all of its bytes."""
        while True:
            size, kind = struct.unpack_from("<2i", self.pending) if len(self.pending) >= SMALLEST else (SMALLEST, -1)
            if not (SHORTEST.get(kind, SMALLEST) <= size <= LARGEST):
                raise DriverError(f"{self.name} sends a packet of {size} bytes: it does not speak as an emScon server")
            if len(self.pending) < size:
                if self.receive():
                    within = f", within a packet, after {len(self.pending)} bytes" if self.pending else ""
                    raise self.lost(f"it was closed by the other side{within}")
                wait()
                continue
            packet, self.pending = self.pending[:size], self.pending[size:]
            if kind in SHORTEST:
                return kind, packet


def reason(status: int) -> str:
    """Return what a status says, for a person."""
    return STATUS.get(status, f"status {status} of the tracker's list; look at beam and reflector")
