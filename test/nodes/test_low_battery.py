"""Agent, drivers and path followers as processes, Pioneers whose batteries run down.

Nothing stands in for a part of ours: the voltage goes from the status packets of the emulated
robots over serial lines, drivers and DDS into the agent, and the plans that follow from it back.
"""

import math
import time

import numpy as np
import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from ros_domain import own_domain
from std_msgs.msg import String

from explore_slam.geometry import Pose2
from explore_slam.live.processes import NodeProcess, NodeProcesses, one_machine_environment
from explore_slam.simulation.emulators.kinematic_body import KinematicBody
from explore_slam.simulation.emulators.vehicle_emulator import VehicleEmulator

DOMAIN = own_domain(85)
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
STARTS = {'robot1': Pose2(0.0, 0.0, 0.0), 'robot2': Pose2(0.0, 1.6, 0.0)}
FULL, LOW, CRITICAL = 12.6, 11.3, 10.8  # V
SETTINGS = {
    'vehicles': list(STARTS),
    'start_poses': [number for pose in STARTS.values() for number in pose],
    'vision': 'none',
    'particles': 50,
    'planner_frequency': 1.0,
    'battery_low': 11.5,
    'battery_critical': 11.0,
}


def corridor():
    """Return the walls of a corridor of 4 m that is closed on the left only, as discs."""
    along = np.arange(-1.5, 26.0, 0.35)
    walls = [(x, y, 0.2) for x in along.tolist() for y in (-1.4, 3.0)]
    return walls + [(-1.5, y, 0.2) for y in np.arange(-1.4, 3.0, 0.35).tolist()]


class Team:
    """Emulated vehicles, the processes of their nodes and of the agent, and ears."""

    def __init__(self, folder, context):
        self.bodies = {name: KinematicBody(pose) for name, pose in STARTS.items()}
        self.emulators = {
            name: VehicleEmulator(folder, name, body, body.scan, seed=number)
            for number, (name, body) in enumerate(self.bodies.items())
        }
        for body in self.bodies.values():
            body.obstacles = corridor()
        self.plans, self.states, self.status = {}, {}, []
        self.node = rclpy.create_node('observer', context=context)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        for name in STARTS:
            self.node.create_subscription(
                Path, f'{name}/plan', lambda plan, name=name: self.on_plan(name, plan), LATCHED
            )
        self.node.create_subscription(
            String, 'explore/status', lambda message: self.status.append(message.data), LATCHED
        )
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self.on_diagnostics, 10)
        file = folder / 'agent.yaml'
        file.write_text(yaml.safe_dump({'/**': {'ros__parameters': SETTINGS}}))
        nodes = [NodeProcess('agent', 'agent_node', ['--ros-args', '--params-file', str(file)])]
        for name in STARTS:
            own = ['--ros-args', '-r', f'__ns:=/{name}']
            ports = ['-p', f'base_port:={folder}/{name}_base']
            ports += ['-p', f'laser_port:={folder}/{name}_laser', '-p', 'enable_camera:=false']
            ports += ['-p', 'motors_at_start:=true']
            nodes.append(NodeProcess(f'{name}_driver', 'pioneer_driver', [*own, *ports]))
            nodes.append(NodeProcess(f'{name}_follower', 'path_follower', own))
        environment = one_machine_environment(folder / 'logs')
        environment['ROS_DOMAIN_ID'] = str(DOMAIN)
        self.processes = NodeProcesses(nodes, folder / 'logs', environment)
        self.log = folder / 'logs' / 'agent.log'

    def on_plan(self, name, plan):
        points = [(pose.pose.position.x, pose.pose.position.y) for pose in plan.poses]
        self.plans[name] = points

    def on_diagnostics(self, message):
        for status in message.status:
            part = status.name.rpartition(': ')[2]
            if part.startswith('vehicle '):
                values = {pair.key: pair.value for pair in status.values}
                self.states[part.removeprefix('vehicle ')] = (status.message, values)

    def wait_for(self, condition, seconds, what):
        end = time.monotonic() + seconds
        while not condition():
            self.processes.check()
            assert time.monotonic() < end, f'{what}: not after {seconds} s: {self}'
            self.executor.spin_once(timeout_sec=0.05)

    def x(self, name):
        return self.bodies[name].odometry().x

    def distance_home(self, name):
        return math.dist(self.bodies[name].odometry()[:2], STARTS[name][:2])

    def goal_x(self, name):
        """Return x (m) where the plan of a vehicle ends, -inf without one."""
        return self.plans[name][-1][0] if self.plans.get(name) else -math.inf

    def __str__(self):
        places = {name: tuple(body.odometry()) for name, body in self.bodies.items()}
        return f'{places}, {self.plans}, {self.states}, {self.status}'


@pytest.fixture
def team(tmp_path):
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    made = Team(tmp_path, context)
    for emulator in made.emulators.values():
        emulator.start()
    with made.processes:
        yield made
    for emulator in made.emulators.values():
        emulator.stop()
    made.node.destroy_node()
    rclpy.shutdown(context=context)


def test_a_low_battery_sends_a_pioneer_home_and_a_critical_one_stops_it(team):
    team.wait_for(lambda: team.x('robot1') > 2.0 and team.x('robot2') > 1.0, 150.0, 'exploring')
    team.emulators['robot1'].robot.battery = LOW
    team.wait_for(lambda: 'battery low: 11.3 V' in team.states['robot1'][0], 15.0, 'diagnostics')
    team.wait_for(lambda: -1.0 < team.goal_x('robot1') < 0.5, 15.0, 'a plan home')
    team.wait_for(lambda: team.goal_x('robot2') > 2.0, 15.0, 'the other one explores on')
    team.wait_for(lambda: team.states['robot1'][1]['state'] == 'returning', 15.0, 'its state')
    team.wait_for(lambda: team.distance_home('robot1') < 0.35, 60.0, 'at home')
    team.wait_for(lambda: team.states['robot1'][1]['state'] == 'home', 15.0, 'its state')
    assert team.states['robot1'][1]['battery'] == 'low'
    assert float(team.states['robot1'][1]['battery_V']) == pytest.approx(LOW)
    assert 'robot1: battery low: 11.3 V, battery_low is 11.5 V; it drives home' in (
        team.log.read_text()
    )
    # the other one stops in the middle of the corridor, and nobody is left to explore
    team.wait_for(lambda: team.bodies['robot2'].velocity()[0] > 0.2, 20.0, 'driving')
    team.emulators['robot2'].robot.battery = CRITICAL
    team.wait_for(lambda: team.plans['robot2'] == [], 15.0, 'no plan')
    team.wait_for(lambda: team.bodies['robot2'].velocity() == (0.0, 0.0), 3.0, 'at rest')
    team.wait_for(
        lambda: team.states['robot2'][1]['state'] == 'battery_critical', 10.0, 'its state'
    )
    assert 'battery critical: 10.8 V, battery_critical is 11.0 V' in team.states['robot2'][0]
    team.wait_for(lambda: team.status[-1] == 'exploration_incomplete', 15.0, 'the status')
    place = team.bodies['robot2'].odometry()
    # a new battery: it goes on where it is
    team.emulators['robot2'].robot.battery = FULL
    team.wait_for(lambda: team.x('robot2') > place.x + 0.5, 30.0, 'exploring again')
    assert team.status[-1] == 'exploration_in_progress'
    assert team.distance_home('robot1') < 0.5
