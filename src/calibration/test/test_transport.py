"""Processes of the suite share no memory: what one of them leaves locked when it is killed cannot block another."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration.transport import PROFILES, PROFILES_FILES, SHARED, sockets_only

ROOT = Path(__file__).resolve().parents[3]
CELL = ROOT / "config" / "cells" / "demo.cell.yaml"
LONG = 60.0  # s of wall time, that a process may take to appear on a busy machine
OF_DISCOVERY = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS")
OURS = (*PROFILES_FILES, "FASTDDS_BUILTIN_TRANSPORTS", *OF_DISCOVERY)
HERE = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
AGAIN = {PROFILES_FILES[0]: str(PROFILES)}  # of a process whose parent has called it, and which is limited once more
ANYWHERE = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_STATIC_PEERS": "127.0.0.1"}
LISTENER = """
import sys
import rclpy
from calibration_interfaces.msg import Permission
rclpy.init()
node = rclpy.create_node("listener")
heard = []
node.create_subscription(Permission, "calibration/permission", heard.append, 10)
while not heard:
    rclpy.spin_once(node, timeout_sec=0.1)
shared = [line for line in open("/proc/self/maps") if "/dev/shm/fastrtps" in line]
print("heard; shares memory" if shared else "heard", flush=True)
"""


@pytest.mark.parametrize(
    ("given", "changed", "warning"),
    [
        ({}, {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}, ""),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}, ""),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "UDPv6"}, {}, ""),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA"}, {}, SHARED),
        (HERE, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT", PROFILES_FILES[0]: str(PROFILES)}, ""),
        (HERE | {"ROS_STATIC_PEERS": "10.0.0.7"}, {}, SHARED),
        (HERE | AGAIN, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}, ""),
        (HERE | {"FASTDDS_DEFAULT_PROFILES_FILE": "own.xml"}, {}, SHARED),
        ({"FASTDDS_DEFAULT_PROFILES_FILE": "own.xml"}, {}, ""),
        (HERE | {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, {}, ""),
    ],
)
def test_what_a_user_has_set_stays(given: dict[str, str], changed: dict[str, str], warning: str) -> None:
    environment = dict(given)
    assert sockets_only(environment) == warning
    assert environment == given | changed


@pytest.mark.parametrize(
    "limits",
    [
        pytest.param(ANYWHERE, id="anywhere"),
        pytest.param(HERE, id="here"),
        pytest.param({"ROS_LOCALHOST_ONLY": "1"}, id="here, old", marks=pytest.mark.slow),
        pytest.param(HERE | AGAIN, id="here, again", marks=pytest.mark.slow),
    ],
)
def test_a_node_shares_no_memory_and_is_heard_by_those_who_do(
    source_environment: dict[str, str], tmp_path: Path, limits: dict[str, str]
) -> None:
    """The guard, told where to look for others, as a driver or a tool with the settings of ROS hears it."""
    plain = {name: value for name, value in source_environment.items() if name not in OURS}
    command = [str(ROOT / "install/calibration/lib/calibration/guard"), "--ros-args", "-p", f"cell:={CELL}",
               "-p", "motion.backend:=simulated", "-p", "robot_state.adapter:=native"]  # fmt: skip
    log = tmp_path / "guard.log"
    with log.open("wb") as out:
        guard = subprocess.Popen(command, env={**plain, **limits}, stdout=out, stderr=subprocess.STDOUT)
    listener = subprocess.Popen(
        [sys.executable, "-c", LISTENER], env={**plain, **limits}, stdout=subprocess.PIPE, text=True
    )
    try:
        heard, _ = listener.communicate(timeout=LONG)
        assert heard.strip() == "heard; shares memory"  # the limits alone would have the guard share it, too
        maps = Path(f"/proc/{guard.pid}/maps").read_text(encoding="utf-8")
        assert "libfastrtps" in maps
        assert "/dev/shm/fastrtps" not in maps, log.read_text(encoding="utf-8")
    finally:
        listener.kill()
        guard.terminate()
        guard.wait(LONG)
        end = time.monotonic() + LONG
        while listener.poll() is None:
            assert time.monotonic() < end
            time.sleep(0.01)
