"""The central agent for any number of vehicles.

ros2 launch explore_slam agent.launch.py vehicles:=robot1,robot2 start_poses:=0,0,0,0,1,0
"""

from pathlib import Path

from launch_ros.actions import Node

from explore_slam.live import launch_arguments as read
from explore_slam.live.launch_description import description, rviz, values

CONFIG = Path(__file__).resolve().parents[1] / 'config'
ARGUMENTS = {
    'vehicles': ('robot1,robot2', 'names of the vehicles, separated by commas: their namespaces'),
    'start_poses': (
        '0,0,0,0,1,0',
        'start pose of each vehicle in the map: x, y (m), heading (rad); nan,nan,nan: unknown',
    ),
    'vision': ('agent', 'where features are extracted: agent, vehicle, or none without cameras'),
    'use_laser': ('true', 'false for a team without laser scanners'),
    'seed': ('0', 'seed of all random numbers'),
    'explore': ('true', 'start exploring at once; false: wait for explore/resume'),
    'autostart': (
        'true',
        'configure and activate at the start; false: wait for a lifecycle manager',
    ),
    'run_directory': ('.', 'folder into which save_map and save_state write'),
    'namespace': ('', 'namespace of the agent'),
    'params_file': (
        str(CONFIG / 'agent.yaml'),
        'parameter file of the agent; arguments of the command line override it',
    ),
    'use_sim_time': ('false', 'use the time of /clock'),
    'rviz': ('false', 'show map, vehicles and frontiers in RViz'),
    'scan_topic': ('', 'scans of each vehicle, if not scan; without slash: in its namespace'),
    'odom_topic': ('', 'odometry of each vehicle, if not odom'),
    'color_topic': ('', 'colour images of each vehicle, if not camera/rgb/image_raw'),
    'depth_topic': ('', 'registered depth images, if not camera/depth_registered/image_raw'),
    'camera_info_topic': ('', 'intrinsics of the camera, if not camera/rgb/camera_info'),
}


def start_agent(context):
    given = values(ARGUMENTS, context)
    vehicles = read.names('vehicles', given['vehicles'])
    sim_time = {'use_sim_time': read.boolean('use_sim_time', given['use_sim_time'])}
    parameters = {
        'vehicles': vehicles,
        'start_poses': read.numbers('start_poses', given['start_poses'], 3 * len(vehicles)),
        'vision': read.choice('vision', given['vision'], ('agent', 'vehicle', 'none')),
        'use_laser': read.boolean('use_laser', given['use_laser']),
        'seed': read.whole_number('seed', given['seed'], 0),
        'explore': read.boolean('explore', given['explore']),
        'autostart': read.boolean('autostart', given['autostart']),
        'run_directory': given['run_directory'],
        **sim_time,
    }
    topics = {name: given[name] for name in read.TOPICS}
    actions = [
        Node(
            package='explore_slam',
            executable='agent',
            namespace=given['namespace'],
            parameters=[read.existing_file('params_file', given['params_file']), parameters],
            remappings=read.remappings(topics, vehicles),
            output='screen',
        )
    ]
    if read.boolean('rviz', given['rviz']):
        actions.append(rviz(CONFIG, sim_time))
    return actions


def generate_launch_description():
    return description(ARGUMENTS, start_agent)
