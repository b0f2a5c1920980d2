"""The model's compliances as hinges and slides with springs, in the order of the chain: what a simulator can hold."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from calibration_core.model.chain import Chain
from calibration_core.model.effects.applied import NODES, WEIGHTS
from calibration_core.model.effects.structure.link_bending import ACROSS
from calibration_core.model.parameters import AppliedEffect
from calibration_core.timeseries import Float1D, Float2D

BETWEEN = ("_xy", "_xz", "_yz", "_12")  # compliances between two axes may be negative


@dataclasses.dataclass(frozen=True, eq=False)
class Spring:
    """A hinge or slide with a spring.

    Attributes:
        axis: (3,) unit axis.
        place: (3,) m, a point of a hinge's axis.
        compliance: rad/(N*m), or m/N of a slide.
        slides: Whether it moves along the axis.
    """

    axis: Float1D
    place: Float1D
    compliance: float
    slides: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class LinkSprings:
    """Springs of one joint and the link that it carries, axes and places in the link's frame at joint position zero.

    Attributes:
        before: Give way before the joint moves.
        behind: Give way behind the joint, and carry the link's weight.
        beyond: Give way beyond the link's centre of gravity: they carry what follows alone.
    """

    before: tuple[Spring, ...] = ()
    behind: tuple[Spring, ...] = ()
    beyond: tuple[Spring, ...] = ()


@dataclasses.dataclass(frozen=True, eq=False)
class Springs:
    """All of them.

    Attributes:
        base: At the origin of the base frame, base axes.
        flange: At the flange, its axes.
        coupled: Pairs of joints with the compliance between them, rad/(N*m).
        held: The effects that these are.
    """

    base: tuple[Spring, ...]
    links: tuple[LinkSprings, ...]
    flange: tuple[Spring, ...]
    coupled: tuple[tuple[int, int, float], ...]
    held: tuple[AppliedEffect, ...]


def springs_of(chain: Chain, effects: Sequence[AppliedEffect]) -> Springs:
    """Return the effects that are springs; a compliance that is not positive cannot be built, and is left out."""
    base: tuple[Spring, ...] = ()
    flange: tuple[Spring, ...] = ()
    links = [LinkSprings() for _ in chain.joints]
    coupled: list[tuple[int, int, float]] = []
    held = []
    for effect in effects:
        if any(value < 0 for name, value in effect.parameters.items() if not name.endswith(BETWEEN)):
            continue
        if effect.effect == "base_compliance":
            base += _crossed(effect.parameters, np.eye(3), np.zeros(3), "rotation")
        elif effect.effect == "tool_compliance":
            flange += _at_flange(effect)
        elif effect.effect == "off_axis_compliance":
            joint = chain.joints.index(str(effect.location["joint"]))
            links[joint] = _off_axis(links[joint], chain, joint, effect)
        elif effect.effect == "link_bending":
            joint = int(str(effect.location["link"]).removeprefix("link_")) - 1
            links[joint] = _bent(links[joint], chain, joint, effect)
        elif effect.effect == "joint_coupling":
            first, second = (chain.joints.index(name) for name in effect.location["joints"])
            coupled.append((first, second, effect.parameters["compliance"]))
        else:
            continue
        held.append(effect)
    return Springs(base, tuple(links), flange, tuple(coupled), tuple(held))


def hinges(axes: tuple[Float1D, ...], matrix: Float2D, place: Float1D) -> tuple[Spring, ...]:
    """Return an elastic hinge about k axes, (k, k) compliances: springs about its principal axes."""
    sizes, turns = np.linalg.eigh(matrix)
    return tuple(
        Spring(turn @ np.array(axes), place, float(size)) for size, turn in zip(sizes, turns.T, strict=True) if size > 0
    )


def _crossed(given: Mapping[str, float], axes: Float2D, place: Float1D, name: str) -> tuple[Spring, ...]:
    """Return springs `name`_x, _y, _xy and _z about axes (columns), and `translation_*` along them."""
    x, y, xy = (given.get(f"{name}_{key}", 0.0) for key in ("x", "y", "xy"))
    found = hinges((axes[:, 0], axes[:, 1]), np.array([[x, xy], [xy, y]]), place)
    if given.get(f"{name}_z", 0.0) > 0:
        found += (Spring(axes[:, 2], place, given[f"{name}_z"]),)
    slides = [(k, given.get(f"translation_{key}", 0.0)) for k, key in enumerate("xyz")]
    return found + tuple(Spring(axes[:, k], place, size, slides=True) for k, size in slides if size > 0)


def _at_flange(effect: AppliedEffect) -> tuple[Spring, ...]:
    values = dict(effect.parameters)
    if "rotation_xz" in values:
        x, y, z, xy, xz, yz = (values[f"rotation_{key}"] for key in ("x", "y", "z", "xy", "xz", "yz"))
        matrix = np.array([[x, xy, xz], [xy, y, yz], [xz, yz, z]])
        return hinges((np.eye(3)[0], np.eye(3)[1], np.eye(3)[2]), matrix, np.zeros(3))
    if effect.variant == "tilt":
        values = {"rotation_x": values["rotation_xy"], "rotation_y": values["rotation_xy"]}
    return _crossed(values, np.eye(3), np.zeros(3), "rotation")


def _off_axis(own: LinkSprings, chain: Chain, joint: int, effect: AppliedEffect) -> LinkSprings:
    values = dict(effect.parameters)
    if "compliance" in values:
        values = {"compliance_x": values["compliance"], "compliance_y": values["compliance"]}
    if effect.variant == "behind":
        found = _crossed(values, np.eye(3), np.zeros(3), "compliance")
        return dataclasses.replace(own, behind=own.behind + found)
    c, s = np.cos(chain.offset[joint]), np.sin(chain.offset[joint])
    axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # the frame before the joint, its offset taken off
    return dataclasses.replace(own, before=own.before + _crossed(values, axes, np.zeros(3), "compliance"))


def _bent(own: LinkSprings, chain: Chain, joint: int, effect: AppliedEffect) -> LinkSprings:
    """Return a beam as hinges at the Gauss points on either side of the link's centre of gravity.

    Three points on each side integrate the beam's energy exactly: what crosses a section is linear along the link.
    """
    tip = chain.flange_translation if joint == chain.n - 1 else chain.translation[joint + 1]
    length = float(np.linalg.norm(tip))
    along = tip / length
    inner = np.abs(along)
    across = np.cross(along, np.eye(3)[int(np.flatnonzero(inner < inner.min() + ACROSS)[0])])
    across = across / np.linalg.norm(across)
    values = effect.parameters
    if "bending" in values:
        matrix = np.eye(2) * values["bending"]
    else:
        mixed = values.get("bending_12", 0.0)
        matrix = np.array([[values["bending_1"], mixed], [mixed, values["bending_2"]]])
    centre = 0.0
    if chain.com is not None:
        centre = float(np.clip(chain.com[joint] @ tip / length**2, 0.0, 1.0))
    parts: list[tuple[Spring, ...]] = []
    for begin, end in ((0.0, centre), (centre, 1.0)):
        found: tuple[Spring, ...] = ()
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            share = weight / 2 * (end - begin) * length
            if share <= 0:
                continue
            place = (begin + (node + 1) / 2 * (end - begin)) * tip
            found += hinges((across, np.cross(along, across)), share * matrix, place)
            if values.get("torsion", 0.0) > 0:
                found += (Spring(along, place, share * values["torsion"]),)
        parts.append(found)
    return dataclasses.replace(own, behind=own.behind + parts[0], beyond=own.beyond + parts[1])
