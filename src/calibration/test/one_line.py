"""A stand-in for the program on a tracker's computer: answers lines over TCP, as the templates say; run as a process.

It prints its port.  Its argument is JSON: where targets stand (m), and which fault each of them meets, once.
"""

from __future__ import annotations

import json
import re
import socket
import sys
import time

AIM = re.compile(r"AIM (\S+) (\S+) (\S+) (\S+)")
MEASURE = re.compile(r"MEASURE (\S+) (\S+)")
T2SA = re.compile(r"!MEAS_SINGLE_POINT:A;ROBOT;(\S+)")


def answers(line: str, places: dict[str, list[float]], faults: dict[str, str]) -> list[bytes | None]:
    """What is sent, piece by piece; None closes the connection."""
    if found := AIM.fullmatch(line):
        name = found[1]
        if faults.get(name) == "absent":
            del faults[name]
            return [b"ERROR no reflector found\n"]
        aimed = [float(one) for one in found.groups()[1:]]
        places.setdefault(name, aimed)
        return [b"OK\n"]
    if found := MEASURE.fullmatch(line):
        name, fault = found[1], faults.pop(found[1], "")
        time.sleep(float(found[2]))  # as long as the tracker measures
        x, y, z = places[name]
        good = f"POINT {name} {x:.7f} {y:.7f} {z:.7f} 1e-5 2e-5 3e-5\n".encode()
        other = f"POINT {name} {x + 0.3:.7f} {y:.7f} {z:.7f}\n".encode()
        metres = f"POINT {name} {1e3 * x:.4f} {1e3 * y:.4f} {1e3 * z:.4f}\n".encode()
        wrong = f"POINT other {x} {y} {z}\n".encode()
        return {
            "mute": [],
            "half": [good[:12]],
            "cut": [good[:12], None],
            "gone": [None],
            "garbage": [b"\x00\xff what?\n"],
            "nan": [f"POINT {name} nan nan nan\n".encode()],
            "unit": [metres],
            "other": [other],
            "name": [wrong],
            "broken": [b"ERROR beam broken\n"],
            "slow": [good[:9], good[9:]],
        }.get(fault, [good])
    if found := T2SA.fullmatch(line):
        x, y, z = (1e3 * one for one in places[found[1]])
        text = f"Single Point Measurement {found[1]} result {x:.6f},{y:.6f},{z:.6f} 2024-10-21 19:31:59 True"
        return [f"ACK-300 {text}\r\n".encode()]
    return [b"ERR-200 Command rejected\r\n"]


def main() -> None:
    given = json.loads(sys.argv[1])
    places, faults = given.get("places", {}), given.get("faults", {})
    with socket.create_server(("127.0.0.1", 0)) as server:
        print(server.getsockname()[1], flush=True)
        while True:
            client, _ = server.accept()
            with client, client.makefile("rb") as lines:
                for line in lines:
                    pieces = answers(line.decode().strip(), places, faults)
                    for piece in pieces:
                        if piece is None:
                            break
                        client.sendall(piece)
                    if None in pieces:
                        break


if __name__ == "__main__":
    main()
