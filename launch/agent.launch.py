"""The central agent for any number of vehicles.

ros2 launch explore_slam agent.launch.py vehicles:=robot1,robot2 start_poses:=0,0,0,0,1,0

Arguments that are not given leave the parameter file and the defaults of the node as they are.
"""

from functools import partial
from pathlib import Path

from launch_ros.actions import Node

from explore_slam.live import launch_arguments as read
from explore_slam.live.launch_description import description, rviz, values
from explore_slam.nodes.agent_parameters import AgentNodeConfig

CONFIG = Path(__file__).resolve().parents[1] / 'config'
ARGUMENTS = {
    'vehicles': (
        '',
        'names of the vehicles, separated by commas: their namespaces; robot1,robot2 if neither '
        'this nor params_file names them',
    ),
    'start_poses': (
        '',
        'start pose of each vehicle in the map: x, y (m), heading (rad); nan,nan,nan: unknown',
    ),
    'vision': ('', 'where features are extracted: agent, vehicle, or none without cameras'),
    'use_laser': ('', 'false for a team without laser scanners'),
    'seed': ('', 'seed of all random numbers'),
    'explore': ('', 'true: start exploring at once; false: wait for explore/resume'),
    'autostart': (
        '',
        'true: configure and activate at the start; false: wait for a lifecycle manager',
    ),
    'run_directory': ('', 'folder into which save_map and save_state write'),
    'namespace': ('', 'namespace of the agent'),
    'params_file': (
        str(CONFIG / 'agent.yaml'),
        'parameter file of the agent; arguments that are given override it',
    ),
    'use_sim_time': ('', 'true: use the time of /clock'),
    'rviz': ('false', 'show map, vehicles and frontiers in RViz'),
    'scan_topic': ('', 'scans of each vehicle, if not scan; without slash: in its namespace'),
    'odom_topic': ('', 'odometry of each vehicle, if not odom'),
    'color_topic': ('', 'colour images of each vehicle, if not camera/rgb/image_raw'),
    'depth_topic': ('', 'registered depth images, if not camera/depth_registered/image_raw'),
    'camera_info_topic': ('', 'intrinsics of the camera, if not camera/rgb/camera_info'),
}


def start_agent(context):
    given = values(ARGUMENTS, context)
    file = read.existing_file('params_file', given['params_file'])
    parameters = read.given_parameters(
        given,
        {
            'vehicles': ('vehicles', read.names),
            'vision': ('vision', partial(read.choice, choices=('agent', 'vehicle', 'none'))),
            'use_laser': ('use_laser', read.boolean),
            'seed': ('seed', partial(read.whole_number, low=0)),
            'explore': ('explore', read.boolean),
            'autostart': ('autostart', read.boolean),
            'run_directory': ('run_directory', read.text),
            'use_sim_time': ('use_sim_time', read.boolean),
        },
    )
    vehicles = read.in_effect(parameters, file, 'vehicles', AgentNodeConfig().vehicles)
    if given['start_poses']:
        poses = read.numbers('start_poses', given['start_poses'], 3 * len(vehicles))
        parameters['start_poses'] = poses
    topics = {name: given[name] for name in read.TOPICS}
    actions = [
        Node(
            package='explore_slam',
            executable='agent',
            namespace=given['namespace'] and read.ros_name('namespace', given['namespace']),
            parameters=[file, parameters],
            remappings=read.remappings(topics, vehicles),
            output='screen',
        )
    ]
    if read.boolean('rviz', given['rviz']):
        sim_time = read.in_effect(parameters, file, 'use_sim_time', False)
        actions.append(rviz(CONFIG, {'use_sim_time': sim_time}))
    return actions


def generate_launch_description():
    return description(ARGUMENTS, start_agent)
