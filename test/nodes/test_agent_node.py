"""The agent's node in a process of its own, synthetic vehicles on real topics around it."""

import math
import subprocess
import sys
import time

import numpy as np
import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import (
    Point32,
    PolygonStamped,
    PoseArray,
    PoseStamped,
    PoseWithCovarianceStamped,
)
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from nav_msgs.srv import GetMap
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, qos_profile_sensor_data
from ros_domain import own_domain
from sensor_msgs.msg import CameraInfo, Image, LaserScan, PointCloud2
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool, Trigger
from synthetic import ROOM, SyntheticVehicle, SyntheticWorld
from visualization_msgs.msg import MarkerArray

from explore_slam import messages
from explore_slam.data import Intrinsics
from explore_slam.geometry import Pose2
from explore_slam.live.processes import NodeProcess, NodeProcesses, one_machine_environment
from explore_slam.mapping import load_map
from explore_slam.mounts import LaserMountConfig
from explore_slam.nodes.ros_types import MESSAGES

DOMAIN = own_domain(93)
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
STARTS = {'robot1': Pose2(-1.0, -1.5, 0.0), 'robot2': Pose2(1.0, 1.5, math.pi)}
NEWEST = {
    'map': (OccupancyGrid, LATCHED),
    'map_landmarks': (PointCloud2, LATCHED),
    'explore/status': (String, LATCHED),
    'explore/frontiers': (MarkerArray, 10),
    'robot1/pose': (PoseWithCovarianceStamped, 10),
    'robot2/pose': (PoseWithCovarianceStamped, 10),
    'robot1/plan': (Path, LATCHED),
    'robot1/trajectory': (Path, 10),
    'robot1/particles': (PoseArray, qos_profile_sensor_data),
}


class Team:
    """Synthetic vehicles that publish, and ears for what the agent says."""

    def __init__(self, context):
        self.node = rclpy.create_node('team', context=context)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        self.heard, self.statuses, self.parts = {}, [], {}
        for topic, (kind, qos) in NEWEST.items():
            self.node.create_subscription(kind, topic, self.listener(topic), qos)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self.on_diagnostics, 10)
        world = SyntheticWorld()
        self.vehicles = {
            name: SyntheticVehicle(world, pose, seed=number)
            for number, (name, pose) in enumerate(STARTS.items())
        }
        kinds = {
            'odom': Odometry, 'scan': LaserScan, 'landmarks': PointCloud2,
            'camera/rgb/image_raw': Image, 'camera/depth_registered/image_raw': Image,
            'camera/rgb/camera_info': CameraInfo,
        }  # fmt: skip
        self.out = {
            (name, topic): self.node.create_publisher(kind, f'{name}/{topic}', 10)
            for name in STARTS
            for topic, kind in kinds.items()
        }
        self.resume = self.node.create_publisher(Bool, 'explore/resume', 10)  # as ros2 topic pub
        self.epoch = time.time()

    def listener(self, topic):
        def on_message(message):
            self.heard[topic] = message
            if topic == 'explore/status':
                self.statuses.append(message.data)

        return on_message

    def on_diagnostics(self, message):
        for status in message.status:
            self.parts[status.name] = {pair.key: pair.value for pair in status.values}

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.01)

    def wait_for(self, condition, seconds=30.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f'nothing after {seconds} s: {condition}'
            self.executor.spin_once(timeout_sec=0.05)

    def drive(self, ticks):
        for tick in range(ticks):
            for name, vehicle in self.vehicles.items():
                reading = vehicle.advance()
                stamp = self.epoch + reading.stamp
                moved = type(reading)(stamp, reading.pose)
                odom = messages.odometry_message(
                    MESSAGES, moved, f'{name}/odom', f'{name}/base_link'
                )
                self.out[name, 'odom'].publish(odom)
                if tick % 5 == 0:
                    seen = vehicle.world.landmarks_from(stamp, vehicle.pose)
                    cloud = messages.landmarks_message(MESSAGES, seen, f'{name}/base_link')
                    self.out[name, 'landmarks'].publish(cloud)
                if tick % 3 == 0:
                    laser = vehicle.pose.compose(LaserMountConfig().pose)
                    scan = vehicle.world.scan_from(stamp, laser)
                    message = messages.scan_message(MESSAGES, scan, f'{name}/laser')
                    self.out[name, 'scan'].publish(message)
            self.spin(0.02)

    def drive_until(self, condition, seconds=30.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f'nothing after {seconds} s: {condition}'
            self.drive(5)

    def is_heard_to_the_end(self, name):
        """Whether the pose of a vehicle has been published up to its newest odometry."""
        message = self.heard.get(f'{name}/pose')
        newest = self.epoch + self.vehicles[name].stamp
        return message is not None and messages.seconds(message.header.stamp) > newest - 1e-3

    def has_heard_results(self):
        """Whether map, landmarks and trajectories hold most of what the vehicles have observed."""
        if not {'map', 'map_landmarks', 'robot1/trajectory'} <= set(self.heard):
            return False
        known = np.count_nonzero(np.asarray(self.heard['map'].data) >= 0)
        path = self.heard['robot1/trajectory'].poses
        return known > 5000 and self.heard['map_landmarks'].width >= 50 and len(path) > 20

    def call(self, kind, name, request):
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(timeout_sec=20.0), name
        future = client.call_async(request)
        self.executor.spin_until_future_complete(future, timeout_sec=30.0)
        assert future.done(), name
        return future.result()

    def set_parameter(self, name, **value):
        types = {'bool_value': 1, 'integer_value': 2, 'double_value': 3, 'string_value': 4}
        (kind,) = value
        parameter = Parameter(name=name, value=ParameterValue(type=types[kind], **value))
        request = SetParameters.Request(parameters=[parameter])
        return self.call(SetParameters, 'agent/set_parameters', request).results[0]


def start_agent(folder, settings=None, domain=DOMAIN):
    values = {
        'vehicles': list(STARTS),
        'start_poses': [float(v) for pose in STARTS.values() for v in pose],
        'particles': 100,
        'run_directory': str(folder),
        'planner_frequency': 2.0,
        'map_period': 0.5,
        'landmarks_period': 0.5,
        **(settings or {}),
    }
    file = folder / 'agent.yaml'
    file.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
    environment = {**one_machine_environment(), 'ROS_DOMAIN_ID': str(domain)}
    node = NodeProcess('agent', 'agent_node', ['--ros-args', '--params-file', str(file)])
    return NodeProcesses([node], folder / 'logs', environment)


@pytest.fixture(scope='module')
def live(tmp_path_factory):
    """An agent that has heard two vehicles drive through a closed room for a while."""
    folder = tmp_path_factory.mktemp('agent')
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    team = Team(context)
    with start_agent(folder) as processes:
        team.wait_for(lambda: 'explore/status' in team.heard, 90.0)
        team.wait_for(lambda: all(out.get_subscription_count() for out in team.out.values()))
        team.drive(150)
        team.wait_for(lambda: all(team.is_heard_to_the_end(name) for name in team.vehicles))
        team.wait_for(team.has_heard_results)
        yield team, folder, processes
    team.node.destroy_node()
    rclpy.shutdown(context=context)


def log_of(folder):
    return (folder / 'logs' / 'agent.log').read_text()


def test_poses_come_and_are_right(live):
    team, _, processes = live
    processes.check()
    for name, vehicle in team.vehicles.items():
        message = team.heard[f'{name}/pose']
        assert message.header.frame_id == 'map'
        pose = messages.planar_pose(message.pose.pose)
        alone = STARTS[name].compose(vehicle.odometry)
        assert vehicle.error_of(pose) < 0.06 < vehicle.error_of(alone)
        assert messages.seconds(message.header.stamp) == pytest.approx(
            team.epoch + vehicle.stamp, abs=1e-3
        )


def test_map_landmarks_particles_and_trajectory_come(live):
    team, _, _ = live
    cells, resolution, origin = messages.grid_arrays(team.heard['map'])
    walls = (np.argwhere(cells > 65)[:, ::-1] + 0.5) * resolution + origin
    assert len(walls) > 200
    assert np.median(np.abs(np.abs(walls).max(axis=1) - ROOM)) < 0.06
    columns = messages.cloud_columns(team.heard['map_landmarks'])
    assert len(columns['x']) >= 50
    assert columns['count'].max() > 3
    assert 0 < len(team.heard['robot1/particles'].poses) <= 100
    stamps = [
        messages.seconds(pose.header.stamp) for pose in team.heard['robot1/trajectory'].poses
    ]
    assert len(stamps) > 20
    assert (np.diff(stamps) >= 0.0).all()


def test_a_closed_room_is_explored(live):
    team, _, _ = live
    team.wait_for(lambda: 'exploration_complete' in team.statuses)
    assert team.statuses[0] in ('exploration_started', 'exploration_in_progress')
    assert team.heard['explore/frontiers'].markers[0].ns == 'frontiers'


def test_diagnostics_tell_rates_and_drops(live):
    team, _, _ = live
    team.wait_for(lambda: int(team.parts.get('agent: agent', {}).get('odometry_count', 0)) >= 270)
    values = team.parts['agent: vehicle robot1']
    assert float(values['effective_particles']) > 10.0
    assert 0.8 < float(values['odometry_turn_scale']) < 1.2
    assert float(values['odometry_turn_scale_deviation']) > 0.0
    assert values['shares_landmarks_with'] in ('none', 'robot2')
    assert values['dropped_frames'] == '0'
    assert int(values['associated']) > 5


def test_save_map_answers_with_the_path_and_map_server_reads_it(live):
    team, folder, _ = live
    answer = team.call(Trigger, 'save_map', Trigger.Request())
    assert answer.success
    assert str(folder / 'map.yaml') in answer.message
    assert load_map(folder / 'map.yaml').known().sum() > 5000
    served = team.call(GetMap, 'get_map', GetMap.Request()).map
    assert served.info.width * served.info.height == len(served.data) > 5000


def test_malformed_messages_are_named_and_nothing_is_lost(live):
    team, folder, processes = live
    name, stamp = 'robot1', team.epoch + 100.0
    camera = Intrinsics(64, 48, 60.0, 60.0, 32.0, 24.0)
    rgb, depth = np.zeros((48, 64, 3), np.uint8), np.zeros((24, 32), np.uint16)
    send = messages.image_message
    info = messages.camera_info_message(MESSAGES, stamp, f'{name}/camera', camera)
    scan = team.vehicles[name].world.scan_from(stamp, Pose2(0, 0, 0))
    foreign = messages.scan_message(MESSAGES, scan, 'robot2/laser')
    empty = LaserScan(range_max=8.0, angle_increment=0.1)
    held = len(messages.cloud_columns(team.heard['map_landmarks'])['x'])
    cloud = messages.cloud_message(MESSAGES, stamp, name, [('x', np.zeros(2, np.float32))])
    lost = messages.odometry_message(
        MESSAGES, team.vehicles[name].advance(), f'{name}/odom', f'{name}/base_link'
    )
    lost.pose.pose.position.x = math.nan
    out = team.out

    def images(stamp, encoding):
        out[name, 'camera/rgb/camera_info'].publish(info)
        team.spin(0.2)
        color = send(MESSAGES, stamp, f'{name}/c', encoding, rgb)
        out[name, 'camera/rgb/image_raw'].publish(color)
        small = send(MESSAGES, stamp, f'{name}/c', '16UC1', depth)
        out[name, 'camera/depth_registered/image_raw'].publish(small)

    expected = {
        "encoding 'yuv422', expected one of": lambda: images(stamp, 'yuv422'),
        "frame 'robot2/laser' belongs to vehicle 'robot2'": lambda: out[name, 'scan'].publish(
            foreign
        ),
        'ranges has shape (0,)': lambda: out['robot2', 'scan'].publish(empty),
        "field 'y' has 0 values": lambda: out[name, 'landmarks'].publish(cloud),
        'pose is (nan': lambda: out[name, 'odom'].publish(lost),
        # on the topic of the first one, where warnings are throttled
        'depth has shape (24, 32), expected (48, 64)': lambda: images(stamp + 1.0, 'rgb8'),
    }
    for text, act in expected.items():
        act()
        again = time.monotonic() + 1.0
        while text not in log_of(folder):
            team.spin(0.1)
            if time.monotonic() > again:
                act()
                again += 1.0
    processes.check()
    team.wait_for(lambda: int(team.parts['agent: vehicle robot1']['malformed']) >= 5)
    team.heard.pop('map_landmarks')
    team.wait_for(lambda: 'map_landmarks' in team.heard)
    assert len(messages.cloud_columns(team.heard['map_landmarks'])['x']) >= held


def test_parameters_are_described_checked_and_set(live):
    team, folder, _ = live
    request = DescribeParameters.Request(names=['resolution', 'particles', 'engine'])
    described = team.call(DescribeParameters, 'agent/describe_parameters', request).descriptors
    assert '[m]' in described[0].description
    assert described[0].floating_point_range[0].from_value == pytest.approx(0.01)
    assert described[1].integer_range[0].to_value > 1000
    assert 'fastslam2 | paper' in described[2].additional_constraints
    assert 'takes effect at the next reset' in described[1].description
    late = team.set_parameter('particles', integer_value=100)
    assert late.successful
    team.wait_for(lambda: 'particles: takes effect at the next reset' in log_of(folder))
    assert team.set_parameter('min_frontier_size', double_value=0.8).successful
    refused = team.set_parameter('engine', string_value='magic')
    assert not refused.successful
    assert 'fastslam2' in refused.reason
    fixed = team.set_parameter('seed', integer_value=3)
    assert not fixed.successful
    assert fixed.reason == 'seed: set at start, or while the node is unconfigured'


def test_pause_resume_and_return_home(live):
    team, _, _ = live
    answer = team.call(SetBool, 'pause_new_measurements', SetBool.Request(data=True))
    assert answer.success
    assert 'ignored' in answer.message
    team.call(SetBool, 'pause_new_measurements', SetBool.Request(data=False))
    team.resume.publish(Bool(data=False))
    team.wait_for(lambda: team.statuses[-1] == 'exploration_paused')
    assert team.call(Trigger, 'return_home', Trigger.Request()).success
    team.drive_until(lambda: team.statuses[-1] == 'returning_to_origin')
    team.drive_until(lambda: len(team.heard['robot1/plan'].poses) > 1)
    goal = messages.plan_record(team.heard['robot1/plan'], 'robot1').goal
    assert math.dist(goal[:2], STARTS['robot1'][:2]) < 0.2


def test_state_is_saved_forgotten_and_loaded(live):
    team, folder, _ = live
    assert team.call(Trigger, 'save_state', Trigger.Request()).success
    assert team.call(Trigger, 'reset', Trigger.Request()).success
    team.heard.pop('map_landmarks')
    team.wait_for(lambda: 'map_landmarks' in team.heard)
    assert team.heard['map_landmarks'].width < 50
    team.drive(3)
    answer = team.call(Trigger, 'load_state', Trigger.Request())
    assert answer.success, answer.message
    assert 'state.npz' in answer.message
    # the vehicles are not where the state has them, as far as is known: nobody drives off
    assert 'exploration stays paused until it is resumed' in log_of(folder)
    team.wait_for(lambda: team.heard['map_landmarks'].width >= 50)
    (folder / 'state.npz').write_bytes(b'garbage')
    answer = team.call(Trigger, 'load_state', Trigger.Request())
    assert not answer.success
    assert 'state cannot be loaded' in answer.message
    team.heard.pop('map_landmarks')
    team.wait_for(lambda: 'map_landmarks' in team.heard)
    assert team.heard['map_landmarks'].width >= 50


def test_poses_of_the_operator_are_checked_and_go_to_the_selected_vehicle(live):
    """What RViz sends to /initialpose, and what it must not send."""
    team, folder, processes = live
    out = team.node.create_publisher(PoseWithCovarianceStamped, '/initialpose', 10)
    team.wait_for(lambda: out.get_subscription_count() > 0)
    team.drive(3)
    place = messages.planar_pose(team.heard['robot2/pose'].pose.pose)
    spread = np.diag([0.25, 0.25, 0.068])

    def send(frame, covariance):
        out.publish(messages.estimate_message(MESSAGES, 0.0, frame, place, covariance))

    def logged(text):
        team.wait_for(lambda: text in log_of(folder), 20.0)

    send('map', spread)
    logged('/initialpose is ignored: set the parameter selected_vehicle')
    refused = team.set_parameter('selected_vehicle', string_value='robot7')
    assert "selected_vehicle is 'robot7', expected one of" in refused.reason
    assert team.set_parameter('selected_vehicle', string_value='robot2').successful
    team.spin(0.5)
    send('robot1/odom', spread)
    logged("frame 'robot1/odom' belongs to vehicle 'robot1'")
    # warnings are throttled per vehicle
    assert team.set_parameter('selected_vehicle', string_value='robot1').successful
    team.spin(0.5)
    send('base_link', spread)
    logged("pose is in frame 'base_link', expected 'map'")
    assert team.set_parameter('selected_vehicle', string_value='robot2').successful
    team.spin(5.1)
    send('map', np.zeros((3, 3)))
    logged('variances of x, y and yaw are [0.0, 0.0, 0.0], expected more than 0')
    team.spin(5.1)
    crooked = spread.copy()
    crooked[0, 1] = crooked[1, 0] = 5.0
    send('map', crooked)
    logged('covariance has the eigenvalue -4.75, expected none below 0')
    assert 'is placed by the operator' not in log_of(folder)
    send('/map', spread)
    logged('robot2 is placed by the operator')
    processes.check()


def test_goals_and_areas_of_the_operator_are_taken_from_topics(live):
    """As RViz and `ros2 topic pub` send them: without latching."""
    team, folder, processes = live
    outs = {
        name: team.node.create_publisher(kind, name, 10)
        for name, kind in (
            ('robot1/goal_pose', PoseStamped),
            ('/goal_pose', PoseStamped),
            ('explore/keepout', PolygonStamped),
            ('explore/area', PolygonStamped),
        )
    }
    team.wait_for(lambda: all(out.get_subscription_count() for out in outs.values()))
    team.drive(3)

    def goal(name, x, y, frame='map'):
        message = PoseStamped(pose=messages.pose_message(MESSAGES, Pose2(x, y, 0.0)))
        message.header.frame_id = frame
        outs[name].publish(message)

    def polygon(name, corners, frame='map'):
        message = PolygonStamped()
        message.header.frame_id = frame
        message.polygon.points = [Point32(x=float(x), y=float(y)) for x, y in corners]
        outs[name].publish(message)

    def logged(text):
        team.wait_for(lambda: text in log_of(folder), 20.0)

    square = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
    polygon('explore/keepout', square, 'odom')
    logged("explore/keepout: polygon is in frame 'odom', expected 'map'")
    polygon('explore/keepout', square[:2])
    logged('polygon has 2 corners, expected at least 3')
    polygon('explore/keepout', square)
    logged('explore/keepout: a polygon; 1.0 m² of the map are excluded')
    goal('robot1/goal_pose', 0.0, 0.0)
    logged('goal (0.00, 0.00) of robot1 lies in a keep-out area')
    polygon('explore/keepout', [])
    logged('explore/keepout: cleared; 0.0 m² of the map are excluded')
    polygon('explore/area', square)
    team.wait_for(lambda: 'explore/area: ' in log_of(folder), 20.0)
    polygon('explore/area', [])
    goal('robot1/goal_pose', 1.0, 1.0, 'robot1/odom')
    logged("goal is in frame 'robot1/odom', expected 'map'")
    team.set_parameter('selected_vehicle', string_value='robot2')
    team.spin(0.5)
    goal('/goal_pose', 1.0, 1.0)
    logged('robot2 is sent to x 1.00 m, y 1.00 m by the operator')
    processes.check()


def test_silence_is_explained(tmp_path):
    """Nothing is connected: after five seconds the agent says which topics it misses and why."""
    wrong = {'partikles': 50, 'robot8': {'visionn': 'none'}, 'follow_speed': 0.3}
    with start_agent(tmp_path, {'vehicles': ['robot8', 'robot9'], **wrong}) as processes:
        log = tmp_path / 'logs' / 'agent.log'
        end = time.monotonic() + 90.0
        text = 'nothing on /robot9/odom after 5 s: no publisher found'
        while text not in log.read_text():
            assert time.monotonic() < end
            time.sleep(0.2)
        # parameters that do not exist are named; those of other nodes may share the file
        assert "there is no parameter 'partikles'; did you mean 'particles'?" in log.read_text()
        assert "'robot8.visionn'; did you mean 'robot8.vision'?" in log.read_text()
        assert 'follow_speed' not in log.read_text()
        processes.check()


def test_a_word_that_yaml_reads_as_a_boolean_is_answered_with_the_right_one(tmp_path):
    environment = {**one_machine_environment(), 'ROS_DOMAIN_ID': str(DOMAIN)}
    command = [sys.executable, '-m', 'explore_slam.nodes.executables', 'agent_node', '--ros-args']
    for name in ('vision', 'robot2.vision'):
        done = subprocess.run(
            [*command, '-p', f'{name}:=off'],
            env=environment,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == 1
        assert 'YAML reads off and no as false; write vision: none' in done.stderr
        assert 'Traceback' not in done.stderr
