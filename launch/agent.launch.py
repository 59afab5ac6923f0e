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
        'vehicles': ('robot1,robot2', 'names, with commas: the namespaces of the vehicles'),
        'start_poses': ('0,0,0,0,1,0', 'x, y (m), heading (rad) of each vehicle in the map'),
        'vision': ('agent', 'agent: features from images here; vehicle: topic landmarks'),
        'run_directory': ('.', 'where save_map and save_state write'),
        'namespace': ('', 'namespace of the agent'),
        'config': (str(CONFIG), 'file of agent parameters'),
        'use_sim_time': ('false', 'take time from /clock'),
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
