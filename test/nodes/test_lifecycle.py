"""Managed nodes in processes of their own, driven through the services of the life cycle."""

import subprocess

import numpy as np
import pytest
import rclpy
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nodes.test_agent_node import Team, log_of, start_agent
from nodes.test_path_follower import Harness, follower_process
from nodes.test_pioneer_driver import Rig
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.lifecycle import TransitionCallbackReturn
from ros_domain import own_domain
from std_srvs.srv import Trigger

from explore_slam.nodes.managed_node import ManagedNode

DOMAIN = own_domain(67)
CONFIGURE, CLEAN_UP, ACTIVATE, DEACTIVATE = (
    Transition.TRANSITION_CONFIGURE,
    Transition.TRANSITION_CLEANUP,
    Transition.TRANSITION_ACTIVATE,
    Transition.TRANSITION_DEACTIVATE,
)
UNCONFIGURED, INACTIVE, ACTIVE = (
    State.PRIMARY_STATE_UNCONFIGURED,
    State.PRIMARY_STATE_INACTIVE,
    State.PRIMARY_STATE_ACTIVE,
)


class Manager:
    """Clients of the services of one managed node; spin(seconds, until) of a test's harness."""

    def __init__(self, node, name, spin):
        self._spin = spin
        self._get_state = node.create_client(GetState, f'{name}/get_state')
        self._change_state = node.create_client(ChangeState, f'{name}/change_state')
        self._set_parameters = node.create_client(SetParameters, f'{name}/set_parameters')

    def _call(self, client, request, attempts=1):
        assert client.wait_for_service(timeout_sec=30.0), client.srv_name
        for _ in range(attempts):
            future = client.call_async(request)
            # kernels may have to be compiled
            if self._spin(240.0 / attempts, future.done):
                return future.result()
        raise AssertionError(f'{client.srv_name}: no answer')

    def change(self, transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        return self._call(self._change_state, request).success

    def state(self):
        # the first call of every test, and repeated: the answer to a client that the service's
        # side of DDS has not discovered yet is lost
        return self._call(self._get_state, GetState.Request(), attempts=12).current_state.id

    def set_parameter(self, name, text):
        value = ParameterValue(type=4, string_value=text)
        request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
        return self._call(self._set_parameters, request).results[0]


@pytest.fixture
def context():
    made = rclpy.Context()
    made.init(domain_id=DOMAIN)
    yield made
    made.try_shutdown()


class Unfinished(ManagedNode):
    """A node whose configuration or activation has an error in its program."""

    def __init__(self, context, place):
        self.place, self.done = place, []
        super().__init__('unfinished', context=context)
        self.start(True)

    def _do(self, what):
        self.done.append(what)
        if what == self.place:
            raise ZeroDivisionError(f'in {what}')

    def configure(self):
        self._do('configure')

    def activate(self):
        self._do('activate')

    def deactivate(self):
        self._do('deactivate')

    def clean_up(self):
        self._do('clean_up')


@pytest.mark.parametrize('place', ['configure', 'activate'])
def test_an_unexpected_error_at_the_start_is_the_one_that_is_raised(context, place):
    with pytest.raises(ZeroDivisionError, match=f'in {place}'):
        Unfinished(context, place)


def test_an_unexpected_error_of_a_transition_leaves_a_node_that_can_be_configured(context):
    made = Unfinished(context, '')
    made.place = 'deactivate'
    assert made.trigger_deactivate() == TransitionCallbackReturn.ERROR
    assert made.done[-2:] == ['deactivate', 'clean_up']
    made.place = ''
    assert made.trigger_configure() == TransitionCallbackReturn.SUCCESS
    made.stop()
    made.destroy_node()


@pytest.fixture
def rig(tmp_path, context):
    made = Rig(tmp_path, context, DOMAIN)
    yield made
    made.end()


def test_a_driver_opens_publishes_drives_stops_and_closes(rig):
    rig.start(stderr=subprocess.PIPE, autostart=False, base_port='/dev/no_such_robot')
    driver = Manager(rig.node, 'pioneer_driver', rig.spin)
    assert driver.state() == UNCONFIGURED
    assert not driver.change(CONFIGURE)
    assert driver.state() == UNCONFIGURED
    assert driver.set_parameter('base_port', str(rig.folder / 'robot7_base')).successful
    assert driver.change(CONFIGURE)
    assert driver.state() == INACTIVE
    assert rig.emulator.robot.session_open
    refused = driver.set_parameter('base_port', '/dev/other')
    assert not refused.successful
    assert 'while the node is unconfigured' in refused.reason
    rig.command = (0.4, 0.0)
    rig.spin(1.0)
    assert not rig.got['odom']
    assert not rig.got['scan']
    assert driver.change(ACTIVATE)
    rig.drive(0.4)
    assert driver.change(DEACTIVATE)
    assert rig.spin(3.0, lambda: rig.body.velocity() == (0.0, 0.0))
    assert rig.emulator.robot.commanded == (0.0, 0.0)
    counts = [len(rig.got[name]) for name in ('odom', 'scan')]
    rig.spin(1.0)  # velocities are still commanded
    assert [len(rig.got[name]) for name in ('odom', 'scan')] == counts
    assert rig.body.velocity() == (0.0, 0.0)
    assert rig.emulator.robot.session_open
    assert driver.change(CLEAN_UP)
    assert not rig.emulator.robot.session_open
    assert driver.change(CONFIGURE)
    assert driver.change(ACTIVATE)
    assert driver.state() == ACTIVE
    assert rig.spin(10.0, lambda: len(rig.got['odom']) > counts[0] + 5)
    rig.driver.terminate()
    _, errors = rig.driver.communicate(timeout=10.0)
    failures = [line for line in errors.splitlines() if 'ERROR' in line]
    assert len(failures) == 1, errors
    assert 'cannot configure: base: ' in failures[0]
    assert 'no such port' in failures[0]


def test_a_follower_that_is_inactive_leaves_the_wheels_alone(context):
    harness = Harness(context)
    process = follower_process(DOMAIN, '-p', 'autostart:=false')
    try:
        manager = Manager(harness.node, 'path_follower', harness.spin)
        assert manager.state() == UNCONFIGURED
        assert harness.node.count_publishers('cmd_vel') == 0
        assert not manager.change(ACTIVATE)
        assert manager.change(CONFIGURE)
        harness.send_plan([[0, 0], [30.0, 0]])
        harness.spin(1.0)
        assert harness.commands == []
        assert harness.states == []
        assert manager.change(ACTIVATE)  # finds the plan that was sent before
        assert harness.spin(20.0, lambda: harness.velocity[0] > 0.3)
        assert manager.change(DEACTIVATE)
        assert harness.spin(2.0, lambda: harness.velocity == (0.0, 0.0))
        assert harness.spin(2.0, lambda: harness.state() == 'waiting: path follower is inactive')
        count = len(harness.commands)
        harness.send_plan([[harness.pose.x, harness.pose.y], [40.0, 0]])
        harness.spin(1.5)
        assert len(harness.commands) == count
        assert harness.state() == 'waiting: path follower is inactive'
        assert manager.change(CLEAN_UP)
        assert harness.spin(5.0, lambda: harness.node.count_publishers('cmd_vel') == 0)
        assert manager.change(CONFIGURE)
        assert manager.change(ACTIVATE)
        assert harness.spin(20.0, lambda: harness.velocity[0] > 0.3)
    finally:
        process.kill()
        process.communicate()
        harness.node.destroy_node()


def test_an_agent_that_is_inactive_keeps_its_state(tmp_path):
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    team = Team(context)

    def spin(seconds, until):
        team.wait_for(until, seconds)
        return True

    with start_agent(tmp_path, {'autostart': False}, DOMAIN) as processes:
        agent = Manager(team.node, 'agent', spin)
        assert agent.state() == UNCONFIGURED
        assert agent.change(CONFIGURE)
        team.spin(1.0)
        assert team.heard == {}
        assert agent.change(ACTIVATE)
        team.wait_for(lambda: all(out.get_subscription_count() for out in team.out.values()))
        team.drive_until(team.has_heard_results)
        assert team.call(Trigger, 'return_home', Trigger.Request()).success
        team.drive_until(lambda: len(team.heard['robot1/plan'].poses) > 1)
        assert agent.change(DEACTIVATE)
        team.wait_for(lambda: team.statuses[-1] == 'exploration_paused')
        team.wait_for(lambda: team.heard['robot1/plan'].poses == [])
        known = np.asarray(team.heard['map'].data) >= 0
        team.spin(0.3)
        team.heard.clear()
        team.drive(50)  # nobody listens
        assert team.heard == {}
        assert all(not out.get_subscription_count() for out in team.out.values())
        assert agent.change(ACTIVATE)
        team.wait_for(lambda: {'map', 'map_landmarks'} <= set(team.heard))
        assert team.heard['map_landmarks'].width >= 50
        assert np.count_nonzero(np.asarray(team.heard['map'].data) >= 0) >= 0.9 * known.sum()
        assert agent.change(DEACTIVATE)
        assert agent.change(CLEAN_UP)
        assert agent.state() == UNCONFIGURED
        processes.check()
    team.node.destroy_node()
    rclpy.shutdown(context=context)
    assert 'Traceback' not in log_of(tmp_path)
