"""Forward kinematics and Jacobians against pinocchio and finite differences."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import linear_jacobian, posture
from calibration_core.model.robot import pinocchio_model
from calibration_core.model.statics import Load, gravity_torque, load_torque

POINT = np.array([0.1, -0.2, 0.3])


def test_posture_equals_pinocchio(chain: Chain) -> None:
    q = np.random.default_rng(7).uniform(-3, 3, (20, chain.n))
    at = posture(chain, q)
    model = pinocchio_model(chain)
    data = model.createData()
    for k, angles in enumerate(q):
        pin.framesForwardKinematics(model, data, angles)
        flange = data.oMf[model.getFrameId("flange")]
        np.testing.assert_allclose(at.flange_origin[:, k], flange.translation, atol=1e-13)
        np.testing.assert_allclose(at.flange[:, :, k].T, flange.rotation, atol=1e-13)
        np.testing.assert_allclose(at.point(POINT)[:, k], flange.act(POINT), atol=1e-13)


def test_jacobian_and_torque_equal_pinocchio(chain: Chain) -> None:
    rng = np.random.default_rng(8)
    q = rng.uniform(-3, 3, (10, chain.n))
    force, torque = rng.normal(size=(3, 10)), rng.normal(size=(3, 10))
    at = posture(chain, q)
    columns = linear_jacobian(at, at.point(POINT))
    ours = load_torque(at, Load(force, torque, POINT, None))
    gravity = gravity_torque(chain, at)
    model = pinocchio_model(chain)
    data = model.createData()
    for k, angles in enumerate(q):
        pin.computeJointJacobians(model, data, angles)
        pin.framesForwardKinematics(model, data, angles)
        flange = data.oMf[model.getFrameId("flange")]
        jacobian = pin.getFrameJacobian(model, data, model.getFrameId("flange"), pin.LOCAL_WORLD_ALIGNED)
        arm = flange.rotation @ POINT
        linear = jacobian[:3] - pin.skew(arm) @ jacobian[3:]
        np.testing.assert_allclose(columns[:, :, k].T, linear, atol=1e-12)
        np.testing.assert_allclose(ours[:, k], linear.T @ force[:, k] + jacobian[3:].T @ torque[:, k], atol=1e-12)
        held = pin.computeGeneralizedGravity(model, data, angles)  # the torque that holds it up
        np.testing.assert_allclose(gravity[:, k], -held, atol=1e-9)


def test_corrected_geometry_moves_the_frame_before_the_joint(chain: Chain) -> None:
    second = 2 if chain.prismatic[1] else 1  # a joint that turns, as the correction does
    geometry = np.zeros((chain.n, 6))
    geometry[second] = [1e-3, -2e-3, 3e-3, 0.0, 0.0, 0.4]
    at, moved = (posture(c, np.zeros((1, chain.n))) for c in (chain, chain.corrected(geometry)))
    step = at.before[second][:, :, 0].T @ geometry[second, :3]
    np.testing.assert_allclose(moved.origin[second][:, 0] - at.origin[second][:, 0], step, atol=1e-14)
    turned = posture(chain, 0.4 * np.eye(chain.n)[[second]])
    np.testing.assert_allclose(moved.flange[:, :, 0], turned.flange[:, :, 0], atol=1e-13)
