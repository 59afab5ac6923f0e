"""Several vehicles whose devices are at this computer (or reached by TCP), one namespace each.

ros2 launch explore_slam vehicles.launch.py vehicles:=robot1,robot2 ports:=/dev

Vehicle `robot1` has its base at `<ports>/robot1_base`, its laser at `<ports>/robot1_laser`: names
that udev gives (doc/hardware.md), or those of the simulator's emulated hardware. Vehicles with a
computer of their own each run vehicle.launch.py there.
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
            # a source of its own for each: one that is shared launches the first vehicle twice
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
                'vehicles', default_value='robot1,robot2', description='names, with commas'
            ),
            DeclareLaunchArgument('ports', default_value='/dev', description='folder of ports'),
            *(
                DeclareLaunchArgument(name, default_value=default)
                for name, default in PASSED_ON.items()
            ),
            OpaqueFunction(function=include_vehicles),
        ]
    )
