"""The JSON Schema of the cell file, for editors that complete and check while one types; made from the same models.

`cell.schema.json` beside this file is what `cell_schema_text` returns; a test compares them.  A cell file names it in
its first line: `# yaml-language-server: $schema=cell.schema.json`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from calibration_core.cell import Cell

SCHEMA_FILE = Path(__file__).with_name("cell.schema.json")
FIRST_LINE = "# yaml-language-server: $schema={path}"
DIALECT = "https://json-schema.org/draft/2020-12/schema"
INTERNAL = ("path", "sha256")  # set by whoever reads the file
TOPIC_NAMES = (
    r"^/(tracker/.+|joint_states|force_torque/wrench|cell/temperature|robot_description|calibration/(step|conditions))$"
)

DESCRIPTIONS = {
    "Cell.name": "Name of the cell.",
    "Cell.source": "Where the data come from.",
    "Cell.note": "Anything worth knowing.",
    "Cell.robot": "The robot as its maker states it.",
    "Cell.frames": "Frames and points; nominal, refitted wherever a recording can.",
    "Cell.instruments": "One standard deviation of one averaged reading of each instrument.",
    "Cell.topics": "Topics that differ from the usual names.",
    "Cell.measurements": "How a recording is to be read.",
    "Cell.safety": "What the controller watches over with a safety rating.",
    "Cell.surroundings": "What the robot stands on: the floor's z in the base frame, m, or none.",
    "Cell.boxes": "What the robot must not touch and the tracker cannot see through; base frame.",
    "Cell.end_effector": "Mass and stiffness of what the flange carries.",
    "Cell.certificate": "Names on the certificate: laboratory, customer, place, operator.",
    "Robot.name": "As reports call it.",
    "Robot.maker": "Who made it, for the certificate.",
    "Robot.serial": "Its serial number: a model is not accepted for another one.",
    "Surroundings.floor": "m, z of the floor in the base frame; none: there is no floor to keep clear of.",
    "Certificate.laboratory": "Name and address of the laboratory.",
    "Certificate.customer": "Name and address of the customer.",
    "Certificate.place": "Where the robot stood when it was measured.",
    "Certificate.operator": "Who measured.",
    "Robot.urdf": "URDF, relative to this file; with base_link and flange. Or state dh.",
    "Robot.base_link": "Link of the URDF that is the base frame.",
    "Robot.flange": "Link of the URDF that is the flange frame.",
    "Robot.dh": "Denavit-Hartenberg rows, one for each joint: a, d in m, alpha, theta in rad. Or state urdf.",
    "Robot.modified_dh": "true: the rows are modified (proximal, Craig) ones.",
    "Robot.joints": "Names of the joints from base to flange, as in /joint_states.",
    "Robot.joint_limits": "Lower and upper limit of each joint, rad (m where a joint slides).",
    "Robot.joint_types": "revolute or prismatic, for each joint; with dh only.",
    "Robot.joint_coupling": "Factors of other joints in a recorded angle, such as {joint_3: {joint_2: 1.0}} (FANUC).",
    "Robot.inertials": "Mass (kg) and centre of gravity (m, in the link's DH frame) of each link; with dh only.",
    "Robot.inertials_known": "false: the masses are guesses.",
    "Robot.rated_load": "Rated load, kg.",
    "Robot.stiffness": "What is believed of each joint today, N·m/rad (N/m where it slides); .inf: rigid.",
    "Robot.gravity": "Acceleration of gravity in the base frame, m/s².",
    "Frames.tracker": "Pose of the tracker frame in the base frame.",
    "Frames.force_torque": "Pose of the force/torque sensor in the flange frame.",
    "Frames.tool": "Pose of the tool frame in the flange frame.",
    "Frames.wrench_point": "Where the load pulls, in the flange frame, m.",
    "Frames.measurement_points": "Name and place of each target, in the flange frame, m.",
    "Frames.sigma_points": "Standard uncertainty of each target's place, m for each coordinate.",
    "Frames.target_normals": "Where each target opens to, in the flange frame.",
    "Tracker.sigma": "m for each coordinate; or state sigma_range and sigma_angle.",
    "Tracker.sigma_range": "m along the beam.",
    "Tracker.sigma_range_per_m": "m along the beam for each m of distance.",
    "Tracker.sigma_angle": "rad across the beam.",
    "Tracker.acceptance_angle": "rad to its normal within which a target is seen.",
    "Tracker.range": "Nearest and farthest distance, m.",
    "ForceTorque.sigma_force": "N for each axis.",
    "ForceTorque.sigma_torque": "N·m for each axis.",
    "Thermometer.sigma": "K.",
    "Measurements.points": "absolute, or displacement: differences to step 0.",
    "Measurements.wrench_axes": "Axes of the recorded wrench: the sensor's or the base's.",
    "Measurements.wrench_at": "Point of the recorded torque: the sensor's origin or the wrench point.",
    "Pose.xyz": "m.",
    "Pose.rpy": "rad, fixed axes x, y, z: R = Rz(y) Ry(p) Rx(r).",
}  # fmt: skip


def cell_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a cell file."""
    schema = Cell.model_json_schema()
    for name in INTERNAL:
        schema["properties"].pop(name)
    schema["description"] = "A robot cell: everything about it that a recording does not say. SI units throughout."
    models = {"Cell": schema, **schema["$defs"]}
    for place, text in DESCRIPTIONS.items():
        model, _, field = place.partition(".")
        models[model]["properties"][field]["description"] = text
    topics = schema["$defs"]["Topics"]
    topics["patternProperties"] = {TOPIC_NAMES: {"type": "string", "minLength": 1}}
    return {
        "$schema": DIALECT,
        "title": "Cell file of calibration",
        **{k: v for k, v in schema.items() if k != "title"},
    }


def cell_schema_text() -> str:
    """Return the content of `cell.schema.json`."""
    return json.dumps(cell_schema(), indent=1, ensure_ascii=False) + "\n"
