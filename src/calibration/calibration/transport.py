"""How the suite's processes talk to each other: by sockets alone, never by memory that they share.

What Fast DDS keeps in shared memory is guarded by locks that all processes of a machine use.  One that is killed or
stopped while it holds such a lock blocks whoever sends to it, without end; and whoever opens the port of one that does
not answer waits for a second (`healthy_check_timeout_ms`).  Both hold up the thread that would have to stop the robot.
"""

from __future__ import annotations

from collections.abc import MutableMapping
from pathlib import Path

PROFILES = Path(__file__).with_name("loopback.xml")
RANGE, ONLY_HERE, PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS"
TRANSPORTS, SOCKETS = "FASTDDS_BUILTIN_TRANSPORTS", ("UDPv4", "UDPv6")
PROFILES_FILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
SHARED = "processes talk by shared memory: one that is killed may block the others; see doc/nodes.md"


def sockets_only(environment: MutableMapping[str, str]) -> str:
    """Have DDS use sockets alone, before a context is initialised; what somebody has set for DDS stays.

    A discovery that is limited to this computer brings shared memory, whatever `FASTDDS_BUILTIN_TRANSPORTS` and a
    profile say (rmw_fastrtps 8.4): a profile with the same limit takes its place.

    Args:
        environment: Of the process; changed.

    Returns:
        A warning where shared memory stays in use; empty if it does not, or if the DDS is another one.
    """
    if not environment.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp").startswith("rmw_fastrtps"):
        return ""
    here = environment.get(ONLY_HERE) == "1" or environment.get(RANGE, "").upper() == "LOCALHOST"
    profiles = {environment[name] for name in PROFILES_FILES if environment.get(name)}
    if here and all(map(_ours, profiles)) and not environment.get(PEERS):
        environment.pop(ONLY_HERE, None)
        environment[RANGE] = "SYSTEM_DEFAULT"
        environment[PROFILES_FILES[0]] = str(PROFILES)
        return ""
    if here:
        return SHARED
    if profiles:
        return ""
    return "" if environment.setdefault(TRANSPORTS, SOCKETS[0]) in SOCKETS else SHARED


def _ours(path: str) -> bool:
    """Tell whether a profile is the one of this package, of whichever copy of it."""
    try:
        return Path(path).read_bytes() == PROFILES.read_bytes()
    except OSError:
        return False
