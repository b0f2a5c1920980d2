"""A recorded bag, played for whoever listens, and the identification that evaluates it on request.

ros2 launch calibration replay.launch.py cell:=CELL.yaml recording:=BAG rate:=1.0
"""

from calibration.launch_tree import launch_description
from calibration.process_tree import REPLAY
from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments, the player and the node; the node stays when the bag has ended."""
    return launch_description(REPLAY)
