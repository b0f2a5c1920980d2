"""Effects in the words of the people who read a report: `link bending at link_2` is "link 2 bends"."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

ALL = "every joint"
SENTENCES = {
    "off_axis_compliance": "{place} tilts about an axis that is not its own",
    "link_bending": "{place} bends",
    "base_compliance": "the base gives way",
    "tool_compliance": "the tool gives way",
    "joint_coupling": "{place} are coupled elastically",
    "pose_dependent_stiffness": "the stiffness of {place} depends on the posture",
    "gravity_compensator": "the gravity compensator of {place} acts",
    "nonlinear_stiffness": "{place} gives way not in proportion to its load",
    "soft_zone": "{place} is softer at small torques",
    "backlash": "{place} has backlash",
    "hysteresis": "{place} shows hysteresis",
    "creep": "{place} creeps under load",
    "wrench_gain": "the force/torque sensor reads too much or too little",
    "wrench_crosstalk": "the axes of the force/torque sensor influence each other",
    "wrench_drift": "the force/torque sensor drifts",
    "wrench_frame_misalignment": "the force/torque sensor is turned against the cell file",
    "wrench_point_offset": "the load pulls at another point than stated",
    "tool_weight": "the weight of the tool is not what the model takes it for",
    "cable_force": "a cable or dress pack pulls",
    "tracker_frame_misalignment": "the tracker stands turned against the cell file",
    "tracker_scale": "the tracker's scale is off",
    "tracker_drift": "the tracker drifts",
    "measurement_point_offset": "target {place} is at another place than stated",
    "clock_offset": "the clocks of tracker and robot differ",
    "joint_zero_offset": "the zero of {place} is off",
    "geometry_error": "the geometry at {place} is off",
    "transmission_error": "the gear of {place} runs unevenly",
    "wrist_coupling": "the joints of the wrist are coupled",
    "joint_elasticity": "{place} sags under the robot's own weight",
    "thermal_growth": "the robot grows with its temperature",
    "approach_direction": "the position of {place} depends on the direction of approach",
    "empirical_law": "{place} follows a law that fits, without a known cause",
}


def effect_sentence(effect: str, location: Mapping[str, str | Sequence[str]]) -> str:
    """Return an effect and its place as a sentence without full stop, for example `link 2 bends`.

    Args:
        effect: Its name in result.json.
        location: Its place there.
    """
    within = location.get("recording")
    location = {key: value for key, value in location.items() if key != "recording"}
    places = [one for value in location.values() for one in ([value] if isinstance(value, str) else value)]
    named = [ALL if place == "all" else plain_name(place) for place in places]
    place = " and ".join(named) or "the robot"
    sentence = SENTENCES.get(effect)
    if sentence is None:
        return f"{effect.replace('_', ' ')} at {place}"
    return sentence.format(place=place) + ("" if within is None else f" in recording {within}")


def listed_location(location: Mapping[str, str | Sequence[str]]) -> str:
    """Return a place as result.json names it, several joints or links of one joined: `joint_2 and joint_3`."""
    return ", ".join(value if isinstance(value, str) else " and ".join(value) for value in location.values())


def plain_name(name: str) -> str:
    """Return a name of joints or links as one says it: `joint_2` is joint 2; others stay as they are."""
    words, _, number = name.rpartition("_")
    return f"{words.replace('_', ' ')} {number}" if number.isdigit() and words in {"joint", "link", "axis"} else name


def people_unit(unit: str) -> str:
    """Return a unit as people write it: `N*m/rad` is N·m/rad."""
    return unit.replace("*", "·")
