"""The robot as a MuJoCo model: every joint a hinge with a spring, every link a weight.

Statics needs masses and centres of gravity only, so moments of inertia are nominal (a ball about the centre of
gravity) and say nothing.  There are no shapes, hence no contact, and no joint limits: a spring carries every load.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

from calibration_core.timeseries import Float1D, Float2D
from calibration_sim.chain import Chain, Link
from calibration_sim.transforms import Placement, quaternion, rotation_vector

# MuJoCo wants every body to be massive; a link without stated mass weighs a microgram.
LEAST_MASS = 1e-9
BALL_RADIUS = 0.1


def build_mjcf(chain: Chain, stiffness: Float1D, gravity: Float1D, joint_frame_errors: Float2D | None = None) -> str:
    """Write a robot as MJCF; the world frame is the base frame.

    Args:
        chain: The robot.
        stiffness: (n,) N*m/rad, one per joint in the order of q.
        gravity: (3,) m/s^2, base axes.
        joint_frame_errors: (n, 6) m and rad: how far each joint's frame (URDF: joint origin; DH: frame before the
            joint turns) is shifted, and turned by a rotation vector, in its own nominal axes.  None: the robot is
            built as stated.

    Returns:
        MJCF text.  Bodies and joints bear the names of links and joints.
    """
    springs = dict(zip(chain.joints, stiffness, strict=True))
    errors = np.zeros((len(chain.joints), 6)) if joint_frame_errors is None else joint_frame_errors
    moved = {name: Placement(rotation_vector(row[3:]), row[:3]) for name, row in zip(chain.joints, errors, strict=True)}
    children: dict[int, list[int]] = {}
    for index, link in enumerate(chain.links):
        children.setdefault(link.parent, []).append(index)
    lines = [
        '<mujoco model="robot">',
        '  <compiler angle="radian" autolimits="false" inertiafromgeom="false"/>',
        f'  <option gravity="{_numbers(gravity)}"/>',
        "  <worldbody>",
    ]

    def add(index: int, depth: int) -> None:
        link = chain.links[index]
        indent = "  " * depth
        origin = link.origin @ moved[link.joint] if link.joint else link.origin
        lines.append(
            f'{indent}<body name={quoteattr(link.name)} pos="{_numbers(origin.translation)}" '
            f'quat="{_numbers(quaternion(origin.rotation))}">'
        )
        lines.extend(f"{indent}  {line}" for line in _content(link, springs))
        for child in children.get(index, []):
            add(child, depth + 1)
        lines.append(f"{indent}</body>")

    for index in children.get(-1, []):
        add(index, 2)
    return "\n".join([*lines, "  </worldbody>", "</mujoco>", ""])


def _content(link: Link, springs: dict[str, float]) -> list[str]:
    mass = max(link.mass, LEAST_MASS)
    ball = 0.4 * mass * BALL_RADIUS**2
    lines = [f'<inertial pos="{_numbers(link.com)}" mass="{mass!r}" diaginertia="{_numbers((ball, ball, ball))}"/>']
    if link.joint:
        spring = f'stiffness="{float(springs[link.joint])!r}" springref="0"'
        lines.append(f'<joint name={quoteattr(link.joint)} type="hinge" axis="{_numbers(link.axis)}" {spring}/>')
    return lines


def _numbers(values: Sequence[float] | Float1D) -> str:
    return " ".join(repr(float(value)) for value in values)
