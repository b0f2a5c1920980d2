"""The whole suite at work: a simulated cell with a concealed fault is measured, identified live, and replayed.

    source install/setup.bash && .venv/bin/python .ci/demo.py OUT

Starts the installed executables, has a plan measured, asks the identification service, identifies the recorded bag
once more without ROS, compares the two to the bit, and lets the diagnosis look for what was concealed.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import rclpy
from calibration_interfaces.action import RunPlan
from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import IdentifyStiffness
from rclpy.action import ActionClient
from tqdm import tqdm

ROOT = Path(__file__).resolve().parents[1]
CELL = ROOT / "config" / "cells" / "demo.cell.yaml"
PARAMETERS = [ROOT / "config" / name for name in ("ros.yaml", "simulation.yaml")]
NODES = ("guard", "tracker", "force_torque", "sequencer", "recorder", "identification")
SPEED = 25.0  # times real time, if the machine can
CONCEALED = ("joint_2", 3.0e-7)  # a bearing that tilts, rad/(N*m)
PATIENCE = 300.0  # s
LEVELS = (0.0, 0.333, 0.667, 1.0)  # shares of the full pull, per step


class Cell:
    """The processes, and what is asked of them."""

    def __init__(self, out: Path) -> None:
        self.out, self.bag = out, out / "session" / "bag"
        self.processes: list[subprocess.Popen[bytes]] = []
        own: dict[str, dict[str, object]] = {
            "recorder": {"out": self.bag},
            "identification": {"recording": self.bag},
        }
        joint, compliance = CONCEALED
        concealed = {"speed": SPEED, "concealed_joint": joint, "concealed_compliance": compliance}
        self._start("calibration_sim", "simulated_cell", concealed)
        for name in NODES:
            self._start("calibration", name, own.get(name, {}))

    def _start(self, package: str, name: str, own: dict[str, object]) -> None:
        command = [str(ROOT / "install" / package / "lib" / package / name), "--ros-args"]
        for file in PARAMETERS:
            command += ["--params-file", str(file)]
        for key, value in ({"cell": CELL} | own).items():
            command += ["-p", f"{key}:={value}"]
        with (self.out / f"{name}.log").open("wb") as log:
            self.processes.append(subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT))

    def stop(self) -> None:
        """End every process, and wait for it."""
        for process in self.processes:
            process.send_signal(signal.SIGINT)
        for process in self.processes:
            try:
                process.wait(15.0)
            except subprocess.TimeoutExpired:
                process.kill()


def wait(node: Any, future: Any, what: str) -> Any:
    """Spin until an answer is there."""
    end = time.monotonic() + PATIENCE
    while not future.done():
        if time.monotonic() > end:
            sys.exit(f"{what}: no answer within {PATIENCE:.0f} s")
        rclpy.spin_once(node, timeout_sec=0.05)
    return future.result()


def measure(node: Any, plan: Path, session: Path) -> Any:
    """Have the plan measured, with a progress bar."""
    client = ActionClient(node, RunPlan, "sequencer/run")
    if not client.wait_for_server(60.0):
        sys.exit("the sequencer does not come up: see its log")
    with tqdm(total=100, desc="measuring", bar_format="{l_bar}{bar}| [{elapsed}{postfix}]") as bar:

        def on_feedback(message: Any) -> None:
            told = message.feedback
            bar.n = round(100 * told.share_done)
            bar.set_postfix_str(f"configuration {told.configuration}, step {told.step}")

        goal = RunPlan.Goal(plan=str(plan), session=str(session))
        handle = wait(node, client.send_goal_async(goal, feedback_callback=on_feedback), "sequencer")
        result = wait(node, handle.get_result_async(), "sequencer").result
        bar.n = 100 if result.outcome.code == Outcome.OK else bar.n
    return result


def offline(out: Path, *arguments: object) -> dict[str, Any]:
    """Run the program `calibration`, which needs no ROS; return its result."""
    program = str(Path(sys.executable).parent / "calibration")
    command = [program, *map(str, arguments), "--cell", str(CELL), "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(command)}: {done.stderr.strip()}")
    return dict(json.loads((out / "result.json").read_text(encoding="utf-8"))) if (out / "result.json").exists() else {}


def main() -> int:
    """Run the demonstration; 0 if live and replayed results are the same to the bit."""
    parser = argparse.ArgumentParser(description="Measure a simulated cell with everything that a real one needs.")
    parser.add_argument("out", type=Path, help="directory, replaced")
    out = parser.parse_args().out.resolve()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    offline(out / "plan", "plan", "--load-levels", *LEVELS)
    rclpy.init()
    node = rclpy.create_node("demo")
    cell = Cell(out)
    try:
        result = measure(node, out / "plan" / "plan.yaml", out / "session")
        print(f"{result.outcome.text}, {result.readings} readings")
        if result.outcome.code != Outcome.OK:
            return 1
        client = node.create_client(IdentifyStiffness, "identification/identify_stiffness")
        client.wait_for_service(30.0)
        request = IdentifyStiffness.Request(cell=str(CELL), out=str(out / "identify"))
        answer = wait(node, client.call_async(request), "identification")
    finally:
        cell.stop()
        node.destroy_node()
        rclpy.try_shutdown()
    if answer.outcome.code != Outcome.OK:
        print(answer.outcome.text)
        return 1
    live, replayed = json.loads(answer.result_json), offline(out / "replay", "identify", cell.bag)
    same = all(live[key] == replayed[key] for key in live if key != "recording")
    for joint, value, std in zip(answer.joints, answer.stiffness, answer.std, strict=True):
        print(f"  {joint:10s} {value / 1e6:8.3f} ± {std / 1e6:.3f} 10⁶ N·m/rad")
    print(f"live and replayed results are {'the same to the bit' if same else 'DIFFERENT'}")
    found = offline(out / "diagnose", "diagnose", cell.bag)
    effects = [f"{entry['effect']} {entry['location']}" for entry in found.get("findings", [])]
    print(f"concealed: a tilting bearing of {CONCEALED[0]}; found: {', '.join(effects) or 'nothing'}")
    for name in ("identify", "replay", "diagnose"):
        print(f"report: {out / name / 'report.html'}")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
