"""The reference of the cell file, made from the schema that reads it."""

from __future__ import annotations

from typing import Any

from calibration_core.cell import Cell

HEAD = """# The cell file

The cell file (YAML) describes what a recording does not say. Values are in SI units: m, rad, kg, N, N·m; temperatures
in °C. [config/cells/demo.cell.yaml](../../../config/cells/demo.cell.yaml) is a complete example. Unknown keys, wrong
lengths, numbers that are not finite and missing files are errors; each names line, field, what was found and what was
expected. What a robot may be beyond a plain arm of revolute joints stands in [the robot in the cell file](robot.md).

Poses are `{xyz: [x, y, z], rpy: [roll, pitch, yaw]}` about fixed axes: R = Rz(yaw) Ry(pitch) Rx(roll).
"""
INTERNAL = {"path", "sha256"}
MEANING = {
    "robot.urdf": "URDF, relative to the cell file; either this with `base_link` and `flange`, or `dh`.",
    "robot.dh": "Denavit-Hartenberg rows, one per joint, standard (distal) unless `modified_dh`.",
    "robot.modified_dh": "Rows are modified (proximal, Craig) ones.",
    "robot.joints": "Names of the joints, in the order of q, as in `/joint_states`; three or more.",
    "robot.joint_limits": "Lower and upper limit per joint, rad (m where it slides); needed with `dh`.",
    "robot.joint_types": "`revolute` or `prismatic` per joint; a URDF brings its own.",
    "robot.inertials": "Mass (kg) and centre of gravity (m, in the link's DH frame) per link; a URDF brings its own.",
    "robot.inertials_known": "`false`: masses are guesses, and sizes of effects that the weight drives are relative.",
    "robot.rated_load": "kg.",
    "robot.stiffness": "Stiffness that is believed today, N·m/rad (N/m where a joint slides); `.inf`: rigid.",
    "robot.gravity": "m/s², base axes.",
    "frames.tracker": "Pose of the tracker frame in the base frame.",
    "frames.force_torque": "Pose of the sensor frame in the flange frame.",
    "frames.wrench_point": "Where loads are applied, flange frame, m.",
    "frames.measurement_points": "Name of each target and its position, flange frame, m.",
    "frames.target_normals": "Direction in which a target opens, flange frame.",
    "instruments.tracker": "Standard uncertainty of one averaged reading: `sigma`, or range and angle.",
    "instruments.force_torque": "Standard uncertainty of one averaged reading, per axis.",
    "instruments.temperature": "Standard uncertainty of one reading.",
    "topics": "Names of topics, where they differ from the [usual ones](recordings.md).",
    "measurements.points": "`absolute`: positions; `displacement`: differences to step 0.",
    "measurements.wrench_axes": "Axes in which the wrench is recorded.",
    "measurements.wrench_at": "Point to which the recorded torque refers.",
    "safety": "What the controller watches with a safety rating, as the cell's owner declares it.",
    "surroundings": "What the robot stands on: motions are planned above it.",
    "boxes": "What stands in the cell: motions are planned around it.",
    "end_effector": "Mass and stiffness of what the flange carries.",
    "source": "Where the data come from; free text.",
    "note": "Anything worth knowing; free text.",
}


def page() -> str:
    """Return the page, Markdown."""
    schema = Cell.model_json_schema()
    lines = [HEAD, "| field | value | default | meaning |", "|---|---|---|---|"]
    lines += [_row(*row) for row in rows(schema, schema, "")]
    return "\n".join(lines) + "\n"


def rows(schema: dict[str, Any], root: dict[str, Any], prefix: str) -> list[tuple[str, dict[str, Any], bool]]:
    """Return every field below a schema: dotted name, its schema, whether it is required."""
    found = []
    for name, entry in schema.get("properties", {}).items():
        if not prefix and name in INTERNAL:
            continue
        key = f"{prefix}{name}"
        inner = _resolved(entry, root)
        found.append((key, {**inner, **entry}, name in schema.get("required", ())))
        if "properties" in inner and key not in {"frames.tracker", "frames.force_torque", "frames.tool"}:
            found += rows(inner, root, f"{key}.")
        items = _resolved(inner.get("items", {}), root) if isinstance(inner.get("items"), dict) else {}
        if "properties" in items:
            found += rows(items, root, f"{key}[].")
    return found


def _resolved(entry: dict[str, Any], root: dict[str, Any]) -> dict[str, Any]:
    """Return the schema behind references and behind `or nothing`."""
    for choice in entry.get("anyOf", ()):
        if choice.get("type") != "null":
            return _resolved(choice, root)
    reference = entry.get("$ref")
    return root["$defs"][reference.rpartition("/")[2]] if reference else entry


def _row(name: str, entry: dict[str, Any], required: bool) -> str:
    default = "**required**" if required else _shown(entry.get("default"))
    meaning = MEANING.get(name) or entry.get("description", "")
    meaning = " ".join(meaning.split("\n\n")[0].split()).replace("|", "\\|")
    return f"| `{name}` | {_kind(entry)} | {default} | {meaning} |"


def _shown(value: object) -> str:
    return "–" if value is None or value in ("", [], {}) else f"`{value}`"


def _kind(entry: dict[str, Any]) -> str:
    if "enum" in entry:
        return ", ".join(f"`{one}`" for one in entry["enum"])
    kind = entry.get("type", "object" if "properties" in entry else "")
    bounds = [f"{sign} {entry[key]:g}" for key, sign in (("minimum", "≥"), ("exclusiveMinimum", ">"),
              ("maximum", "≤"), ("exclusiveMaximum", "<")) if key in entry]  # fmt: skip
    word = {"string": "text", "array": "list", "boolean": "yes or no", "object": "mapping"}.get(kind, kind)
    return " ".join([word, *bounds]) if bounds else word
