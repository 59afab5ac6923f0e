"""Velocity commands over DDS: bases that take Twist, TwistStamped, or change their mind."""

import math
import threading
import time

import pytest
import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from ros_domain import own_domain
from std_msgs.msg import String

from explore_slam.messages import seconds, stamped_twist_message, twist_message
from explore_slam.messages.topics import VehicleTopic
from explore_slam.nodes import velocity_topic
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.nodes.velocity_topic import VelocityInput, VelocityOutput

DOMAIN = own_domain(63)


class Participants:
    """Nodes in contexts of their own, as in processes of their own."""

    def __init__(self):
        self._contexts, self._executors = [], []

    def node(self, name, **options):
        context = rclpy.Context()
        context.init(domain_id=DOMAIN)
        node = rclpy.create_node(name, namespace='/robot1', context=context, **options)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        self._contexts.append((context, node))
        self._executors.append(executor)
        return node

    def base(self, name, kind):
        """Return a node that takes one type, and the list of the commands that it hears."""
        node, heard = self.node(name), []
        node.create_subscription(kind, 'cmd_vel', heard.append, 1)
        return node, heard

    def wait_for(self, condition, each=lambda: None, timeout=15.0):
        end = time.monotonic() + timeout
        while not condition() and time.monotonic() < end:
            each()
            for executor in self._executors:
                executor.spin_once(timeout_sec=0.005)
        assert condition()

    def close(self):
        for context, node in self._contexts:
            node.destroy_node()
            context.try_shutdown()


@pytest.fixture
def participants():
    made = Participants()
    yield made
    made.close()


def test_commands_follow_the_type_that_the_subscribers_take(participants):
    node = participants.node('follower')
    output = VelocityOutput(node, 'auto', 'robot1/base_link')
    assert output.types == ['Twist']  # nobody there yet

    def drive():
        output.send(0.3, -0.2)

    base, heard = participants.base('late_base', TwistStamped)
    participants.wait_for(lambda: heard, drive)
    assert output.types == ['TwistStamped']
    message = heard[-1]
    assert (message.twist.linear.x, message.twist.angular.z) == (0.3, -0.2)
    assert message.header.frame_id == 'robot1/base_link'
    now = node.get_clock().now().nanoseconds * 1e-9
    assert seconds(message.header.stamp) == pytest.approx(now, abs=15.0)
    # a second base of the other type: both are served
    plain, heard_plain = participants.base('plain_base', Twist)
    heard.clear()
    participants.wait_for(lambda: heard and heard_plain, drive)
    assert output.types == ['Twist', 'TwistStamped']
    assert heard_plain[-1].linear.x == 0.3
    # the first one goes: only the type of the other one is left, also when that goes too
    base.destroy_node()
    participants.wait_for(lambda: output.types == ['Twist'], drive)
    plain.destroy_node()
    participants.wait_for(lambda: node.count_subscribers('cmd_vel') == 0, drive)
    assert output.types == ['Twist']
    _, heard_again = participants.base('plain_base', Twist)
    participants.wait_for(lambda: heard_again, drive)
    # a type that is set is sent whoever listens
    output.configure('stamped')
    assert output.types == ['TwistStamped']
    output.configure('auto')
    assert output.types == ['Twist']
    output.close()


def test_stamps_follow_simulated_time(participants):
    node = participants.node(
        'follower', parameter_overrides=[Parameter('use_sim_time', value=True)]
    )
    output = VelocityOutput(node, 'stamped', 'base_link')
    _, heard = participants.base('base', TwistStamped)
    node.get_clock().set_ros_time_override(rclpy.time.Time(seconds=1234.5))
    participants.wait_for(lambda: heard, lambda: output.send(0.1, 0.0))
    assert seconds(heard[-1].header.stamp) == 1234.5


def test_a_mismatch_and_a_base_that_is_absent_are_one_line_each(participants, monkeypatch, capfd):
    monkeypatch.setattr(velocity_topic, '_PATIENCE', 0.3)
    monkeypatch.setattr(velocity_topic, 'SILENCE', 0.3)
    node, base, logger = map(participants.node, ('follower', 'base', 'logger'))
    output = VelocityOutput(node, 'twist', 'base_link')
    logged = []

    def warnings(part):
        logged.extend(capfd.readouterr().err.splitlines())
        return [line for line in logged if 'WARN' in line and part in line]

    def drive():
        output.send(0.3, 0.0)

    participants.wait_for(lambda: warnings('nobody subscribes to /robot1/cmd_vel'), drive)
    base.create_subscription(TwistStamped, 'cmd_vel', logged.append, 1)
    participants.wait_for(lambda: warnings('/robot1/base (TwistStamped)'), drive)
    logger.create_subscription(String, 'cmd_vel', logged.append, 1)
    participants.wait_for(lambda: warnings('/robot1/logger (String)'), drive)
    end = time.monotonic() + 1.0
    participants.wait_for(lambda: time.monotonic() > end, drive)
    assert len(warnings('nobody subscribes')) == 1
    assert len(warnings('sent as Twist, which none of its subscribers takes')) == 2  # two sets
    assert 'set cmd_vel_type to auto' in warnings('sent as Twist')[0]
    assert output.types == ['Twist']


def test_commands_of_either_type_are_taken(participants):
    node, got = participants.node('driver'), []
    threads = threading.active_count()
    inputs = VelocityInput(node, {'': lambda linear, angular: got.append((linear, angular))})
    plain = participants.node('plain').create_publisher(Twist, 'cmd_vel', 1)
    participants.wait_for(
        lambda: (0.5, 0.1) in got, lambda: plain.publish(twist_message(MESSAGES, 0.5, 0.1))
    )
    assert threading.active_count() <= threads + 1  # no second participant before it is needed
    stamped = participants.node('stamped').create_publisher(TwistStamped, 'cmd_vel', 1)
    message = stamped_twist_message(MESSAGES, 3.0, 'base_link', 0.7, math.nan)
    participants.wait_for(
        lambda: any(linear == 0.7 for linear, _ in got), lambda: stamped.publish(message)
    )
    assert math.isnan(next(angular for linear, angular in got if linear == 0.7))
    inputs.close()
    got.clear()
    end = time.monotonic() + 0.5
    participants.wait_for(lambda: time.monotonic() > end, lambda: stamped.publish(message))
    assert got == []


def test_commands_by_hand_of_either_type_are_taken(participants):
    node, got = participants.node('driver'), []
    inputs = VelocityInput(
        node,
        {'': lambda linear, angular: got.append((linear, angular))},
        VehicleTopic.TELEOP_COMMAND,
    )
    keys = participants.node('keys').create_publisher(Twist, 'cmd_vel_teleop', 1)
    stick = participants.node('stick').create_publisher(TwistStamped, 'cmd_vel_teleop', 1)
    message = stamped_twist_message(MESSAGES, 3.0, 'base_link', 0.7, 0.2)

    def both():
        keys.publish(twist_message(MESSAGES, 0.5, 0.1))
        stick.publish(message)

    participants.wait_for(lambda: {(0.5, 0.1), (0.7, 0.2)} <= set(got), both)
    inputs.close()
