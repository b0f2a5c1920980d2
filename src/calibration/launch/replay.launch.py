"""A recorded bag, played for whoever listens, and the identification that evaluates it on request.

ros2 launch calibration replay.launch.py cell:=CELL.yaml recording:=BAG rate:=1.0
"""

from launch.actions import DeclareLaunchArgument, ExecuteProcess, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments, the player and the node; the node stays when the bag has ended."""
    given = LaunchConfiguration("params_file")
    recording = LaunchConfiguration("recording")
    play = ["ros2", "bag", "play", recording, "--clock", "--rate", LaunchConfiguration("rate")]
    return LaunchDescription(
        [
            DeclareLaunchArgument("cell", description="The cell file."),
            DeclareLaunchArgument("recording", description="The bag."),
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([FindPackageShare("calibration"), "config", "ros.yaml"]),
                description="Parameters of the nodes.",
            ),
            DeclareLaunchArgument("namespace", default_value="", description="Namespace of the cell."),
            DeclareLaunchArgument("rate", default_value="1.0", description="Multiple of real time."),
            ExecuteProcess(cmd=play, output="screen"),
            Node(
                package="calibration",
                executable="identification",
                namespace=LaunchConfiguration("namespace"),
                output="screen",
                on_exit=Shutdown(),
                parameters=[given, {"cell": LaunchConfiguration("cell"), "recording": recording}],
            ),
        ]
    )
