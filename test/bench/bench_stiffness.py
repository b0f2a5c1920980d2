"""Equation (7) of CWA 17384 on 100,000 configurations: regressor, solution, covariance; beside a pinocchio loop.

The observation matrix of configuration i is A_i = J_MP diag(J_WP^T W_i); it is never stored as a whole.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np

M = 100_000
BLOCK = 2000  # configurations at a time: the arrays of one block stay in the cache
SIGMA = 2e-5


def _problem() -> tuple:
    from calibration_core.model.chain import Chain, rotation_x
    from calibration_core.model.statics import Load

    a, d = [0.35, 1.25, 0.041, 0.0, 0.0], [0.75, 0.0, 0.0, 1.1, 0.0]
    alpha = [-np.pi / 2, 0.0, -np.pi / 2, np.pi / 2, -np.pi / 2]
    chain = Chain(
        joints=tuple(f"joint_{i}" for i in range(1, 7)),
        rotation=np.stack([np.eye(3), *(rotation_x(x) for x in alpha)]),
        translation=np.array([[0.0, 0.0, 0.0], *([x, 0.0, z] for x, z in zip(a, d, strict=True))]),
        offset=np.array([0, -np.pi / 2, 0, 0, 0, 0]),
        flange_rotation=np.eye(3),
        flange_translation=np.array([0.0, 0.0, 0.23]),
        limits=np.tile([-2.5, 2.5], (6, 1)),
        gravity=np.array([0.0, 0.0, -9.80665]),
    )
    rng = np.random.default_rng(1)
    q = rng.uniform(-2.5, 2.5, (M, 6))
    wrench = np.column_stack([rng.normal(0, 1000, (M, 3)), rng.normal(0, 200, (M, 3))])
    load = Load(wrench[:, :3].T.copy(), wrench[:, 3:].T.copy(), np.array([0.0, 0.1, 0.2]), None)
    stiffness = np.array([1.41e6, 4.01e6, 9.35e5, 3.6e5, 3.7e5, 3.8e5])
    point = np.array([0.1, 0.0, 0.3])
    return chain, q, wrench, load, point, stiffness, rng


def _blocks(chain, q, load, point) -> Iterator[tuple[slice, np.ndarray]]:
    """Yield the rows of a block and their observation matrix, (3, n, rows) m per rad/(N*m)."""
    from calibration_core.model.kinematics import by_axis, linear_jacobian, posture
    from calibration_core.model.statics import load_torque

    for start in range(0, M, BLOCK):
        rows = slice(start, start + BLOCK)
        at = posture(chain, q[rows])
        yield rows, by_axis(linear_jacobian(at, at.point(point))) * load_torque(at, load.rows(rows))


def _deflection(chain, q, load, point, stiffness, rng) -> np.ndarray:
    parts = [np.einsum("anm,n->ma", columns, 1 / stiffness) for _, columns in _blocks(chain, q, load, point)]
    return np.vstack(parts) + rng.normal(0, SIGMA, (M, 3))


def _fitted(chain, q, load, point, deflection) -> tuple[np.ndarray, np.ndarray]:
    """Return compliances, not negative, and their standard deviations."""
    from calibration_core.identification.statistics import solve_non_negative

    matrix, vector = np.zeros((chain.n, chain.n)), np.zeros(chain.n)
    for rows, columns in _blocks(chain, q, load, point):
        flat, measured = columns.transpose(1, 0, 2).reshape(chain.n, -1), deflection[rows].T.reshape(-1)
        matrix += flat @ flat.T
        vector += flat @ measured
    solution = solve_non_negative(matrix, vector, np.zeros(chain.n))
    c = solution.value
    rest = float(np.vdot(deflection, deflection) - 2 * c @ vector + c @ matrix @ c)
    return c, np.sqrt(np.diag(solution.covariance) * rest / (3 * M - chain.n))


def _ours() -> None:
    chain, q, _, load, point, stiffness, rng = _problem()
    deflection = _deflection(chain, q, load, point, stiffness, rng)
    times = []
    for _ in range(5):
        start = time.perf_counter()
        compliance, std = _fitted(chain, q, load, point, deflection)
        times.append(time.perf_counter() - start)
    np.testing.assert_allclose(1 / compliance, stiffness, rtol=0.01)
    print(np.median(times), *compliance, *std)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def _loop() -> None:
    import pinocchio as pin

    from calibration_core.model.robot import pinocchio_model

    chain, q, wrench, load, point, stiffness, rng = _problem()
    deflection = _deflection(chain, q, load, point, stiffness, rng)
    model = pinocchio_model(chain)
    for name, where in (("mp", point), ("wp", load.point)):
        flange = model.frames[model.getFrameId("flange")]
        placement = flange.placement * pin.SE3(np.eye(3), where.copy())
        model.addFrame(pin.Frame(name, flange.parentJoint, 0, placement, pin.FrameType.OP_FRAME))
    data = model.createData()
    mp, wp = model.getFrameId("mp"), model.getFrameId("wp")
    times = []
    for _ in range(3):
        start = time.perf_counter()
        columns = np.empty((M, 3, 6))
        for k in range(M):
            pin.computeJointJacobians(model, data, q[k])
            pin.updateFramePlacements(model, data)
            at_mp = pin.getFrameJacobian(model, data, mp, pin.LOCAL_WORLD_ALIGNED)
            at_wp = pin.getFrameJacobian(model, data, wp, pin.LOCAL_WORLD_ALIGNED)
            columns[k] = at_mp[:3] * (at_wp.T @ wrench[k])
        flat = columns.reshape(-1, 6)
        c, rest, _, _ = np.linalg.lstsq(flat, deflection.reshape(-1), rcond=None)
        covariance = np.linalg.inv(flat.T @ flat) * rest[0] / (3 * M - 6)
        times.append(time.perf_counter() - start)
    print(np.median(times), *c, *np.sqrt(np.diag(covariance)))


def test_stiffness_of_100000_configurations() -> None:
    answers = {}
    for name in ("_ours", "_loop"):
        done = subprocess.run([sys.executable, __file__, name], check=True, capture_output=True, text=True)
        lines = done.stdout.splitlines()
        answers[name] = np.array(lines[0].split(), dtype=float)
        if name == "_ours":
            megabytes = int(lines[1]) / 1024
    ratio = answers["_ours"][0] / answers["_loop"][0]
    print(
        f"\n100,000 configurations: {answers['_ours'][0]:.3f} s and {megabytes:.0f} MB, "
        f"pinocchio loop + lstsq {answers['_loop'][0]:.3f} s, ratio {ratio:.2f}"
    )
    np.testing.assert_allclose(answers["_ours"][1:], answers["_loop"][1:], rtol=1e-8)
    assert ratio <= 0.5
    assert megabytes <= 400


if __name__ == "__main__":
    {"_ours": _ours, "_loop": _loop}[sys.argv[1]]()
