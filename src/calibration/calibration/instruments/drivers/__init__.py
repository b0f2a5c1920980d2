"""Trackers with one beam: a driver aims at one target, then measures it; nothing here knows of ROS or of the robot."""

from __future__ import annotations

import contextlib
import dataclasses
import socket
from collections.abc import Callable, Iterator
from typing import Protocol

from calibration_core.timeseries import Float1D, Float2D

AXES = ("x", "y", "z")
CONNECT = 1.0  # s of wall time, in which a computer of the same network has accepted a connection
PIECE = 1 << 16  # bytes that are taken at once
Wait = Callable[[], int]
"""Waits a moment and returns the time, ns; raises where nobody wants the answer any more, or it comes too late."""


class DriverError(Exception):
    """The tracker did not do what it was asked, or its answer cannot be used; the text says what it did."""


@dataclasses.dataclass(frozen=True, eq=False)
class Seen:
    """A place that the tracker states.

    Attributes:
        begin: When it was asked for, ns.
        end: When it was stated, ns, later than that: the target was measured in between.
        place: (3,) m, tracker frame.
        covariance: (3, 3) m^2; None where the tracker states none.
    """

    begin: int
    end: int
    place: Float1D
    covariance: Float2D | None = None


class Driver(Protocol):
    """One tracker.  Its methods wait; one thread calls them at a time."""

    name: str  # of the tracker, for a person
    by_hand: bool  # whether a person aims, or measures
    awaited: str  # what is missing while it waits, for a person

    def aim(self, point: str, place: Float1D, wait: Wait) -> None:
        """Point the beam at a target that should be at (3,) m, tracker frame; what was stated before counts no more.

        Raises:
            DriverError: There is no target, or no tracker.
        """

    def measure(self, window: float, wait: Wait) -> list[Seen]:
        """Measure the target for so many s at least; return at least one place, in the order of time.

        Raises:
            DriverError: The beam is broken, or the answer cannot be used.
        """

    def close(self) -> None:
        """Give back what is held; it is taken again when it is needed."""


class Connection:
    """A tracker's computer over TCP.  After whatever went wrong it connects anew: no late answer is taken for another.

    Attributes:
        name: Host and port.
        awaited: What is missing while a driver waits, for a person.
        pending: Bytes that have come and were not read.
    """

    by_hand = False

    def __init__(self, address: tuple[str, int]) -> None:
        """Take host and port; the first request connects."""
        self.name = f"{address[0]}:{address[1]}"
        self.awaited = ""
        self.pending = b""
        self._address = address
        self._socket: socket.socket | None = None

    @property
    def connected(self) -> bool:
        """Whether there is a connection."""
        return self._socket is not None

    def close(self) -> None:
        """Close the connection."""
        if self._socket is not None:
            self._socket.close()
        self._socket, self.pending = None, b""

    @contextlib.contextmanager
    def closing_on_errors(self) -> Iterator[None]:
        """Close the connection whatever goes wrong.

        Raises:
            DriverError: The connection was lost.
        """
        try:
            yield
        except OSError as error:
            self.close()
            raise self.lost(str(error)) from error
        except BaseException:
            self.close()
            raise

    def send(self, data: bytes) -> None:
        """Send bytes.

        Raises:
            DriverError: Nobody accepts a connection.
            OSError: The connection is lost.
        """
        self._stream().sendall(data)

    def receive(self) -> bool:
        """Add what has come to `pending`; return whether the other side has closed the connection.

        Raises:
            DriverError: Nobody accepts a connection.
            OSError: The connection is lost.
        """
        with contextlib.suppress(BlockingIOError):
            data = self._stream().recv(PIECE)
            self.pending += data
            return not data
        return False

    def lost(self, why: str) -> DriverError:
        """Return the error of a connection that has ended."""
        return DriverError(f"the connection to {self.name} was lost: {why}")

    def _stream(self) -> socket.socket:
        if self._socket is None:
            try:
                self._socket = socket.create_connection(self._address, CONNECT)
            except OSError as error:
                raise DriverError(f"{self.name} cannot be reached: {error}") from error
            self._socket.setblocking(False)
        return self._socket
