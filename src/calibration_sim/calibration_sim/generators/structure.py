"""Draws structural effects."""

from __future__ import annotations

import numpy as np

from calibration_sim.effect_models import structure
from calibration_sim.effect_models.effect import Effect, Label
from calibration_sim.generators.draw import NAMES, Draw, at_joint


def off_axis_compliance(draw: Draw) -> Effect:
    """Bearings that tilt, anisotropic."""
    j = draw.among(0, 1, 2, 3, 4, 5)
    size = draw.amplitude * (draw.size.bearing if j < 3 else draw.size.wrist_bearing)
    ratio, turn = draw.uneven(), draw.twist()
    pair = (size * np.sqrt(ratio), size / np.sqrt(ratio))
    equivalent: tuple[dict[str, object], ...] = ()
    if j == 0:
        equivalent = ({"effect": "base_compliance", "location": {"base": "base"}},)
    elif ratio == 1.0 and j >= 2:
        other = {2: 3, 3: 2, 4: 5, 5: 4}[j]
        equivalent = ({"effect": "off_axis_compliance", "location": at_joint(other)},)
    label = Label(
        "structure",
        "off_axis_compliance",
        at_joint(j),
        draw.amplitude,
        {"compliance_x": pair[0], "compliance_y": pair[1]},
        equivalent,
        same_law=turn == 0.0,
    )
    return structure.Bearing(label, j, pair, turn)


def link_bending(draw: Draw) -> Effect:
    """A beam, with unequal sides and torsion."""
    link = draw.among(*draw.size.beams)
    ratio = draw.uneven()
    size = draw.amplitude * draw.size.bending
    pair = (size * np.sqrt(ratio), size / np.sqrt(ratio))
    torsion = 0.0 if draw.plain else float(size * draw.rng.uniform(0.5, 1.5))
    parameters = {"bending_1": pair[0], "bending_2": pair[1], "torsion": torsion}
    label = Label("structure", "link_bending", {"link": f"link_{link + 1}"}, draw.amplitude, parameters)
    return structure.Beam(label, link, pair, torsion, draw.twist())


def base_compliance(draw: Draw) -> Effect:
    """A pedestal that rocks, and gives way a little sideways."""
    ratio = draw.uneven()
    size = draw.amplitude * draw.size.base_rotation
    about = (size * np.sqrt(ratio), size / np.sqrt(ratio), 0.0 if draw.plain else 0.3 * size)
    along = (0.0, 0.0, 0.0) if draw.plain else (draw.amplitude * draw.size.base_translation,) * 3
    parameters = {f"rotation_{axis}": value for axis, value in zip("xyz", about, strict=True)}
    equivalent = ({"effect": "off_axis_compliance", "location": at_joint(0)},)
    label = Label(
        "structure", "base_compliance", {"base": "base"}, draw.amplitude, parameters, equivalent, same_law=True
    )
    return structure.Base(label, about, along)


def tool_compliance(draw: Draw) -> Effect:
    """An adapter that tilts."""
    size = draw.amplitude * draw.size.tool_rotation
    ratio = draw.uneven()
    about = (size * np.sqrt(ratio), size / np.sqrt(ratio), 0.5 * size)
    along = (draw.amplitude * draw.size.tool_translation,) * 3
    parameters = {f"rotation_{axis}": value for axis, value in zip("xy", about[:2], strict=True)}
    label = Label("structure", "tool_compliance", {"tool": "tool"}, draw.amplitude, parameters, same_law=True)
    return structure.Tool(label, about, along)


def joint_coupling(draw: Draw) -> Effect:
    """Wrist gear train or parallelogram."""
    first = draw.among(1, 3, 4)
    pair = (first, first + 1)
    mean = 1.0 / np.sqrt(draw.stiffness[pair[0]] * draw.stiffness[pair[1]])
    value = draw.sign() * draw.amplitude * draw.size.coupling * float(mean)
    location = {"joints": [NAMES[pair[0]], NAMES[pair[1]]]}
    label = Label("structure", "joint_coupling", location, draw.amplitude, {"compliance": value}, same_law=True)
    return structure.Coupling(label, pair, value)


def pose_dependent_stiffness(draw: Draw) -> Effect:
    """A gear that is stiffer at some angles."""
    j = draw.among(0, 1, 2, 3, 4)
    phase = draw.rng.uniform(0.0, 2.0 * np.pi)
    size = draw.amplitude * draw.size.modulation
    a, b = size * float(np.cos(phase)), size * float(np.sin(phase))
    ripple = 0.0 if draw.plain or draw.rng.random() < 0.5 else 0.3 * size
    equivalent = ({"effect": "gravity_compensator", "location": at_joint(1)},) if j == 1 else ()
    label = Label(
        "structure",
        "pose_dependent_stiffness",
        at_joint(j),
        draw.amplitude,
        {"cosine": a, "sine": b},
        equivalent,
        same_law=ripple == 0.0,
    )
    return structure.Modulated(label, j, a, b, ripple)


def gravity_compensator(draw: Draw) -> Effect:
    """A spring of real geometry beside joint 2."""
    anchor, arm, stiffness, free = draw.size.compensator
    angle = float(draw.rng.uniform(-0.15, 0.15))
    stiffness *= draw.amplitude
    parameters = {"anchor": anchor, "arm": arm, "spring": stiffness, "angle": angle}
    label = Label("structure", "gravity_compensator", at_joint(1), draw.amplitude, parameters)
    return structure.Compensator(label, 1, anchor, arm, angle, stiffness, free)
