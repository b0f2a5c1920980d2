"""Choice of 18 configurations: time, memory, share of what is attainable, and what it is worth.

Bars: of 10,000 candidates, 6 stiffnesses in 0.5 s and 23 kinematic parameters in 2 s of processor time, 200 MB, for
certain 95 % of the continuous optimum; against figaroh's Detmax on the same candidates and terms 20 times faster, no
smaller determinant; against random configurations the worst stiffness 1.5 times narrower; errors seen within 15 %
of those promised.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from planning_problems import CELL, kinematic_candidates, stiffness_candidates
from planning_worth import promised_and_seen, random_over_planned

from calibration_core.planning.loaded import make_plan
from calibration_core.planning.optimal_design.design import choose
from calibration_core.planning.optimal_design.optimum import Candidates, continuous_optimum

HERE = Path(__file__).resolve().parent
PEER = HERE.parents[1] / "build" / "peers" / "figaroh" / "bin" / "python"
COUNT, REPEATS, SEEDS = 18, 5, 200
FASTER, NARROWER, AS_PROMISED = 20.0, 1.5, 0.15
CHOICE = """
import json, sys, time
from pathlib import Path
import numpy as np
from calibration_core.planning.optimal_design.design import choose
from calibration_core.planning.optimal_design.optimum import Candidates, continuous_optimum
information = np.load(sys.argv[1])["information"]
seconds = []
for _ in range(int(sys.argv[3])):
    start = time.process_time()
    choice = choose(Candidates(information), int(sys.argv[2]))
    seconds.append(time.process_time() - start)
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
peak = int(status["VmHWM"].split()[0]) / 1024
again = choose(Candidates(information), int(sys.argv[2]), repeated=True)
certain = float(np.exp(choice.score - continuous_optimum(Candidates(information), choice.criterion).bound))
print(json.dumps({"seconds": seconds, "chosen": choice.chosen.tolist(), "again": again.chosen.tolist(), "peak": peak,
                  "certain": certain, "different": choice.efficiency}))
"""


def _run(command: list[str], **environment: str) -> dict[str, object]:
    done = subprocess.run(
        command, check=True, capture_output=True, text=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", **environment},
    )  # fmt: skip
    answer: dict[str, object] = json.loads(done.stdout.strip().splitlines()[-1])
    return answer


def test_a_thousand_candidates() -> None:
    matrices = stiffness_candidates(1000)
    seconds = []
    for _ in range(REPEATS):
        start = time.process_time()
        choice = choose(Candidates(matrices), COUNT)
        seconds.append(time.process_time() - start)
    certain = float(np.exp(choice.score - continuous_optimum(Candidates(matrices), choice.criterion).bound))
    print(f"\n18 of 1,000, 6 stiffnesses: {1e3 * statistics.median(seconds):.0f} ms (bar 100), "
          f"{100 * certain:.1f} % of the continuous optimum")  # fmt: skip
    assert statistics.median(seconds) < 0.1
    assert certain >= 0.95


@pytest.mark.parametrize(
    ("name", "candidates", "bar"),
    [("6 stiffnesses", stiffness_candidates, 0.5), ("23 kinematic parameters", kinematic_candidates, 2.0)],
    ids=["stiffness", "kinematic"],
)
def test_ten_thousand_candidates_beside_figaroh(name: str, candidates: Callable[[int], np.ndarray], bar: float) -> None:
    information = candidates(10_000)
    scale = 1.0 / np.sqrt(np.einsum("mii->i", information) / len(information))
    information = information * scale[:, None] * scale  # the same, well scaled, for both
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "candidates.npz"
        np.savez(file, information=information)
        ours = _run([sys.executable, "-c", CHOICE, str(file), str(COUNT), str(REPEATS)])
        theirs = _run([str(PEER), str(HERE / "peers" / "choose_figaroh.py"), str(file), str(COUNT), "1"], PYTHONPATH="")
    took, peak = statistics.median(ours["seconds"]), float(ours["peak"])
    value = {
        name: np.linalg.slogdet(information[rows].sum(axis=0))[1] / information.shape[1]
        for name, rows in (("ours", ours["chosen"]), ("again", ours["again"]), ("theirs", theirs["chosen"]))
    }
    ratio = float(theirs["seconds"]) / took
    twice = COUNT - len(set(theirs["chosen"]))
    print(f"\n18 of 10,000, {name}: {took:.2f} s (bar {bar}), {peak:.0f} MB (bar 200), for certain "
          f"{100 * float(ours['certain']):.1f} % of the continuous optimum (bar 95)\n"
          f"figaroh Detmax: {float(theirs['seconds']):.0f} s, {ratio:.0f} times longer (bar {FASTER:.0f}); it may take "
          f"candidates again and did so {twice} times; our det^(1/n) over its: "
          f"{np.exp(value['again'] - value['theirs']):.5f} on the same terms, "
          f"{np.exp(value['ours'] - value['theirs']):.5f} with 18 different configurations")  # fmt: skip
    assert len(theirs["chosen"]) == COUNT
    assert len(set(ours["chosen"])) == COUNT
    assert took <= bar
    assert peak <= 200
    assert float(ours["certain"]) >= 0.95
    assert ratio >= FASTER
    assert value["again"] >= value["theirs"] - 1e-9  # the same problem: both may repeat


def test_whole_plan() -> None:
    start = time.process_time()
    plan = make_plan(CELL)
    took = time.process_time() - start
    assert plan.expected is not None
    assert plan.expected.stiffness_std is not None
    assert plan.expected.efficiency is not None
    worst = 100 * plan.expected.stiffness_std.max()
    print(
        f"\nplan of {len(plan.configurations)} configurations from 12,000 candidates: {took:.2f} s, "
        f"{100 * plan.expected.efficiency:.1f} % of the attainable, worst joint {worst:.1f} % (one sigma)"
    )
    assert took < 5.0


@pytest.mark.parametrize("criterion", ["D", "A"])
def test_planned_against_random(criterion: str) -> None:
    ratio = random_over_planned(SEEDS, criterion)
    low, median, high = np.quantile(ratio, [0.05, 0.5, 0.95])
    print(f"\nworst stiffness interval, random over planned (criterion {criterion}), {SEEDS} seeds: "
          f"median {median:.2f} (bar {NARROWER}), 5 % to 95 %: {low:.2f} to {high:.2f}")  # fmt: skip
    assert median >= NARROWER


def test_promised_against_seen() -> None:
    ratio = promised_and_seen(SEEDS)
    print(f"\nerrors seen over errors promised, {SEEDS} seeds, per joint: {', '.join(f'{r:.3f}' for r in ratio)} "
          f"(bar within {AS_PROMISED})")  # fmt: skip
    assert np.all(np.abs(ratio - 1.0) <= AS_PROMISED)


if __name__ == "__main__":
    sys.exit(pytest.main([__file__, "-s", "-o", "python_files=bench_*.py"]))
