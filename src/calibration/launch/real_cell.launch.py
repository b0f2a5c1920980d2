"""Everything for a measurement in a real cell; the drivers of robot, tracker and force/torque sensor run already.

ros2 launch calibration real_cell.launch.py cell:=CELL.yaml session:=DIR params_file:=MY.yaml
"""

from calibration.launch_tree import launch_description
from calibration.process_tree import REAL_CELL
from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and the nodes."""
    return launch_description(REAL_CELL)
