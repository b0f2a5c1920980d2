"""A tree of processes as a launch description; the only module that needs `launch`.

Nothing is started before every argument is known to be of use: a path that is wrong is one line, not a line of every
node.
"""

from __future__ import annotations

import os
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix, get_package_share_directory
from launch.actions import DeclareLaunchArgument, ExecuteProcess, LogInfo, OpaqueFunction, TimerAction
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from calibration.process_tree import (
    AGAIN_AFTER,
    STARTED_BY,
    Argument,
    Given,
    Process,
    Tree,
    files_of,
    parameters_of,
    values_of,
)
from calibration_core.cell import load_cell
from calibration_core.errors import InputError
from launch import LaunchDescription


def launch_description(tree: Tree) -> LaunchDescription:
    """Return the arguments of a tree, and what starts its processes once their values are known."""
    return LaunchDescription([*map(_declared, tree.arguments), OpaqueFunction(function=started, args=[tree])])


def started(context: Any, tree: Tree) -> list[Any]:
    """Return what is started with the values that the arguments have.

    Raises:
        SystemError: A value cannot be used; launch says so in one line and ends with exit code 1.
    """
    asked = {argument.name: context.launch_configurations[argument.name] for argument in tree.arguments}
    try:
        values = values_of(tree, asked)
    except InputError as error:
        raise SystemError(str(error)) from None
    share = get_package_share_directory("calibration")
    files = files_of(values, share)
    tools = [ExecuteProcess(cmd=[_word(word, values) for word in tool.words], output="screen") for tool in tree.tools]
    nodes = [_node(process, tree, values, files) for process in tree.processes]
    return [*tools, *nodes, *_transforms(values), *_rviz(values, share)]


def _declared(argument: Argument) -> Any:
    choices = {"choices": list(argument.choices)} if argument.choices else {}
    return DeclareLaunchArgument(
        argument.name, default_value=argument.default, description=argument.description, **choices
    )


def _node(process: Process, tree: Tree, values: dict[str, str], files: tuple[str, ...]) -> Any:
    given = parameters_of(tree, process, values)

    def again(event: Any, context: Any) -> list[Any]:  # launch's own `respawn` asks for no exit code
        if context.is_shutdown or not process.again(event.returncode):
            return []
        return [TimerAction(period=AGAIN_AFTER, actions=[_node(process, tree, values, files)])]

    return Node(
        package=process.package,
        executable=process.name,
        namespace=values["namespace"],
        remappings=list(tree.remappings.items()),
        ros_arguments=["--enclave", process.enclave, "--log-level", values["log_level"]],
        output="screen",
        on_exit=again,
        additional_env={STARTED_BY: str(os.getpid())},
        sigterm_timeout=str(process.sigterm_after),
        sigkill_timeout=str(process.sigkill_after),
        parameters=[*files, {name: ParameterValue(value, value_type=type(value)) for name, value in given.items()}],
    )


def _word(word: str | Given, values: dict[str, str]) -> str:
    return values[word.argument] if isinstance(word, Given) else word


def _installed(package: str) -> bool:
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return False
    return True


def _transforms(values: dict[str, str]) -> list[Any]:
    """Return robot_state_publisher with the URDF of the cell, or why there is none."""
    if values["transforms"] != "true":
        return []
    file = load_cell(values["cell"]).urdf_path
    package = "robot_state_publisher"
    if file is None or not _installed(package):
        why = f"{package} is not installed" if file is not None else "the cell file names no URDF"
        return [LogInfo(msg=f"no transforms are published: {why}")]
    urdf = file.read_text("utf-8")
    return [
        Node(
            package=package,
            executable=package,
            namespace=values["namespace"],
            remappings=[("robot_description", "~/robot_description")],  # the topic belongs to the driver
            parameters=[{"robot_description": ParameterValue(urdf, value_type=str)}],
        )
    ]


def _rviz(values: dict[str, str], share: str) -> list[Any]:
    """Return RViz with the suite's displays, or why there is none."""
    if values["rviz"] != "true":
        return []
    if not _installed("rviz2"):
        return [LogInfo(msg="RViz is not started: rviz2 is not installed")]
    arguments = ["-d", f"{share}/config/cell.rviz"]
    return [Node(package="rviz2", executable="rviz2", namespace=values["namespace"], arguments=arguments)]
