"""Everything for a measurement in the simulated cell, faster than life if wanted.

ros2 launch calibration simulated_cell.launch.py cell:=CELL.yaml session:=DIR speed:=20.0
"""

from calibration.launch_tree import launch_description
from calibration.process_tree import SIMULATED_CELL
from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and the nodes."""
    return launch_description(SIMULATED_CELL)
