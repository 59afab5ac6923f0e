"""One vehicle: driver of base, laser and Kinect, path follower, feature extractor.

ros2 launch explore_slam vehicle.launch.py name:=robot1 base_port:=/dev/pioneer motors:=true
"""

from pathlib import Path

from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from explore_slam.live import launch_arguments as read
from explore_slam.live.launch_description import description, values

CONFIG = Path(__file__).resolve().parents[1] / 'config'
ARGUMENTS = {
    'name': ('robot1', 'name of the vehicle: its namespace'),
    'params_file': (
        str(CONFIG / 'vehicle.yaml'),
        'parameters of driver and follower; arguments of the command line override them',
    ),
    'base_port': ('/dev/pioneer', "serial device of the base, or 'tcp://host:port'"),
    'laser_port': ('/dev/lms200', 'serial device of the laser'),
    'base': ('true', 'drive the Pioneer base; false: another node does'),
    'laser': ('true', 'read the SICK LMS-200; false: another node publishes scan'),
    'camera': ('true', 'read the Kinect; false: another node publishes camera/...'),
    'motors': ('false', 'enable the motors at the start; false: service enable_motors does'),
    'follower': ('true', 'run the path follower'),
    'features': ('false', 'extract features on the vehicle (needs vision:=vehicle of the agent)'),
    'autostart': (
        'true',
        'configure and activate at the start; false: wait for a lifecycle manager',
    ),
    'use_sim_time': ('false', 'use the time of /clock'),
    'scan_topic': ('', 'scans, if not scan; without slash: in the namespace of the vehicle'),
    'odom_topic': ('', 'odometry, if not odom'),
    'color_topic': ('', 'colour images, if not camera/rgb/image_raw'),
    'depth_topic': ('', 'registered depth images, if not camera/depth_registered/image_raw'),
    'camera_info_topic': ('', 'intrinsics of the camera, if not camera/rgb/camera_info'),
}


def start(context):
    given = values(ARGUMENTS, context)
    flags = (
        'base', 'laser', 'camera', 'motors', 'follower', 'features', 'autostart', 'use_sim_time',
    )  # fmt: skip
    on = {name: read.boolean(name, given[name]) for name in flags}
    common = {
        'package': 'explore_slam',
        'namespace': given['name'],
        'remappings': read.remappings({name: given[name] for name in read.TOPICS}),
        'output': 'screen',
    }
    time = {'use_sim_time': on['use_sim_time']}
    managed = {**time, 'autostart': on['autostart']}
    driver = {
        'base_port': ParameterValue(given['base_port'], value_type=str),
        'laser_port': ParameterValue(given['laser_port'], value_type=str),
        'use_base': on['base'],
        'use_laser': on['laser'],
        'use_camera': on['camera'],
        'motors_at_start': on['motors'],
    }
    file = read.existing_file('params_file', given['params_file'])
    nodes = [('pioneer_driver', [file, driver, managed])]
    if on['follower']:
        nodes.append(('path_follower', [file, managed]))
    if on['features']:
        nodes.append(('feature_extractor', [time]))
    return [
        Node(executable=name, name=name, parameters=parameters, **common)
        for name, parameters in nodes
    ]


def generate_launch_description():
    return description(ARGUMENTS, start)
