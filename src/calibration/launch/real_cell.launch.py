"""Everything for a measurement in a real cell; the drivers of robot, tracker and force/torque sensor run already.

ros2 launch calibration real_cell.launch.py cell:=CELL.yaml session:=DIR params_file:=MY.yaml
"""

from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and the nodes; when one node ends, all do."""
    cell = LaunchConfiguration("cell")
    session = LaunchConfiguration("session")
    given = LaunchConfiguration("params_file")
    namespace = LaunchConfiguration("namespace")
    recording = PathJoinSubstitution([session, "bag"])
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
            DeclareLaunchArgument(
                "backend", default_value="follow_joint_trajectory", description="How the robot is moved."
            ),
            DeclareLaunchArgument(
                "adapter", default_value="industrial", description="How the controller's state is understood."
            ),
            Node(executable="recorder", parameters=[given, {"cell": cell, "out": recording}], **common),
            Node(executable="tracker", parameters=[given, {"cell": cell}], **common),
            Node(executable="force_torque", parameters=[given, {"cell": cell}], **common),
            Node(
                executable="guard",
                parameters=[given, {"cell": cell, "robot_state.adapter": LaunchConfiguration("adapter")}],
                **common,
            ),
            Node(
                executable="sequencer",
                parameters=[
                    given,
                    {"cell": cell, "motion.backend": LaunchConfiguration("backend"), "recording": recording},
                ],
                **common,
            ),
            Node(executable="identification", parameters=[given, {"cell": cell, "recording": recording}], **common),
        ]
    )
