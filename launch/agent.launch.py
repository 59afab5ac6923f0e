"""The central agent for any number of vehicles.

ros2 launch explore_slam agent.launch.py vehicles:=robot1,robot2 start_poses:=0,0,0,0,1,0
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

CONFIG = Path(__file__).resolve().parents[1] / 'config' / 'agent.yaml'


def start_agent(context):
    def value(name):
        return LaunchConfiguration(name).perform(context)

    parameters = {
        'vehicles': value('vehicles').replace(' ', '').split(','),
        'start_poses': [float(number) for number in value('start_poses').split(',')],
        'vision': value('vision'),
        'run_directory': value('run_directory'),
        'use_sim_time': value('use_sim_time') == 'true',
    }
    return [
        Node(
            package='explore_slam',
            executable='agent',
            namespace=value('namespace'),
            parameters=[value('config'), parameters],
            output='screen',
        )
    ]


def generate_launch_description():
    defaults = {
        'vehicles': (
            'robot1,robot2',
            'names of the vehicles, separated by commas: their namespaces',
        ),
        'start_poses': (
            '0,0,0,0,1,0',
            'start pose of each vehicle in the map: x, y (m), heading (rad); nan,nan,nan: unknown',
        ),
        'vision': ('agent', 'where features are extracted: agent or vehicle'),
        'run_directory': ('.', 'folder into which save_map and save_state write'),
        'namespace': ('', 'namespace of the agent'),
        'config': (str(CONFIG), 'parameter file of the agent'),
        'use_sim_time': ('false', 'use the time of /clock'),
    }
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, (default, text) in defaults.items()
            ),
            OpaqueFunction(function=start_agent),
        ]
    )
