"""Tags through the real agent: loops, joins, surveyed frames, and tags that are read wrong."""

import logging
import math

import numpy as np
import pytest

from explore_slam.agent import Agent, AgentConfig
from explore_slam.data import Intrinsics, OdometryReading, RgbdFrame, TagObservations
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.settings import with_values
from explore_slam.vision import CameraMount, FeatureExtractor, tags_available
from explore_slam.vision.tag_images import TagInView, draw_view

PERIOD, STEP = 0.5, 0.25  # s and m between images
REACH, HALF_VIEW = 4.0, math.radians(30.0)  # m, rad
NOISE = np.array([0.03, 0.03, 0.1])  # m, m, rad: of a tag 2 m away
SIDE = 8.0  # m of the square that the vehicles drive


def ring(laps=1.0, start=0.0):
    """Return poses every STEP along a square, anticlockwise, from a distance (m) along it on."""
    poses = []
    for n in range(round(laps * 4 * SIDE / STEP) + 1):
        side, along = divmod(start + n * STEP, SIDE)
        heading = (side % 4) * math.pi / 2
        corner = [(0, 0), (SIDE, 0), (SIDE, SIDE), (0, SIDE)][int(side % 4)]
        at = Pose2(*corner, heading).compose(Pose2(along, 0.0, 0.0))
        poses.append(at)
    return poses


def site():
    """Return tags by number: on signs beside the square, that face vehicles on their way."""
    tags = {}
    for number, pose in enumerate(ring(1.0, 3.0)[:: round(4.0 / STEP)][:8]):
        at = pose.compose(Pose2(0.0, -0.8, math.pi))
        tags[number] = at
    return tags


class Vehicle:
    """A vehicle on given poses: odometry that turns too far, and tags with noise."""

    def __init__(self, poses, tags, seed, turn=1.0, misread=0.0):
        self.poses, self.tags, self.turn, self.misread = poses, tags, turn, misread
        self.random = np.random.default_rng(seed)
        self.wheels = IDENTITY

    def records(self, tick):
        if tick:
            step = self.poses[tick - 1].between(self.poses[tick])
            noise = np.array([0.004, 0.002, 0.004]) * self.random.normal(size=3)
            moved = np.asarray(step) * [1.0, 1.0, self.turn] + noise
            self.wheels = self.wheels.compose(Pose2.from_array(moved))
        yield OdometryReading(PERIOD * tick, self.wheels)
        ids, poses = [], []
        for tag, pose in self.tags.items():
            at = self.poses[tick].between(pose)
            away = math.hypot(at.x, at.y)
            if not 0.8 < away < REACH or abs(math.atan2(at.y, at.x)) > HALF_VIEW:
                continue
            if abs(at.theta) < math.radians(110):
                continue
            shown = tag
            if self.random.random() < self.misread:
                shown = (tag + int(self.random.integers(1, len(self.tags)))) % len(self.tags)
            if shown not in ids:
                ids.append(shown)
                poses.append(np.asarray(at) + NOISE * self.random.normal(size=3))
        if ids:
            covariances = np.tile(np.diag(NOISE**2), (len(ids), 1, 1))
            yield TagObservations(PERIOD * tick, np.array(ids), np.array(poses), covariances)


def drive(agent, vehicles):
    for tick in range(max(len(vehicle.poses) for vehicle in vehicles.values())):
        for name, vehicle in vehicles.items():
            if tick < len(vehicle.poses):
                for record in vehicle.records(tick):
                    agent.add(name, record)


def errors(agent, name, vehicle, frame=IDENTITY):
    """Return the distances (m) of a vehicle's keyframes from its true path; frame: of the map."""
    stamps, poses = agent.trajectory(name)
    true = [vehicle.poses[round(stamp / PERIOD)] for stamp in stamps]
    found = [frame.compose(Pose2.from_array(pose)) for pose in poses]
    return np.array([math.dist(a[:2], b[:2]) for a, b in zip(true, found, strict=True)])


def make_agent(starts, tmp_path=None, text='', **settings):
    if text:
        (tmp_path / 'tags.yaml').write_text(text)
        settings['tags_file'] = str(tmp_path / 'tags.yaml')
    config = with_values(AgentConfig(), {'particles': 50, **settings})
    return Agent(config, starts, 0)


def test_a_tag_seen_again_closes_the_loop():
    vehicle = Vehicle(ring(2.0), site(), 1, turn=1.04)
    agent = make_agent({'robot1': vehicle.poses[0]})
    drive(agent, {'robot1': vehicle})
    reckoned = vehicle.poses[0].compose(vehicle.wheels)
    assert math.dist(reckoned[:2], vehicle.poses[-1][:2]) > 1.0
    counts = agent.summary()['robot1']
    assert counts['tag_closures'] >= 6
    assert 'tag_closures_retracted' not in counts
    assert errors(agent, 'robot1', vehicle).max() < 0.25


@pytest.mark.parametrize('misread', [0.0, 0.1])
def test_a_vehicle_of_unknown_start_joins_by_tags(misread):
    tags = site()
    vehicles = {
        'robot1': Vehicle(ring(1.5), tags, 1, turn=1.03, misread=misread),
        'robot2': Vehicle(ring(1.5, 17.0), tags, 2, turn=0.97, misread=misread),
    }
    agent = make_agent({'robot1': vehicles['robot1'].poses[0], 'robot2': None})
    drive(agent, vehicles)
    (join,) = agent.take_joins()
    assert (join.vehicle, join.other) == ('robot2', 'robot1')
    for name, vehicle in vehicles.items():
        assert agent.is_in_map(name)
        assert errors(agent, name, vehicle).max() < 0.3
    assert agent.take_joins() == []


SURVEY = 'size: 0.16\ntags:\n'


def surveyed(tags, numbers, shift=0.0):
    return SURVEY + ''.join(
        f'  - {{id: {n}, pose: [{tags[n].x + shift}, {tags[n].y}, {tags[n].theta}]}}\n'
        for n in numbers
    )


@pytest.mark.parametrize('numbers', [(1, 5), (2,)])
def test_surveyed_tags_fix_the_frame_of_the_map(tmp_path, numbers):
    tags = site()
    vehicles = {
        'robot1': Vehicle(ring(2.0), tags, 3, turn=1.03),
        'robot2': Vehicle(ring(2.0, 17.0), tags, 4, turn=0.98),
    }
    agent = make_agent(dict.fromkeys(vehicles), tmp_path, surveyed(tags, numbers))
    drive(agent, vehicles)
    assert agent.tags.frame_is_surveyed
    limit = 0.15 if len(numbers) > 1 else 0.6  # of one tag, the heading is less certain
    for name, vehicle in vehicles.items():
        assert agent.is_in_map(name)
        assert errors(agent, name, vehicle).mean() < limit
        start = agent.home(name)
        assert math.dist(start[:2], vehicle.poses[0][:2]) < 2 * limit


def test_a_vehicle_joins_by_surveyed_tags_that_no_other_has_seen(tmp_path):
    tags = site()
    seen = {'robot1': (0, 1, 2, 3), 'robot2': (4, 5, 6, 7)}
    vehicles = {
        name: Vehicle(ring(1.2, start), {n: tags[n] for n in seen[name]}, 10)
        for name, start in (('robot1', 0.0), ('robot2', 16.0))
    }
    agent = make_agent(dict.fromkeys(vehicles), tmp_path, surveyed(tags, (1, 2, 5, 6)))
    drive(agent, vehicles)
    for name, vehicle in vehicles.items():
        assert agent.is_in_map(name)
        assert errors(agent, name, vehicle).max() < 0.3


def test_a_start_that_contradicts_the_survey_yields(tmp_path):
    tags = site()
    vehicle = Vehicle(ring(2.0), tags, 5)
    wrong = Pose2(1.0, -0.5, 0.2)
    agent = make_agent({'robot1': wrong}, tmp_path, surveyed(tags, (1, 5)))
    drive(agent, {'robot1': vehicle})
    assert errors(agent, 'robot1', vehicle).max() < 0.25
    assert math.dist(agent.home('robot1')[:2], (0.0, 0.0)) < 0.25


def test_a_tag_that_is_not_where_it_was_surveyed_is_named(tmp_path, caplog):
    tags = site()
    text = surveyed(tags, (1, 4)) + surveyed(tags, (6,), shift=3.0).removeprefix(SURVEY)
    vehicle = Vehicle(ring(2.0), tags, 6)
    agent = make_agent({'robot1': None}, tmp_path, text)
    with caplog.at_level(logging.WARNING):
        drive(agent, {'robot1': vehicle})
    assert errors(agent, 'robot1', vehicle).max() < 0.25
    (message,) = [r.getMessage() for r in caplog.records if 'surveyed pose' in r.getMessage()]
    assert message.startswith('tag 6 is at')


def test_one_number_at_two_places_does_no_harm():
    tags = site()
    vehicle = Vehicle(ring(2.0), tags, 7, turn=1.02)
    original = vehicle.records

    def renamed(record):
        if not isinstance(record, TagObservations):
            return record
        ids = np.where(record.ids == 5, 2, record.ids)  # tag 5 bears the number of tag 2
        return TagObservations(record.stamp, ids, record.poses, record.covariances)

    def records(tick):
        return map(renamed, original(tick))

    vehicle.records = records
    agent = make_agent({'robot1': vehicle.poses[0]})
    drive(agent, {'robot1': vehicle})
    assert errors(agent, 'robot1', vehicle).max() < 0.3


def test_a_saved_state_continues_with_its_tags(tmp_path):
    vehicle = Vehicle(ring(1.0), site(), 8)
    agent = make_agent({'robot1': vehicle.poses[0]})
    drive(agent, {'robot1': vehicle})
    path = agent.save_state(tmp_path / 'state.npz')
    again = make_agent({'robot1': vehicle.poses[0]})
    again.load_state(path)
    assert len(again.tags.sightings) == len(agent.tags.sightings) > 4
    np.testing.assert_array_equal(
        again.tags.state_dict()['observations'], agent.tags.state_dict()['observations']
    )
    second = Vehicle(ring(1.0), site(), 9)
    drive(again, {'robot1': second})
    assert again.summary()['robot1']['tag_closures'] >= 4


def test_dedicated_maps_count_tags_and_do_not_use_them():
    vehicle = Vehicle(ring(0.5), site(), 8)
    agent = make_agent({'robot1': vehicle.poses[0], 'robot2': IDENTITY}, maps='dedicated')
    drive(agent, {'robot1': vehicle})
    counts = agent.summary()['robot1']
    assert counts['unused_tags'] > 10
    assert 'tags' not in counts


@pytest.mark.skipif(not tags_available(), reason='this OpenCV finds no tags')
def test_images_and_tags_found_on_the_vehicle_give_the_same_map(tmp_path):
    """The agent extracts tags from frames as the extractor on the vehicle does."""
    camera, mount = Intrinsics(320, 240, 260.0, 260.0, 159.5, 119.5), CameraMount(0.1, 0.0, 0.4)
    turn = mount.rotation.T
    toward = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # faces the vehicle
    toward[:, 0] *= -1.0
    path = tmp_path / 'tags.yaml'
    path.write_text('size: 0.3\n')
    agents = {
        where: make_agent({'robot1': IDENTITY}, tags_file=str(path))
        for where in ('agent', 'vehicle')
    }
    extractor = FeatureExtractor(agents['agent'].config.vision)
    random = np.random.default_rng(0)
    for tick in range(10):
        x, stamp = 0.25 * tick, PERIOD * tick
        place = turn @ (np.array([4.0 - x, 0.2, 0.5]) - mount.translation)
        image = draw_view('tag36h11', [TagInView(3, 0.3, turn @ toward, place)], camera, random)
        frame = RgbdFrame(stamp, image, np.zeros(image.shape, np.float32), camera)
        for where, agent in agents.items():
            agent.add('robot1', OdometryReading(stamp, Pose2(x, 0.0, 0.0)))
            if where == 'agent':
                agent.add('robot1', frame)
                continue
            tags = extractor.observe_tags(frame)
            agent.add('robot1', extractor.extract(frame))
            if tags is not None:
                agent.add('robot1', tags)
    one, other = (agent.tags.state_dict()['observations'] for agent in agents.values())
    assert len(one) >= 3
    np.testing.assert_array_equal(one, other)
    (sighting,) = agents['agent'].tags.sightings
    at = agents['agent'].belief.tags.pose(sighting.node)
    assert math.dist(at[:2], (4.0, 0.2)) < 0.1
    counts = agents['agent'].summary()['robot1']
    assert counts['tag_sightings'] == 1
    assert counts['tags'] >= 8


def test_the_survey_holds_the_map_as_firmly_as_its_settings_say(tmp_path):
    tags = site()
    near = []
    for deviation in (0.01, 0.2):
        vehicle = Vehicle(ring(1.0), tags, 3)
        text = surveyed(tags, (1, 5))
        agent = make_agent(
            {'robot1': None},
            tmp_path,
            text,
            tag_survey_deviation=deviation,
            tag_survey_heading=deviation,
        )
        drive(agent, {'robot1': vehicle})
        held = [s for s in agent.tags.sightings if s.tag in (1, 5) and s.used]
        assert held
        covariance = agent.belief.tags.covariance(held[0].node)
        near.append(math.sqrt(covariance[:2, :2].trace()))
    assert near[0] < 0.05
    assert near[1] > 0.1
