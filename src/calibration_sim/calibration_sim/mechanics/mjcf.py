"""The robot as a MuJoCo model: every joint a hinge with a spring, every link a weight, more springs where asked for.

Statics needs masses and centres of gravity only, so moments of inertia are nominal (a ball about the centre of
gravity) and say nothing.  There are no shapes, hence no contact, and no joint limits: a spring carries every load.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

from calibration_core.timeseries import Float1D, Float2D
from calibration_sim.mechanics.chain import Chain, Link
from calibration_sim.mechanics.transforms import Placement, quaternion, rotation_vector, translation

# MuJoCo wants every body to be massive; a link without stated mass weighs a microgram.
LEAST_MASS = 1e-9
BALL_RADIUS = 0.1
MOST_FREEDOMS = 6  # of one body, says MuJoCo


@dataclasses.dataclass(frozen=True, eq=False)
class Spring:
    """A place that gives way besides the joints: bearing, beam, pedestal, adapter.

    Attributes:
        link: The link that it carries; it gives way before that link's own joint turns.
        axis: (3,) unit axis in that link's frame, joint angle zero.
        place: (3,) m, where the axis stands, same frame; without meaning if it slides.
        stiffness: N*m/rad, or N/m if it slides.
        slides: Whether it moves along the axis instead of turning about it.
        rank: Of the springs that carry one link, the one of lowest rank comes first from the base on.
    """

    link: str
    axis: Float1D
    place: Float1D
    stiffness: float
    slides: bool = False
    rank: int = 0


def build_mjcf(
    chain: Chain,
    stiffness: Float1D,
    gravity: Float1D,
    joint_frame_errors: Float2D | None = None,
    springs: Sequence[Spring] = (),
) -> str:
    """Write a robot as MJCF; the world frame is the base frame.

    Args:
        chain: The robot.
        stiffness: (n,) N*m/rad, N/m where a joint slides, one per joint in the order of q.
        gravity: (3,) m/s^2, base axes.
        joint_frame_errors: (n, 6) m and rad: how far each joint's frame (URDF: joint origin; DH: frame before the
            joint turns) is shifted, and turned by a rotation vector, in its own nominal axes.  None: the robot is
            built as stated.
        springs: What gives way besides the joints.

    Returns:
        MJCF text.  Bodies and joints bear the names of links and joints; springs have none.
    """
    of_joint = dict(zip(chain.joints, stiffness, strict=True))
    springs_of: dict[str, list[Spring]] = {}
    for spring in sorted(springs, key=lambda spring: spring.rank):
        springs_of.setdefault(spring.link, []).append(spring)
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
        origin = link.origin @ moved[link.joint] if link.joint else link.origin
        own = springs_of.get(link.name, [])
        carriers = [own[k : k + MOST_FREEDOMS] for k in range(0, len(own), MOST_FREEDOMS)]
        names = [f"{link.name}/{k}" for k in range(len(carriers))]
        for level, name in enumerate([*names, link.name]):
            indent = "  " * (depth + level)
            place = origin if level == 0 else translation()
            lines.append(
                f'{indent}<body name={quoteattr(name)} pos="{_numbers(place.translation)}" '
                f'quat="{_numbers(quaternion(place.rotation))}">'
            )
            content = _carrier(carriers[level]) if level < len(carriers) else _content(link, of_joint)
            lines.extend(f"{indent}  {line}" for line in content)
        for child in children.get(index, []):
            add(child, depth + len(names) + 1)
        lines.extend("  " * (depth + level) + "</body>" for level in range(len(names), -1, -1))

    for index in children.get(-1, []):
        add(index, 2)
    return "\n".join([*lines, "  </worldbody>", "</mujoco>", ""])


def _content(link: Link, of_joint: dict[str, float]) -> list[str]:
    lines = [_inertial(link.mass, link.com)]
    kind = "slide" if link.slides else "hinge"
    if link.follows is not None:  # `Mechanism` lets it follow
        lines.append(f'<joint name={quoteattr(link.follows.name)} type="{kind}" axis="{_numbers(link.axis)}"/>')
    if link.joint:
        spring = f'stiffness="{float(of_joint[link.joint])!r}" springref="0"'
        lines.append(f'<joint name={quoteattr(link.joint)} type="{kind}" axis="{_numbers(link.axis)}" {spring}/>')
    return lines


def _carrier(springs: Sequence[Spring]) -> list[str]:
    """Return the content of a body without mass that the springs move."""
    return [_inertial(0.0, np.zeros(3))] + [
        f'<joint type="{"slide" if spring.slides else "hinge"}" '
        f'pos="{_numbers(spring.place)}" axis="{_numbers(spring.axis)}" '
        f'stiffness="{float(spring.stiffness)!r}" springref="0" armature="1"/>'  # no part in statics
        for spring in springs
    ]


def _inertial(mass: float, com: Float1D) -> str:
    mass = max(mass, LEAST_MASS)
    ball = 0.4 * mass * BALL_RADIUS**2
    return f'<inertial pos="{_numbers(com)}" mass="{mass!r}" diaginertia="{_numbers((ball, ball, ball))}"/>'


def _numbers(values: Sequence[float] | Float1D) -> str:
    return " ".join(repr(float(value)) for value in values)
