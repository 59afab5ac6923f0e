"""Several vehicles whose devices are connected to this computer, one namespace each.

ros2 launch explore_slam vehicles.launch.py vehicles:=robot1,robot2 ports:=/dev

Vehicle `robot1` has its base at `<ports>/robot1_base` and its laser at `<ports>/robot1_laser`:
udev names (doc/hardware.md), or the ports of the simulator's emulated hardware. A vehicle with a
computer of its own runs vehicle.launch.py there.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

PASSED_ON = {'camera': 'true', 'motors': 'false', 'features': 'false', 'use_sim_time': 'false'}


def include_vehicles(context):
    names = LaunchConfiguration('vehicles').perform(context).replace(' ', '').split(',')
    ports = LaunchConfiguration('ports').perform(context).rstrip('/')
    one = str(Path(__file__).with_name('vehicle.launch.py'))
    return [
        IncludeLaunchDescription(
            # one source per vehicle: a shared one would launch the first vehicle twice
            PythonLaunchDescriptionSource(one),
            launch_arguments={
                'name': name,
                'base_port': f'{ports}/{name}_base',
                'laser_port': f'{ports}/{name}_laser',
                **{key: LaunchConfiguration(key) for key in PASSED_ON},
            }.items(),
        )
        for name in names
        if name
    ]


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'vehicles', default_value='robot1,robot2', description='names, separated by commas'
            ),
            DeclareLaunchArgument(
                'ports', default_value='/dev', description='folder of the ports'
            ),
            *(
                DeclareLaunchArgument(name, default_value=default)
                for name, default in PASSED_ON.items()
            ),
            OpaqueFunction(function=include_vehicles),
        ]
    )
