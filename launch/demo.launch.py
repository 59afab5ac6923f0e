"""Simulator, path followers and agent, to be watched in RViz.

ros2 launch explore_slam demo.launch.py world:=office rviz:=true

`explore_slam demo` does the same without ros2 launch and writes a run folder.
"""

from functools import partial
from pathlib import Path

from launch.actions import SetEnvironmentVariable
from launch_ros.actions import Node

from explore_slam.environment import profile_variable
from explore_slam.live import launch_arguments as read
from explore_slam.live.launch_description import description, rviz, values

CONFIG = Path(__file__).resolve().parents[1] / 'config'
ARGUMENTS = {
    'world': ('office', 'name of a world of the package, or a world file'),
    'vehicles': ('2', 'number of vehicles'),
    'seed': ('', 'seed of the agent and of the simulated noise, if not that of params_file'),
    'params_file': (str(CONFIG / 'agent.yaml'), 'parameter file of the agent'),
    'rviz': ('false', 'show map, vehicles and frontiers in RViz'),
}


def start(context):
    given = values(ARGUMENTS, context)
    world = read.world_file(given['world'], CONFIG / 'worlds')
    starts = read.start_poses_of(world, given['vehicles'])
    file = read.existing_file('params_file', given['params_file'])
    seed = read.given_parameters(given, {'seed': ('seed', partial(read.whole_number, low=0))})
    seed = {'seed': read.in_effect(seed, file, 'seed', 0)}
    team = {'vehicles': list(starts), **seed}
    poses = [number for pose in starts.values() for number in pose]
    simulated = {'use_sim_time': True}
    parameters = [file, {**team, 'start_poses': poses, **simulated}]
    actions = [
        # without a large segment of shared memory images are lost
        SetEnvironmentVariable(profile_variable(), str(CONFIG / 'fastdds_one_machine.xml')),
        Node(
            package='explore_slam',
            executable='simulator',
            parameters=[{'world': str(world), 'spawn_poses': poses, **team}],
            additional_env={'MUJOCO_GL': 'egl'},
        ),
        Node(package='explore_slam', executable='agent', parameters=parameters, output='screen'),
    ]
    actions += [
        Node(
            package='explore_slam',
            executable='path_follower',
            namespace=name,
            parameters=[simulated],
        )
        for name in starts
    ]
    if read.boolean('rviz', given['rviz']):
        actions.append(rviz(CONFIG, simulated))
    return actions


def generate_launch_description():
    return description(ARGUMENTS, start)
