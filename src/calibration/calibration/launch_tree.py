"""A tree of processes as a launch description; the only module that needs `launch`."""

from __future__ import annotations

from typing import Any

from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from calibration.process_tree import PARAMETERS_FILE, Argument, Given, Process, Tool, Tree, Value
from launch import LaunchDescription


def launch_description(tree: Tree) -> LaunchDescription:
    """Return the arguments and the processes of a tree."""
    types = {argument.name: argument.type for argument in tree.arguments}
    return LaunchDescription(
        [
            *map(_declared, tree.arguments),
            *map(_tool, tree.tools),
            *(_node(process, types) for process in tree.processes),
        ]
    )


def _declared(argument: Argument) -> Any:
    default: Any = argument.default
    if argument.shared:
        default = PathJoinSubstitution([FindPackageShare("calibration"), *str(argument.default).split("/")])
    choices = {"choices": list(argument.choices)} if argument.choices else {}
    return DeclareLaunchArgument(argument.name, default_value=default, description=argument.description, **choices)


def _node(process: Process, types: dict[str, type]) -> Any:
    parameters = {name: _value(value, types) for name, value in process.parameters.items()}
    return Node(
        package=process.package,
        executable=process.name,
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        sigterm_timeout=str(process.sigterm_after),
        sigkill_timeout=str(process.sigkill_after),
        parameters=[LaunchConfiguration(PARAMETERS_FILE.name), parameters],
    )


def _tool(tool: Tool) -> Any:
    words = [_text(word) if isinstance(word, Given) else word for word in tool.words]
    return ExecuteProcess(cmd=words, output="screen")


def _value(value: Value, types: dict[str, type]) -> Any:
    return ParameterValue(_text(value), value_type=types[value.argument]) if isinstance(value, Given) else value


def _text(given: Given) -> Any:
    said = LaunchConfiguration(given.argument)
    return PathJoinSubstitution([said, given.inside]) if given.inside else said
