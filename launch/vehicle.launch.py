"""One vehicle: driver of base, laser and Kinect, path follower, feature extractor.

ros2 launch explore_slam vehicle.launch.py name:=robot1 base_port:=/dev/pioneer motors:=true
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = {
    'name': ('robot1', 'name of the vehicle: its namespace'),
    'params_file': (
        PathJoinSubstitution([FindPackageShare('explore_slam'), 'config', 'vehicle.yaml']),
        'parameters of driver and follower',
    ),
    'base_port': ('/dev/pioneer', "serial device of the base, or 'tcp://host:port'"),
    'laser_port': ('/dev/lms200', 'serial device of the laser'),
    'base': ('true', 'drive the Pioneer base; false: another node does'),
    'laser': ('true', 'read the SICK LMS-200; false: another node publishes scan'),
    'camera': ('true', 'read the Kinect; false: another node publishes camera/...'),
    'motors': ('false', 'enable the motors at the start; false: service enable_motors does'),
    'follower': ('true', 'run the path follower'),
    'features': ('false', 'extract features on the vehicle (needs vision:=vehicle of the agent)'),
    'use_sim_time': ('false', 'use the time of /clock'),
}


def generate_launch_description():
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}

    def flag(name):
        return ParameterValue(given[name], value_type=bool)

    common = {'package': 'explore_slam', 'namespace': given['name'], 'output': 'screen'}
    time = {'use_sim_time': flag('use_sim_time')}
    driver = {
        'base_port': ParameterValue(given['base_port'], value_type=str),
        'laser_port': ParameterValue(given['laser_port'], value_type=str),
        'use_base': flag('base'),
        'use_laser': flag('laser'),
        'use_camera': flag('camera'),
        'motors_at_start': flag('motors'),
    }
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, (default, text) in ARGUMENTS.items()
            ),
            Node(
                executable='pioneer_driver',
                name='pioneer_driver',
                parameters=[given['params_file'], driver, time],
                **common,
            ),
            Node(
                executable='path_follower',
                name='path_follower',
                parameters=[given['params_file'], time],
                condition=IfCondition(given['follower']),
                **common,
            ),
            Node(
                executable='feature_extractor',
                name='feature_extractor',
                parameters=[time],
                condition=IfCondition(given['features']),
                **common,
            ),
        ]
    )
