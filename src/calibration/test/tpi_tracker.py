"""A stand-in for a Leica tracker: its binary interface over TCP, after the vendor's header; run as a process.

It prints its port, then every packet that it gets.  Its argument is JSON: `faults`, each met once, by the command that
meets it (`49: broken`), and `state`: how many bytes it sends at once (`piece`), how it is (`processor`, `laser`).
Every packet is laid out by the offsets that a C compiler gives the structures of TPI V3.6 (4-byte long, pack 4).
It has units, coordinates and a frame that another program left behind, and it obeys them.
"""

from __future__ import annotations

import json
import math
import socket
import struct
import sys
import time
from typing import Any

SETTINGS: dict[int, bytes] = {  # by the command that reads them
    6: struct.pack("<iiiii", 1, 1, 1, 3, 0),  # millimetre, degree, Fahrenheit, mmHg
    27: struct.pack("<i", 7),  # spherical
    48: struct.pack("<iiiiiiiii", 2, 1, 1, 1, 0, 1, 1, 1, 0),  # frames applied, no messages, positions, tries
    25: struct.pack("<i", 1),  # continuous
    81: struct.pack("<ii", 0, 1),  # no covariances of what is stationary
    29: struct.pack("<ii", 1000, 1),  # ms
}
NOT_READY, READY, UNITS_CHANGED = 25, 27, 6  # events
SIGMA = (1e-5, 2e-5, 3e-5)  # m
COVARIANCES = (5e-11, -2e-11, 1e-10)  # m^2: xy, xz, yz
UNKNOWN_COMMAND = 64  # that of an error which nobody asked for


def packet(size: int, kind: int) -> bytearray:
    data = bytearray(size)
    struct.pack_into("<ii", data, 0, size, kind)
    return data


def answer(command: int, status: int = 0, body: bytes = b"", kind: int = 0) -> bytes:
    data = packet(16 + len(body), kind)
    struct.pack_into("<ii", data, 8, command, status)
    data[16:] = body
    return bytes(data)


def event(change: int) -> bytes:
    data = packet(12, 8)
    struct.pack_into("<i", data, 8, change)
    return bytes(data)


def error(number: int, command: int = UNKNOWN_COMMAND) -> bytes:
    return answer(command, number, kind=1)


def result(place: list[float], *, status: int = 0, extended: bool = True, size: int = 0, mode: int = 0) -> bytes:
    data = packet(size or (204 if extended else 156), 9 if extended else 2)
    struct.pack_into("<i", data, 8, status)
    struct.pack_into("<ii", data, 12, mode, 0)
    struct.pack_into("<ddd", data, 20, *place)
    struct.pack_into("<ddd", data, 44, *SIGMA)
    struct.pack_into("<d", data, 68, math.hypot(*SIGMA))
    struct.pack_into("<ddd", data, 76, *(COVARIANCES if extended else (7.0, 8.0, 9.0)))  # or errors of pointing
    struct.pack_into("<ddd", data, 124 if extended else 100, 1.0, 1.0, 1.0)  # beforehand
    struct.pack_into("<ddd", data, 180 if extended else 132, 21.5, 1013.25, 45.0)
    return bytes(data)


class Tracker:
    """What it is told to be, and what it answers: pieces, None closes the connection."""

    def __init__(self, given: dict[str, Any]) -> None:
        self.faults: dict[str, str] = given.get("faults", {})
        self.state: dict[str, int] = given.get("state", {})
        self.settings = dict(SETTINGS)
        self.place: list[float] | None = None

    def stated(self, place: list[float]) -> list[float]:
        """The place in the units, coordinates and frame that are set."""
        unit = [1.0, 1e3][struct.unpack_from("<i", self.settings[6])[0]]
        kind = struct.unpack("<i", self.settings[27])[0]
        frames = struct.unpack_from("<ii", self.settings[48], 4)
        x, y, z = (unit * (one + 0.5 * frames[0] + 0.25 * frames[1]) for one in place)
        return [x, y, z] if kind == 0 else [math.atan2(y, x), math.atan2(math.hypot(x, y), z), math.hypot(x, y, z)]

    def answers(self, command: int, body: bytes) -> list[bytes | None]:
        fault = self.faults.pop(str(command), "")
        if fault.isdecimal():
            return [answer(command, int(fault))]
        if command == 1:
            numbers = (0, self.state.get("processor", 5), self.state.get("laser", 3), 2, 3, 6, 0, 1, 0, 390001)
            return [answer(1, 0, struct.pack("<10i", *numbers))]
        if command in self.settings:
            content = self.settings[command]
            return [answer(command, 0, content[:-4] if fault == "short" else content)]
        read = command + 1  # by which what this one sets is read
        if read in self.settings:
            if fault != "kept":
                self.settings[read] = body
            return [event({5: UNITS_CHANGED, 26: 12, 47: 8, 24: 17, 80: 24, 28: 18}[command]), answer(command)]
        if command == 55:
            if fault == "silent":
                return [error(1234)]
            x, y, z, _adm = struct.unpack("<dddi", body)
            self.place = None if fault == "absent" else [x, y, z]
            return [event(NOT_READY), answer(55, 1234)] if fault == "absent" else [event(READY), answer(55)]
        if command == 49:
            return self.measured(fault)
        return [answer(command)]

    def measured(self, fault: str) -> list[bytes | None]:
        if self.place is None:
            return [answer(49, 10004)]
        time.sleep(struct.unpack_from("<i", self.settings[29])[0] / 1e3)  # a tracker takes its measuring time
        extended = struct.unpack_from("<i", self.settings[81])[0] == 1
        place = self.stated(self.place)
        begun, good = answer(49), result(place, extended=extended)
        if fault == "units":
            self.settings[6] = SETTINGS[6]
        return {
            "broken": [begun, event(NOT_READY), error(1234)],
            "error": [begun, error(1234)],
            "none": [begun, error(10009, 49)],
            "closing": [begun, event(998)],
            "status": [begun, result(place, status=10009)],
            "sixd": [begun, result(place, mode=6)],
            "plain": [begun, result(place, extended=False)],
            "longer": [begun, result(place, size=212)],
            "shorter": [begun, struct.pack("<i", 196) + good[4:196]],
            "first": [good, begun],
            "nan": [begun, result([math.nan] * 3)],
            "unit": [begun, result([1e3 * one for one in place])],
            "other": [begun, result([place[0] + 0.3, *place[1:]])],
            "odd": [begun, good[:76] + struct.pack("<d", 1.0) + good[84:]],
            "cut": [begun, good[:100], None],
            "gone": [begun, None],
            "mute": [begun],
            "negative": [begun, struct.pack("<ii", -5, 9) + good[8:]],
            "huge": [begun, struct.pack("<ii", 2**31 - 1, 9) + good[8:]],
            "tiny": [begun, struct.pack("<ii", 8, 1)],
            "big-endian": [begun, struct.pack(">ii", 204, 9) + good[8:]],
            "text": [begun, b"ERROR what?\r\n"],
            "flood": [begun, *([event(READY)] * 20_000)],
        }.get(fault, [begun, good])


def exact(client: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        more = client.recv(size - len(data))
        if not more:
            raise ConnectionError
        data += more
    return data


def serve(client: socket.socket, tracker: Tracker) -> None:
    unasked = event(30) + bytes(packet(99, 42)) + bytes(packet(36, 7))  # a face, what no header knows, a position
    client.sendall(unasked)
    while True:
        head = exact(client, 12)
        size, _kind, command = struct.unpack("<iii", head)
        body = exact(client, size - 12)
        print((head + body).hex(), flush=True)
        pieces = tracker.answers(command, body)
        data = b"".join(one for one in pieces if one is not None)
        step = tracker.state.get("piece", 0)
        if step:
            for k in range(0, len(data), step):
                client.sendall(data[k : k + step])
        else:
            client.sendall(unasked + data)  # several packets at once
        if None in pieces:
            return


def main() -> None:
    tracker = Tracker(json.loads(sys.argv[1]))
    with socket.create_server(("127.0.0.1", 0)) as server:
        print(server.getsockname()[1], flush=True)
        while True:
            client, _ = server.accept()
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with client:
                try:
                    serve(client, tracker)
                except ConnectionError:
                    print("closed", flush=True)


if __name__ == "__main__":
    main()
