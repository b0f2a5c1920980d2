"""A tree of processes as a launch description; the only module that needs `launch`.

Nothing is started before every argument is known to be of use: a path that is wrong is one line, not a line of every
node.
"""

from __future__ import annotations

from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from calibration.process_tree import Argument, Given, Process, Tree, files_of, parameters_of, values_of
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
    said = {argument.name: context.launch_configurations[argument.name] for argument in tree.arguments}
    try:
        values = values_of(tree, said)
    except InputError as error:
        raise SystemError(str(error)) from None
    files = files_of(values, get_package_share_directory("calibration"))
    tools = [ExecuteProcess(cmd=[_word(word, values) for word in tool.words], output="screen") for tool in tree.tools]
    return [*tools, *(_node(process, tree, values, files) for process in tree.processes)]


def _declared(argument: Argument) -> Any:
    choices = {"choices": list(argument.choices)} if argument.choices else {}
    return DeclareLaunchArgument(
        argument.name, default_value=argument.default, description=argument.description, **choices
    )


def _node(process: Process, tree: Tree, values: dict[str, str], files: tuple[str, ...]) -> Any:
    given = parameters_of(tree, process, values)
    return Node(
        package=process.package,
        executable=process.name,
        namespace=values["namespace"],
        output="screen",
        sigterm_timeout=str(process.sigterm_after),
        sigkill_timeout=str(process.sigkill_after),
        parameters=[*files, {name: ParameterValue(value, value_type=type(value)) for name, value in given.items()}],
    )


def _word(word: str | Given, values: dict[str, str]) -> str:
    return values[word.argument] if isinstance(word, Given) else word
