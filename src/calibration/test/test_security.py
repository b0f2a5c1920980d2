"""The SROS2 policy has the form of the schema, and allows what the nodes do, as the graph of the shipped tree shows.

Enforcement needs a Fast DDS with security, which the wheels have not: what is refused then is not tested here.
"""

from __future__ import annotations

import copy
import os
import subprocess
import time
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from rclpy.action import get_action_client_names_and_types_by_node, get_action_server_names_and_types_by_node
from tree_runner import INSTALL, TreeRunner

from calibration.process_tree import SIMULATED_CELL

ROOT = Path(__file__).resolve().parents[3]
CELL = ROOT / "config" / "cells" / "demo.cell.yaml"
POLICIES = ROOT / "src" / "calibration" / "security" / "policies.xml"
INCLUDE = "{http://www.w3.org/2001/XInclude}include"
PATIENCE = 90.0  # s, until the nodes are there and have found each other
STABLE = 3.0  # s, in which the graph does not change

# The schema of SROS2 policies 0.2.0 (ros2/sros2, sros2/policy/schemas/policy.xsd), as far as it is used here:
# element -> attributes and what may be in it.
SCHEMA: dict[str, tuple[set[str], set[str]]] = {
    "policy": ({"version"}, {"enclaves"}),
    "enclaves": (set(), {"enclave"}),
    "enclave": ({"path"}, {"profiles"}),
    "profiles": (set(), {"profile"}),
    "profile": ({"ns", "node"}, {"topics", "services", "actions"}),
    "topics": ({"publish", "subscribe"}, {"topic"}),
    "services": ({"reply", "request"}, {"service"}),
    "actions": ({"call", "execute"}, {"action"}),
    "topic": (set(), set()),
    "service": (set(), set()),
    "action": (set(), set()),
}
KINDS = {"publish": "topic", "subscribe": "topic", "reply": "service", "request": "service", "call": "action",
         "execute": "action"}  # fmt: skip
Access = dict[str, set[str]]

# Allowed, and not seen in the simulated cell: what the back ends and adapters of real cells need.
REAL: dict[tuple[str, str], set[str]] = {
    ("guard", "subscribe"): {  # adapter industrial, and a driver's goals
        "robot_status",
        "joint_trajectory_controller/follow_joint_trajectory/_action/status",
    },
    ("guard", "request"): {"joint_trajectory_controller/follow_joint_trajectory/_action/cancel_goal"},
    ("guard", "publish"): {"joint_trajectory_controller/joint_trajectory"},
    ("sequencer", "call"): {"joint_trajectory_controller/follow_joint_trajectory"},
    ("sequencer", "publish"): {"joint_trajectory_controller/joint_trajectory"},
    ("tracker", "subscribe"): {"/tf", "joint_states", "tracker/typed"},  # input_type: tf; a driver that aims
    ("tracker", "publish"): {"calibration/event"},  # stamp: sender_offset
    ("panel", "call"): {"sequencer/run", "identification/identify"},  # while what was asked for there is under way
    ("identification", "subscribe"): {"clock"},  # use_sim_time, which its launch files leave alone
    ("compensation", "subscribe"): {"clock"},  # likewise
}


def policy(namespace: str = "") -> ET.Element:
    """The policy with what it includes, for a namespace changed as its documentation says."""
    command = ["sed", f's#ns="/"#ns="/{namespace}"#', str(POLICIES)]
    assert 'sed \'s#ns="/"#ns="/NAMESPACE"#\'' in POLICIES.read_text("utf-8")
    root = ET.fromstring(subprocess.run(command, capture_output=True, check=True).stdout)
    for profile in root.iter("profile"):
        for place in profile.findall(INCLUDE):
            assert place.get("xpointer") == "xpointer(/profile/*)"
            common = ET.parse(POLICIES.parent / str(place.get("href"))).getroot()
            profile.remove(place)
            profile.extend(copy.deepcopy(list(common)))
    return root


def full(name: str, profile: ET.Element) -> str:
    """A name of the policy as it stands in the graph."""
    space = str(profile.get("ns")).rstrip("/")
    if name.startswith("/"):
        return name
    return f"{space}/{profile.get('node')}{name[1:]}" if name.startswith("~") else f"{space}/{name}"


def allowed(namespace: str = "") -> dict[str, Access]:
    """What each node may do."""
    found = {}
    for profile in policy(namespace).iter("profile"):
        access: Access = {kind: set() for kind in KINDS}
        for group in profile:
            for kind in group.attrib:
                access[kind] |= {full(str(one.text), profile) for one in group}
        found[str(profile.get("node"))] = access
    return found


def done(client: Any, name: str, namespace: str) -> Access:
    """What a node does, as the graph shows it."""
    at = (name, f"/{namespace}")

    def names(found: list[tuple[str, list[str]]]) -> set[str]:
        return {one for one, _ in found}

    calls = names(get_action_client_names_and_types_by_node(client, *at))
    executes = names(get_action_server_names_and_types_by_node(client, *at))
    access = {
        "publish": names(client.get_publisher_names_and_types_by_node(*at)),
        "subscribe": names(client.get_subscriber_names_and_types_by_node(*at)),
        "reply": names(client.get_service_names_and_types_by_node(*at)),
        "request": names(client.get_client_names_and_types_by_node(*at)),
    }
    for action in calls | executes:  # an action is made of topics and services
        for of in access.values():
            of -= {one for one in of if one.startswith(f"{action}/_action/")}
    return {**access, "call": calls, "execute": executes}


def real(node: str, kind: str, namespace: str) -> set[str]:
    """What real cells alone need, as it stands in the graph."""
    space = f"/{namespace}" if namespace else ""
    return {name if name.startswith("/") else f"{space}/{name}" for name in REAL.get((node, kind), set())}


def lines(node: str, access: Access) -> str:
    """What has to be added to the policy of a node, as it is written there."""
    return "".join(
        f'\n  {node}: <{KINDS[kind]}s {kind}="ALLOW"> <{KINDS[kind]}>{name}</{KINDS[kind]}>'
        for kind, names in access.items()
        for name in sorted(names)
    )


def beyond(given: Access, limit: Access, node: str) -> str:
    return lines(node, {kind: names - limit[kind] for kind, names in given.items()})


def agrees(client: Any, namespace: str = "") -> None:
    """See that the policy allows what the nodes do, once the graph does not change any more, and no more."""
    may = allowed(namespace)
    end, since, seen = time.monotonic() + PATIENCE, time.monotonic(), {}
    while time.monotonic() < end:
        there = set(client.get_node_names())
        before, seen = seen, {node: done(client, node, namespace) for node in may if node in there}
        since = since if seen == before else time.monotonic()
        if set(seen) == set(may) and time.monotonic() - since > STABLE:
            break
        time.sleep(0.2)
    assert set(seen) == set(may)
    missing = "".join(beyond(seen[node], may[node], node) for node in may)
    assert missing == "", f"add to security/policies.xml (or, if every node does it, to common.xml): {missing}"
    idle = "".join(
        beyond({kind: names - real(node, kind, namespace) for kind, names in may[node].items()}, seen[node], node)
        for node in may
    )
    assert idle == "", f"take out of security/policies.xml, for no node does it: {idle}"
    enclaves = {name: enclave for name, _, enclave in client.get_node_names_and_namespaces_with_enclaves()}
    assert {node: enclaves[node] for node in may} == {node: f"/calibration/{node}" for node in may}


def test_it_has_the_form_of_the_schema() -> None:
    root = policy()
    assert (root.tag, root.get("version")) == ("policy", "0.2.0")
    for element in root.iter():
        attributes, children = SCHEMA[element.tag]
        assert set(element.attrib) <= attributes
        assert {child.tag for child in element} <= children
        assert bool(len(element)) == bool(children), element.tag
        if element.tag in ("topics", "services", "actions"):
            assert set(element.attrib.values()) == {"ALLOW"}
    paths = [enclave.get("path") for enclave in root.iter("enclave")]
    assert sorted(paths) == sorted({process.enclave for process in SIMULATED_CELL.processes})


def test_nobody_but_the_sequencer_may_move_the_robot() -> None:
    movers = {
        node
        for node, access in allowed().items()
        for name in (*access["call"], *(one for one in access["request"] if one.endswith("/_action/send_goal")))
        if name in ("/driver/move_to", "/joint_trajectory_controller/follow_joint_trajectory")
    }
    assert movers == {"sequencer"}


@pytest.mark.slow
@pytest.mark.alone
def test_in_a_namespace_it_allows_what_the_nodes_do(
    spinning: Any, source_environment: dict[str, str], tmp_path: Path
) -> None:
    """In none it is seen where the shipped tree is."""
    said = {"cell": CELL, "session": tmp_path / "session", "namespace": "left", "tracker": "stream"}
    runner = TreeRunner(SIMULATED_CELL, source_environment, tmp_path, **said)
    try:
        runner.start()
        agrees(spinning.plain("outside"), "left")
    finally:
        runner.shutdown()


def test_without_its_enclave_no_node_runs(source_environment: dict[str, str], tmp_path: Path) -> None:
    security = {
        "ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce", "ROS_SECURITY_KEYSTORE": str(tmp_path),
    }  # fmt: skip
    guard = INSTALL / "calibration" / "lib" / "calibration" / "guard"
    answer = subprocess.run(
        [guard, "--ros-args", "--enclave", "/calibration/guard", "-p", f"cell:={CELL}"],
        env={**os.environ, **source_environment, **security}, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert answer.returncode == 2
    assert answer.stderr.startswith("ROS_SECURITY_ENABLE is true, and the node does not run without it: ")
    assert str(tmp_path / "enclaves" / "calibration" / "guard") in answer.stderr
    assert answer.stderr.count("\n") == 1
