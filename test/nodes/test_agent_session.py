"""The configured agent in this process: what its worker does first while it is behind."""

import threading
import time

import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from ros_domain import own_domain
from std_srvs.srv import Trigger
from synthetic import SyntheticVehicle, SyntheticWorld

from explore_slam.exploration import PlanningMode
from explore_slam.geometry import Pose2
from explore_slam.messages.vehicle_settings import VehicleConfig
from explore_slam.nodes.agent_inputs import OperatorPose
from explore_slam.nodes.agent_parameters import AgentNodeConfig
from explore_slam.nodes.agent_session import AgentSession
from explore_slam.nodes.managed_node import ManagedNode
from explore_slam.settings import with_values

DOMAIN = own_domain(99)
START = Pose2(-1.0, -1.5, 0.0)


def new_session(node):
    values = {'particles': 20, 'vehicles': ['robot1'], 'start_poses': [float(v) for v in START]}
    config = with_values(AgentNodeConfig(), values)
    return AgentSession(node, config, {'robot1': VehicleConfig(vision='none')})


@pytest.fixture
def session():
    context = rclpy.Context()
    context.init(domain_id=DOMAIN)
    node = rclpy.create_node('agent', context=context)
    made = new_session(node)
    yield made
    made.close()
    node.destroy_node()
    context.try_shutdown()


def run_behind(session, act, ticks=40):
    """Have measurements wait while the worker is busy, act, and wait until the worker is idle."""
    vehicle = SyntheticVehicle(SyntheticWorld(), START)
    begun, hold, done = threading.Event(), threading.Event(), threading.Event()

    def be_busy(_):
        begun.set()
        assert hold.wait(60.0)

    def add(record):
        session.agent.add('robot1', record)

    session.inbox.put('request', 'busy', be_busy, None)
    assert begun.wait(60.0)
    for _ in range(ticks):
        session.inbox.put('odometry', 'robot1', add, vehicle.advance())
        session.inbox.put('scan', 'robot1', add, vehicle.scan())
    act()
    hold.set()
    end = time.monotonic() + 120.0
    while len(session.inbox):
        assert time.monotonic() < end
        done.wait(0.02)
    session.inbox.put('request', 'end', lambda _: done.set(), None)
    assert done.wait(60.0)
    return vehicle


def test_a_pause_is_not_behind_measurements(session):
    seen = []
    session.planner.pause(False)

    def pause(_):
        seen.append(len(session.agent.track('robot1').odometry))
        session.planner.pause(True)

    def act():
        session.inbox.put('request', 'pause', pause, None)

    run_behind(session, act, ticks=5)
    assert seen == [0]
    assert session.planner.mode is PlanningMode.PAUSED
    assert len(session.agent.track('robot1').odometry) == 5
    assert session.agent.grid.known().any()


class Managed(ManagedNode):
    """A node that holds a session as the agent's node does."""

    def __init__(self, context):
        super().__init__('agent', context=context)
        self.session = None

    def configure(self):
        self.session = new_session(self)

    def activate(self):
        self.session.activate()

    def deactivate(self):
        self.session.deactivate()

    def clean_up(self):
        self.session.close()


def test_requests_that_wait_are_refused_at_the_clean_up():
    context = rclpy.Context()
    context.init(domain_id=DOMAIN)
    node, other = Managed(context), rclpy.create_node('operator', context=context)
    executor = SingleThreadedExecutor(context=context)
    for part in (node, other):
        executor.add_node(part)

    def spin_until(condition):
        end = time.monotonic() + 60.0
        while not condition():
            assert time.monotonic() < end
            executor.spin_once(timeout_sec=0.02)

    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    client = other.create_client(Trigger, 'return_home')
    spin_until(client.service_is_ready)
    hold = threading.Event()
    node.session.inbox.put('request', 'busy', lambda _: hold.wait(60.0), None)
    answers = [client.call_async(Trigger.Request()) for _ in range(3)]
    # all of them are taken while the worker is busy: none keeps the node from the others
    spin_until(lambda: node.session.inbox.waiting().get(('request', 'return_home')) == 3)
    node.session.inbox.close()
    hold.set()
    assert node.trigger_cleanup() == TransitionCallbackReturn.SUCCESS
    spin_until(lambda: all(answer.done() for answer in answers))
    for answer in answers:
        assert not answer.result().success
        assert 'cleaned up before it could answer' in answer.result().message
    spin_until(lambda: not client.service_is_ready())
    node.stop()
    for part in (node, other):
        part.destroy_node()
    context.try_shutdown()


def test_a_vehicle_is_placed_where_it_is_now_and_its_earlier_scans_are_left_out(session):
    given = OperatorPose(Pose2(2.0, 1.0, -1.0), np.diag([1e-4, 1e-4, 1e-4]))

    def act():
        session.inbox.put('pose', 'robot1', session._place, ('robot1', given))

    vehicle = run_behind(session, act)
    track = session.agent.track('robot1')
    assert track.odometry.last == vehicle.stamp
    assert tuple(session.agent.estimate('robot1')[0]) == pytest.approx(given.pose, abs=0.02)
    assert not session.agent.grid.known().any()


def test_what_was_measured_before_a_reset_is_left_out(session):
    def reset():
        session.agent.reset()
        session._omit_earlier()
        return 'reset'

    def act():
        session._ask(reset)

    run_behind(session, act)
    assert len(session.agent.track('robot1').odometry) == 0
    assert not session.agent.grid.known().any()
