"""What the launch files have in common; imports ROS's launch, which PyPI does not have."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from explore_slam.live.launch_arguments import misspelt

Arguments = Mapping[str, tuple[str, str]]
Start = Callable[[LaunchContext], list[Any]]


def description(arguments: Arguments, start: Start) -> LaunchDescription:
    """Return a description that declares arguments and then carries out what `start` returns.

    arguments: default and meaning by name; those on the command line that are none of them are
    named in the log.
    """

    def name_misspelt(context: LaunchContext) -> list[LogInfo]:
        return [LogInfo(msg=text) for text in misspelt(context.argv, arguments)]

    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, (default, text) in arguments.items()
            ),
            OpaqueFunction(function=name_misspelt),
            OpaqueFunction(function=start),
        ]
    )


def values(arguments: Arguments, context: LaunchContext) -> dict[str, str]:
    """Return the value of every argument."""
    return {name: LaunchConfiguration(name).perform(context) for name in arguments}


def rviz(config: Path, sim_time: Mapping[str, bool]) -> Node:
    """Return RViz with the project's display; config: folder of configuration files."""
    return Node(
        package='rviz2',
        executable='rviz2',
        arguments=['-d', str(config / 'explore_slam.rviz')],
        parameters=[dict(sim_time)],
    )
