"""Everything for a measurement in the simulated cell, faster than life if wanted.

ros2 launch calibration simulated_cell.launch.py cell:=CELL.yaml session:=DIR speed:=20.0
"""

from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and the nodes; when one node ends, all do."""
    cell = LaunchConfiguration("cell")
    session = LaunchConfiguration("session")
    given = LaunchConfiguration("params_file")
    namespace = LaunchConfiguration("namespace")
    recording = PathJoinSubstitution([session, "bag"])
    everywhere = {"cell": cell, "use_sim_time": True}
    common = {"package": "calibration", "namespace": namespace, "output": "screen", "on_exit": Shutdown()}
    return LaunchDescription(
        [
            DeclareLaunchArgument("cell", description="The cell file."),
            DeclareLaunchArgument("session", description="Directory of the session; one that is there is continued."),
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([FindPackageShare("calibration"), "config", "ros.yaml"]),
                description="Parameters of the nodes.",
            ),
            DeclareLaunchArgument("namespace", default_value="", description="Namespace of the cell."),
            DeclareLaunchArgument("speed", default_value="1.0", description="Multiple of real time."),
            DeclareLaunchArgument("seed", default_value="1", description="Of the hidden truth and of the noise."),
            Node(
                **{**common, "package": "calibration_sim"},
                executable="simulated_cell",
                parameters=[
                    given,
                    {
                        "cell": cell,
                        "clock": True,
                        "speed": ParameterValue(LaunchConfiguration("speed"), value_type=float),
                        "seed": ParameterValue(LaunchConfiguration("seed"), value_type=int),
                    },
                ],
            ),
            Node(executable="recorder", parameters=[given, {**everywhere, "out": recording}], **common),
            Node(executable="tracker", parameters=[given, everywhere], **common),
            Node(executable="force_torque", parameters=[given, everywhere], **common),
            Node(executable="guard", parameters=[given, {**everywhere, "robot_state.adapter": "native"}], **common),
            Node(
                executable="sequencer",
                parameters=[
                    given,
                    {**everywhere, "motion.backend": "simulated", "load.by": "device", "recording": recording},
                ],
                **common,
            ),
            Node(executable="identification", parameters=[given, {"cell": cell, "recording": recording}], **common),
        ]
    )
