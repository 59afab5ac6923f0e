"""What scans show of when their beams are measured, and what the agent does until they have."""

import logging
import math
from dataclasses import replace

import numpy as np
import pytest

from explore_slam.agent import Agent, AgentConfig
from explore_slam.agent.sweep_detection import SweepDetector
from explore_slam.data import LaserScan, OdometryReading, SweepTiming
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.settings import with_values
from explore_slam.simulation.worlds.walls import box, distances_along, distances_from
from explore_slam.sweeps import Sweep

ROOM = np.concatenate(
    [box(-4.0, -3.0, 8.0, 6.0), box(1.5, 1.0, 1.0, 1.0), box(-3.0, -2.6, 0.8, 1.4)]
)
BEAMS = 180
MOUNT = Pose2(0.1, 0.0, 0.0)
FEW = with_values(AgentConfig(), {'particles': 20})
MOMENT = Sweep(0.0)


def heading(stamp, rate):
    """The vehicle stands for 1.5 s and then turns; it accelerates for half a second."""
    moving = max(stamp - 1.5, 0.0)
    return rate * (min(moving, 0.5) ** 2 + max(moving - 0.5, 0.0))


def records(
    sweep,
    interval=0.2,
    until=6.0,
    rate=0.9,
    wheels=1.05,
    span=2.0 * math.pi,
    turn=heading,
    **changes,
):
    """Odometry at 20 Hz and scans with noise in the order of their arrival."""
    random = np.random.default_rng(0)
    angles = -0.5 * span + span / BEAMS * np.arange(BEAMS)
    found = []
    for number in range(int(until / interval) - 1):
        begin = 0.03 + interval * number
        stamp = begin - sweep.begin
        poses = [Pose2(0.0, 0.0, turn(stamp + t, rate)) for t in sweep.times(BEAMS)]
        lasers = np.array([pose.compose(MOUNT) for pose in poses])
        ranges = distances_along(ROOM, lasers[:, :2], angles + lasers[:, 2])
        ranges += 0.01 * random.standard_normal(BEAMS)
        scan = LaserScan(
            stamp, angles[0], angles[1] - angles[0], ranges.astype(np.float32), 0.1, 9.0, MOUNT,
            **changes,
        )  # fmt: skip
        found.append((begin + sweep.duration, 1, scan))
    for tick in range(round(20.0 * until)):
        pose = Pose2(0.0, 0.0, wheels * turn(0.05 * tick, rate))
        found.append((0.05 * tick, 0, OdometryReading(0.05 * tick, pose)))
    found.sort(key=lambda item: item[:2])
    return [record for _, _, record in found]


def detected(found, duration):
    """A detector after all records, each scan as soon as odometry covers it."""
    detector, waiting = SweepDetector('robot1'), []
    for record in found:
        if isinstance(record, LaserScan):
            waiting.append(record)
            continue
        detector.add_odometry(record)
        while waiting and waiting[0].stamp + duration <= record.stamp:
            detector.add(waiting.pop(0), duration, MOUNT)
    return detector


@pytest.mark.parametrize('rate', [0.9, -0.45])
@pytest.mark.parametrize('wheels', [0.8, 1.05, 1.2])
@pytest.mark.parametrize(
    'sweep',
    [
        Sweep(0.199),
        Sweep(0.199, True),
        Sweep(0.199, False, True),
        Sweep(0.199, True, True),
        MOMENT,
    ],
)
def test_scans_at_different_turn_rates_show_their_sweep(sweep, wheels, rate, caplog):
    caplog.set_level(logging.INFO)
    detector = detected(records(sweep, rate=rate, wheels=wheels), 0.199)
    assert detector.found == sweep
    assert caplog.text.count('the scans show') == 1
    assert ('at one moment' in caplog.text) is (sweep == MOMENT)


@pytest.mark.parametrize('sweep', [Sweep(0.199), MOMENT])
def test_a_vehicle_that_does_not_turn_shows_nothing(sweep):
    detector = detected(records(sweep, rate=0.0), 0.199)
    assert detector.found is None
    assert detector.comparisons == 0


def test_equal_turn_rates_show_nothing():
    found = [record for record in records(Sweep(0.199)) if record.stamp > 2.1]
    assert detected(found, 0.199).comparisons == 0


def test_a_sweep_of_another_duration_is_not_taken_for_one_of_the_time_between_scans():
    """Every second scan of a laser that turns twice as fast: no hypothesis is right."""
    assert detected(records(Sweep(0.0995)), 0.199).found is None


def test_in_a_round_room_there_is_no_decision(caplog):
    caplog.set_level(logging.INFO)
    plain = np.full(BEAMS, 3.0, np.float32)
    found = [
        replace(r, ranges=plain) if isinstance(r, LaserScan) else r
        for r in records(Sweep(0.199), until=10.0)
    ]
    assert detected(found, 0.199).found is None


def test_odometry_that_jumps_back_is_forgotten():
    detector = SweepDetector('robot1')
    detector.add_odometry(OdometryReading(5.0, Pose2(0.0, 0.0, 1.0)))
    detector.add_odometry(OdometryReading(5.1, Pose2(0.0, 0.0, 1.4)))
    (scan,) = [r for r in records(MOMENT, until=0.5) if isinstance(r, LaserScan)][:1]
    late = LaserScan(5.1, -3.0, 0.1, scan.ranges, 0.1, 9.0)
    assert detector.turn_within(late, 0.1) == pytest.approx(0.4)
    detector.add_odometry(OdometryReading(1.0, IDENTITY))
    assert detector.turn_within(late, 0.1) == 0.0


# -- in the agent -------------------------------------------------------------------------------


def run(found):
    agent = Agent(FEW, {'a': IDENTITY})
    for record in found:
        agent.add('a', record)
    return agent


def wrong_cells(agent):
    occupied = np.argwhere(agent.grid.to_trinary() == 100)
    assert len(occupied) > 200
    return float(np.mean(distances_from(ROOM, agent.grid.to_point(occupied)) > 0.1))


@pytest.mark.parametrize('sweep', [Sweep(0.199), Sweep(0.199, True, True)])
def test_the_map_is_right_although_nothing_tells_how_the_sweeps_go(sweep):
    agent = run(records(sweep, until=9.0))
    assert wrong_cells(agent) <= 0.01
    counts = agent.summary()['a']
    assert counts['deskewed_scans'] > 30
    assert counts['matched_scans'] >= 35
    assert 'unmatched_scans' not in counts


def test_a_statement_that_the_scans_contradict_is_corrected():
    increment = 0.199 / (BEAMS - 1)
    agent = run(records(Sweep(0.199, backward=True), until=9.0, time_increment=increment))
    assert agent.track('a').sweeps.of('').judge.found == Sweep(pytest.approx(0.199), True)
    assert wrong_cells(agent) <= 0.01


LDS_01 = 2.98899994959e-05 * 359  # s; what the driver of the TurtleBot3's LDS-01 states


@pytest.mark.parametrize('scan_time', [0.0, 0.2])
@pytest.mark.parametrize(
    ('stated', 'words'),
    [
        (0.0, 'a: the scans show a sweep of 0.199 s'),
        (LDS_01, 'a sweep of 0.0107 s, which is not the time between scans; the scans show'),
        (0.00018, 'a sweep of 0.00018 s, which is not'),  # a wrong unit
        (0.199 / 3.0, 'a sweep of 0.0663 s, which is not'),
        (1.4 * 0.199, 'a sweep of 0.279 s, which is not'),
    ],
)
def test_an_implausible_statement_gives_a_right_map(stated, words, scan_time, caplog):
    caplog.set_level(logging.INFO)
    increment = stated / (BEAMS - 1)
    found = records(Sweep(0.199), until=9.0, time_increment=increment, scan_time=scan_time)
    agent = run(found)
    assert agent.track('a').sweeps.of('').judge.found == Sweep(pytest.approx(0.199, abs=1e-3))
    assert wrong_cells(agent) <= 0.01
    assert caplog.text.count('the scans show a sweep of 0.199 s, in the order of') == 1
    assert words in caplog.text
    assert (f'a: time_increment of the scans is {increment:.4g} s' in caplog.text) is (stated > 0)


@pytest.mark.parametrize('stated', [LDS_01, 0.199 / 3.0, 0.8 * 0.199, 1.2 * 0.199, 1.4 * 0.199])
@pytest.mark.parametrize('sweep', [Sweep(0.199, True, True), Sweep(0.199, last=True)])
def test_direction_and_stamp_are_found_beside_an_implausible_statement(sweep, stated):
    increment = stated / (BEAMS - 1)
    agent = run(records(sweep, until=9.0, time_increment=increment))
    found = agent.track('a').sweeps.of('').judge.found
    assert found == sweep._replace(duration=pytest.approx(0.199, abs=1e-3))
    assert wrong_cells(agent) <= 0.01


@pytest.mark.parametrize('timing', [SweepTiming(), SweepTiming(None, 'forward', 'first')])
def test_a_statement_is_doubted_although_direction_and_stamp_are_set(timing):
    increment = LDS_01 / (BEAMS - 1)
    agent = run(records(Sweep(0.199), until=9.0, time_increment=increment, timing=timing))
    assert wrong_cells(agent) <= 0.01


@pytest.mark.parametrize(
    ('true', 'stated'),
    [
        (Sweep(0.0995), 0.0995),  # every second scan of a laser that turns twice as fast
        (MOMENT, 0.00018),
        (MOMENT, LDS_01),
    ],
)
def test_a_statement_that_the_scans_confirm_stays(true, stated, caplog):
    caplog.set_level(logging.INFO)
    agent = run(records(true, until=9.0, time_increment=stated / (BEAMS - 1)))
    assert agent.track('a').sweeps.of('').judge.found == Sweep(pytest.approx(stated))
    assert wrong_cells(agent) <= 0.01
    assert caplog.text.count('the scans show') == 1
    assert not [record for record in caplog.records if record.levelno > logging.INFO]


def test_a_short_sweep_of_a_scanner_that_does_not_look_all_around_is_believed():
    """A mirror looks ahead for a part of the interval only."""
    increment = 0.0133 / (BEAMS - 1)  # an LMS-200: half a turn at 37.5 Hz, the scans at 5 Hz
    agent = run(records(Sweep(0.0133), span=math.pi, time_increment=increment))
    queue = agent.track('a').sweeps.of('')
    assert (queue.detector.comparisons, queue.judge.found) == (0, None)
    assert agent.summary()['a']['deskewed_scans'] > 20


@pytest.mark.parametrize('interval', [0.1, 0.2])
def test_scans_of_one_moment_give_the_same_map_as_if_that_were_known(interval):
    unknown = run(records(MOMENT, interval))
    known = run(records(MOMENT, interval, timing=SweepTiming(0.0)))
    assert unknown.track('a').sweeps.of('').judge.found == MOMENT
    assert known.track('a').sweeps.of('').judge.found is None
    assert unknown.grid.evidence().tobytes() == known.grid.evidence().tobytes()
    scans = [item.scan for item in unknown.laser_map.scans]
    assert [scan.stamp for scan in scans] == [item.scan.stamp for item in known.laser_map.scans]
    assert all(scan.bearings is None for scan in scans)
    assert unknown.summary() == known.summary()


def test_a_scanner_that_does_not_look_all_around_is_never_taken_for_a_spinning_one():
    agent = run(records(MOMENT, span=math.pi))
    detector = agent.track('a').sweeps.of('').detector
    assert (detector.comparisons, detector.found) == (0, None)
    assert 'deskewed_scans' not in agent.summary()['a']


def test_known_sweeps_are_not_tested():
    timing = SweepTiming(None, 'forward', 'first')
    increment = 0.199 / (BEAMS - 1)
    agent = run(records(Sweep(0.199), timing=timing, time_increment=increment))
    assert agent.track('a').sweeps.of('').detector.comparisons == 0


def test_scans_of_the_first_turn_are_held_back_for_a_few_seconds_at_most():
    """Nothing is shown in a round room; the scans enter the map all the same."""
    agent = Agent(FEW, {'a': IDENTITY})
    plain = np.full(BEAMS, 3.0, np.float32)
    newest = []
    for record in records(MOMENT, until=9.0):
        round_room = isinstance(record, LaserScan)
        agent.add('a', replace(record, ranges=plain) if round_room else record)
        if agent.laser_map.scans:
            newest.append((record.stamp, agent.laser_map.scans[-1].scan.stamp))
    delays = [now - stamp for now, stamp in newest]
    assert 3.0 < max(delays) < 4.0 + 2.0 + 0.5  # at rest, a scan enters the map every 2 s
    assert delays[-1] < 0.6


def test_a_reset_keeps_what_the_scans_have_shown():
    agent = run(records(Sweep(0.199, True)))
    agent.reset()
    assert agent.track('a').sweeps.of('').judge.found == Sweep(
        pytest.approx(0.2 * 179 / 180), True
    )
    assert agent.track('a').sweeps.of('').detector.is_done


def test_a_map_that_was_drawn_before_it_was_known_is_named(caplog):
    """The vehicle turns at one rate from the start on, longer than scans are held back."""
    found = records(
        Sweep(0.199), until=14.0, turn=lambda stamp, rate: rate * (stamp if stamp < 8.0 else 8.0)
    )
    agent = run(found)
    assert agent.track('a').sweeps.of('').judge.found == Sweep(pytest.approx(0.2 * 179 / 180))
    assert caplog.text.count('call the service reset if the map so far is distorted') == 1


def test_scans_stay_in_order_when_it_becomes_known():
    found = records(MOMENT, until=9.0)
    agent = Agent(FEW, {'a': IDENTITY})
    stamps = []
    for record in found:
        agent.add('a', record)
        stamps += [item.scan.stamp for item in agent.laser_map.scans[len(stamps) :]]
    assert agent.track('a').sweeps.of('').judge.found == MOMENT
    assert len(stamps) > 30
    assert stamps == sorted(stamps)
