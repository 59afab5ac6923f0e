"""Simulator, path followers and agent, to be watched in RViz.

ros2 launch explore_slam demo.launch.py world:=office

`explore_slam demo` does the same without ros2 launch and writes a run folder.
"""

from pathlib import Path

import yaml
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

CONFIG = Path(__file__).resolve().parents[1] / 'config'


def start(context):
    def value(name):
        return LaunchConfiguration(name).perform(context)

    path = Path(value('world'))
    if not path.suffix:
        path = CONFIG / 'worlds' / f'{path}.yaml'
    starts = yaml.safe_load(path.read_text(encoding='utf-8'))['starts']
    names = list(starts)[: int(value('vehicles'))]
    team = {
        'vehicles': names,
        'start_poses': [float(number) for name in names for number in starts[name]],
    }
    simulated = {'use_sim_time': True}
    follow = [
        Node(
            package='explore_slam',
            executable='path_follower',
            namespace=name,
            parameters=[simulated],
        )
        for name in names
    ]
    return [
        Node(
            package='explore_slam',
            executable='simulator',
            parameters=[{'world': str(path), **team}],
            additional_env={'MUJOCO_GL': 'egl'},
        ),
        Node(
            package='explore_slam',
            executable='agent',
            parameters=[str(CONFIG / 'agent.yaml'), {**team, **simulated}],
            output='screen',
        ),
        *follow,
    ]


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'world', default_value='office', description='name or file of a world'
            ),
            DeclareLaunchArgument('vehicles', default_value='2', description='number of vehicles'),
            OpaqueFunction(function=start),
        ]
    )
