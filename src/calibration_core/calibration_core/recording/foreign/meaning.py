"""What a column holds, from its name: the names that tracker software and robot controllers use."""

from __future__ import annotations

import re
from collections.abc import Sequence
from types import MappingProxyType

from calibration_core.recording.foreign.units import Dimension

AXES = ("x", "y", "z")
FORCES = ("fx", "fy", "fz")
TORQUES = ("tx", "ty", "tz")
COUNTS = ("configuration", "step", "number")
NAMES = ("point", "name", "group")
TURNS = (
    ("roll", "pitch", "yaw"),
    ("qx", "qy", "qz", "qw"),
)  # how a tool is turned
JOINT = re.compile(r"q[1-9]\d?")
ANGLE = re.compile(r"(?:angle|winkel|theta|th|rot|euler)_?\d")  # of an orientation, or of a joint
EXTERNAL = re.compile(r"(?:e|ext|ext_ax|extax|external|external_axis|eax)_?[1-9a-f]")
DIMENSIONS: MappingProxyType[str, Dimension] = MappingProxyType(
    {
        **dict.fromkeys(AXES, "length"),
        **dict.fromkeys(FORCES, "force"),
        **dict.fromkeys(TORQUES, "torque"),
        **dict.fromkeys(TURNS[0], "angle"),
        "time": "time",
        "temperature": "temperature",
    }
)
_ROS = re.compile(
    r"(?:^|[./])(?:header|velocity|effort|name|covariance|seq|frame_id|format)(?:[./\d\[]|$)|nsecs?$|nanosec$"
)
_ROS_VECTOR = re.compile(r"(?:^|[./])(point|position|translation|force|torque)[./]([xyz])$")
_ROS_JOINT = re.compile(r"(?:^|[./])position[./]?\[?(\d+)\]?$|[./]([^./]+)[./]position$")
DATES = frozenset({"date", "datum", "collection_date", "measurement_date"})  # the time, where no column is called so
IGNORED = "ignored"  # a column whose name says that it is no measured value

_UNUSED = re.compile(
    r"(.*_)?(nom|nominal|soll|ref|theo|theoretical|cad|dev|deviation|delta|diff|error|err|tol|lower|upper|sigma|std|stdev|"
    r"rms|cov|uncert|uncertainty|u95|weight|quality|status|valid|type|color|colour|comment|samples|count)(_.*)?"
    r"|d[xyz]|d3d|s[xyz]|[ijk]|n[xyz]|dist|distance|hz|vt|azimuth|elevation|range|date|collection|operator"
)
_PREFIX = r"(?:(?:pos|position|point|pt|meas|measured|measurement|actual|act|ist|coord|coordinate|tracker|tcp)_)*"
_SUFFIX = r"(?:_(?:pos|position|meas|measured|measurement|actual|act|ist|coord|coordinate|value|wert|tracker))*"
_AXIS = re.compile(_PREFIX + r"([xyz])" + _SUFFIX)
_TURN = re.compile(_PREFIX + r"(?:orientation_)?(roll|pitch|yaw|q[xyzw])")
_FORCE = re.compile(r"(?:wrench_)?(?:f|force|kraft)_?([xyz])|([xyz])_(?:force|kraft)")
_TORQUE = re.compile(r"(?:wrench_)?(?:t|m|torque|moment|drehmoment)_?([xyz])|([xyz])_(?:torque|moment)")
_JOINT = re.compile(
    r"(?:robot_|joint_state_|position_)?"
    r"(?:q|j|a|e?_?axis|achse|joint|joint_a|joint_q|theta|th|ax|angle|winkel|gelenk|actual_q|jnt)_?(\d{1,2})"
    r"(?:_(?:pos|position|act|actual|ist|angle|value))?"
)
_WORDS = MappingProxyType(
    {
        "configuration": "configuration configuration_no configuration_number config conf cfg konfiguration pose "
        "pose_no pose_id pose_number pose_index posture stellung roboterpose",
        "step": "step step_no schritt load_step loadstep load_level laststufe load_case loadcase load",
        "number": "no nr num number id index seq shot row line zeile nummer lfd_nr",
        "point": "point point_name pointname point_id pointid pt point_no target target_name reflector smr punkt "
        "punktname punkt_id messpunkt measurement_point nest",
        "name": "name label feature feature_name item object observation bezeichnung element",
        "group": "group group_name gruppe point_group",
        "time": "time timestamp time_stamp stamp zeit zeitstempel datetime date_time date_and_time datum_zeit "
        "datum_uhrzeit datum_und_uhrzeit t uhrzeit",
        "temperature": "temperature temp temperatur ambient ambient_temperature air_temperature temperature_air t_air "
        "t_amb lufttemperatur",
    }
)
_BY_WORD = MappingProxyType({word: meaning for meaning, words in _WORDS.items() for word in words.split()})
UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
YASKAWA_JOINTS = ("s", "l", "u", "r", "b", "t")


def normal(name: str) -> str:
    """Return a column's name in lower case, its words joined by underscores: `Point Name` and `PointName` alike."""
    name = "no" if name.strip() == "#" else re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name.strip())
    for accent, plain in (("ä", "ae"), ("ö", "oe"), ("ü", "ue"), ("ß", "ss"), ("θ", "theta"), ("ϑ", "theta")):
        name = name.replace(accent, plain)
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def meanings(names: Sequence[str]) -> list[str | None]:
    """Return what each column holds: `x`, `q1`, `fx`, `configuration`, ..., `ignored`, or None for an unknown name.

    Joints may be counted from 0; a set of columns with the names of a maker's joints is taken as a whole.
    """
    plain = [normal(_without_topic(name)) for name in names]
    found = [IGNORED if _of_no_use(name, names) else _meaning(one) for name, one in zip(names, plain, strict=True)]
    for joints in (tuple(f"{name}_joint" for name in UR_JOINTS), UR_JOINTS, YASKAWA_JOINTS):
        if set(joints) <= set(plain):
            for i, name in enumerate(joints):
                found[plain.index(name)] = f"q{i + 1}"
    if {"qx", "qy", "qz"} <= set(plain):
        found = [None if name == "q0" else meaning for name, meaning in zip(plain, found, strict=True)]
    for columns in of_one_family(names, found):
        if any(found[i] == "q0" for i in columns):
            for i in columns:
                found[i] = f"q{int(str(found[i])[1:]) + 1}"
    return found


def of_one_family(names: Sequence[str], found: Sequence[str | None]) -> list[list[int]]:
    """Return the columns that are joints, those together whose names differ by their numbers alone."""
    families: dict[str, list[int]] = {}
    for i, (name, meaning) in enumerate(zip(names, found, strict=True)):
        if meaning is not None and re.fullmatch(r"q\d+", meaning):
            families.setdefault(re.sub(r"\d+", "#", name), []).append(i)
    return list(families.values())


def _without_topic(name: str) -> str:
    """Return what a column of an exported topic holds: `joint_1` of `/arm/joint_states/joint_1/position`."""
    vector = _ROS_VECTOR.search(name)
    if vector is not None:
        kind = {"force": "f", "torque": "t"}.get(vector.group(1), "")
        return kind + vector.group(2)
    joint = _ROS_JOINT.search(name)
    if joint is not None:
        return f"joint_{joint.group(1)}" if joint.group(1) else joint.group(2)
    return "time" if name.endswith(("header.stamp", "header/stamp")) or name == "__time" else name


def _of_no_use(name: str, names: Sequence[str]) -> bool:
    """Say whether a column of an exported topic is none of its readings, or the time of reception beside a stamp."""
    if name.endswith(("header.stamp", "header/stamp")):
        return False
    if "." not in name and "/" not in name and name not in {"time", "__time"}:
        return False
    stamped = any(one.endswith(("header.stamp", "header/stamp")) for one in names)
    return _ROS.search(name) is not None or (stamped and "time" in name)


def dimension_of(meaning: str) -> Dimension:
    """Return what a meaning is measured in; joints are angles, names and counts are numbers."""
    return "angle" if JOINT.fullmatch(meaning) else DIMENSIONS.get(meaning, "number")


def _meaning(name: str) -> str | None:
    if name in _BY_WORD:
        return _BY_WORD[name]
    for pattern, prefix in ((_FORCE, "f"), (_TORQUE, "t"), (_AXIS, ""), (_TURN, "")):
        match = pattern.fullmatch(name)
        if match is not None:
            return prefix + next(group for group in match.groups() if group)
    joint = _JOINT.fullmatch(name)
    if joint is not None:
        return f"q{int(joint.group(1))}"
    return IGNORED if _UNUSED.fullmatch(name) else None
