"""Several vehicles whose devices are connected to this computer, one namespace each.

ros2 launch explore_slam vehicles.launch.py vehicles:=robot1,robot2 ports:=/dev

Vehicle `robot1` has its base at `<ports>/robot1_base` and its laser at `<ports>/robot1_laser`:
udev names (doc/hardware.md), or the ports of the simulator's emulated hardware. Others are listed
in the order of the vehicles: base_ports:=tcp://192.168.1.11,tcp://192.168.1.12
A vehicle with a computer of its own runs vehicle.launch.py there.
"""

from pathlib import Path

from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

from explore_slam.live import launch_arguments as read
from explore_slam.live.launch_description import description

CONFIG = Path(__file__).resolve().parents[1] / 'config'
ARGUMENTS = {
    'vehicles': ('robot1,robot2', 'names of the vehicles, separated by commas'),
    'ports': ('/dev', 'folder of the ports'),
    'base_ports': (
        '',
        'port of the base of each vehicle, separated by commas: serial devices, or tcp://host or '
        'tcp://host:port; empty: <ports>/<vehicle>_base',
    ),
    'laser_ports': (
        '',
        'port of the laser of each vehicle, likewise; empty: <ports>/<vehicle>_laser',
    ),
    'params_file': (
        str(CONFIG / 'vehicle.yaml'),
        'parameters of the drivers and followers; arguments that are given override them',
    ),
    'laser': ('', 'true: read the lasers; false: other nodes publish scan'),
    'use_laser': ('', 'false: the vehicles have no laser at all'),
    'camera': ('', 'true: read the Kinect of each vehicle'),
    'motors': ('', 'true: enable the motors at the start; false: service enable_motors does'),
    'features': ('false', 'extract features on the vehicles'),
    'use_sim_time': ('', 'true: use the time of /clock'),
}
PASSED_ON = ('params_file', 'laser', 'use_laser', 'camera', 'motors', 'features', 'use_sim_time')


def include_vehicles(context):
    names = read.names('vehicles', LaunchConfiguration('vehicles').perform(context))
    folder = LaunchConfiguration('ports').perform(context).rstrip('/')
    base_ports, laser_ports = (
        read.one_each(
            f'{device}_ports',
            LaunchConfiguration(f'{device}_ports').perform(context),
            names,
            [f'{folder}/{name}_{device}' for name in names],
        )
        for device in ('base', 'laser')
    )
    one = str(Path(__file__).with_name('vehicle.launch.py'))
    return [
        IncludeLaunchDescription(
            # one source per vehicle: a shared one would launch the first vehicle twice
            PythonLaunchDescriptionSource(one),
            launch_arguments={
                'name': name,
                'base_port': base_port,
                'laser_port': laser_port,
                **{key: LaunchConfiguration(key) for key in PASSED_ON},
            }.items(),
        )
        for name, base_port, laser_port in zip(names, base_ports, laser_ports, strict=True)
    ]


def generate_launch_description():
    return description(ARGUMENTS, include_vehicles)
