"""One vehicle: driver of base, laser and Kinect, path follower, feature extractor.

ros2 launch explore_slam vehicle.launch.py name:=robot1 base_port:=/dev/pioneer motors:=true

Arguments that are not given leave the parameter file and the defaults of the nodes as they are.
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
        'parameters of driver and follower; arguments that are given override them',
    ),
    'base_port': ('', "serial device of the base, or 'tcp://host' or 'tcp://host:port'"),
    'laser_port': ('', "serial device of the laser, or 'tcp://host:port'"),
    'use_laser': ('', 'false: the vehicle has no laser at all: nothing waits for scans'),
    'base': ('', 'true: drive the Pioneer base; false: another node does'),
    'laser': ('', 'true: read the SICK LMS-200; false: another node publishes scan'),
    'camera': ('', 'true: read the Kinect; false: another node publishes camera/...'),
    'motors': ('', 'true: enable the motors at the start; false: service enable_motors does'),
    'follower': ('true', 'run the path follower'),
    'features': ('false', 'extract features on the vehicle (needs vision:=vehicle of the agent)'),
    'autostart': (
        '',
        'true: configure and activate at the start; false: wait for a lifecycle manager',
    ),
    'use_sim_time': ('', 'true: use the time of /clock'),
    'scan_topic': ('', 'scans, if not scan; without slash: in the namespace of the vehicle'),
    'odom_topic': ('', 'odometry, if not odom'),
    'color_topic': ('', 'colour images, if not camera/rgb/image_raw'),
    'depth_topic': ('', 'registered depth images, if not camera/depth_registered/image_raw'),
    'camera_info_topic': ('', 'intrinsics of the camera, if not camera/rgb/camera_info'),
}


def port(_name, text):
    """Return a port as text, which YAML would otherwise read as a number."""
    return ParameterValue(text, value_type=str)


def start(context):
    given = values(ARGUMENTS, context)
    common = {
        'package': 'explore_slam',
        'namespace': read.ros_name('name', given['name']),
        'remappings': read.remappings({name: given[name] for name in read.TOPICS}),
        'output': 'screen',
    }
    time = read.given_parameters(given, {'use_sim_time': ('use_sim_time', read.boolean)})
    managed = {**time, **read.given_parameters(given, {'autostart': ('autostart', read.boolean)})}
    driver = read.given_parameters(
        given,
        {
            'base_port': ('base_port', port),
            'laser_port': ('laser_port', port),
            'base': ('enable_base', read.boolean),
            'laser': ('enable_laser', read.boolean),
            'camera': ('enable_camera', read.boolean),
            'motors': ('motors_at_start', read.boolean),
        },
    )
    sensors = read.given_parameters(given, {'use_laser': ('use_laser', read.boolean)})
    file = read.existing_file('params_file', given['params_file'])
    nodes = [('pioneer_driver', [file, {**driver, **sensors, **managed}])]
    if read.boolean('follower', given['follower']):
        nodes.append(('path_follower', [file, {**sensors, **managed}]))
    if read.boolean('features', given['features']):
        nodes.append(('feature_extractor', [file, time]))
    return [
        Node(executable=name, name=name, parameters=parameters, **common)
        for name, parameters in nodes
    ]


def generate_launch_description():
    return description(ARGUMENTS, start)
