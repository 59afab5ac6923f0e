"""Exploration studies in the grid world: termination, status, collisions, tables."""

import math

import pytest
from grid_worlds import drawn_world

from explore_slam.data import VehicleBody
from explore_slam.errors import ConfigError, EvaluationError, ExploreSlamError
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.simulation.grid.grid_simulator import GridSimulatorConfig
from explore_slam.simulation.grid.scenario import Event, Scenario
from explore_slam.studies.exploration_run import StudyConfig, Vehicles, explore
from explore_slam.studies.exploration_study import make_study, run_study
from explore_slam.studies.exploration_tables import (
    HEADER,
    markdown_table,
    run_values,
    save_study,
    table_rows,
    time_ratio,
)
from explore_slam.studies.parallel import Workers

TWO_ROOMS = [
    '#########################',
    *['#...........#...........#'] * 4,
    *['#.......................#'] * 3,
    *['#...........#...........#'] * 4,
    '#########################',
]
LOOP = [
    '####################',
    *['#..................#'] * 4,
    *['#....##########....#'] * 5,
    *['#..................#'] * 4,
    '####################',
]


def narrow(rows, width):
    """Two rooms, at 0.1 m per sign, with a door of `width` m between them."""
    fine = [''.join(sign * 5 for sign in row) for row in rows for _ in range(5)]
    middle, half = len(fine) // 2, round(width / 0.2)
    closed = [
        row if abs(index - middle + 0.5) < half else row[:60] + '#####' + row[65:]
        for index, row in enumerate(fine)
    ]
    return drawn_world(closed, 0.1)


def run(world, *starts, strategy='default', limit=900.0, **settings):
    poses = {f'robot{index + 1}': Pose2(*start) for index, start in enumerate(starts)}
    return explore(world, poses, strategy, 1, StudyConfig(time_limit=limit, **settings))


@pytest.mark.parametrize('strategy', ['default', 'paper', 'nearest', 'random'])
def test_two_rooms_are_explored_by_every_strategy(strategy):
    done = run(drawn_world(TWO_ROOMS), (1.5, 1.5, 0.0), strategy=strategy)
    assert done.status == 'exploration_complete'
    assert done.curve.team[-1] > 0.99
    assert done.mapped > 0.95  # cells of the map half inside a wall are wall
    assert 0.0 < done.curve.time_to(0.9) <= done.curve.time_to(0.99) < done.duration
    assert done.paths[0] > 4.0
    assert (done.vehicle_collisions, done.wall_collisions) == (0, 0)


def test_a_team_shares_the_work_without_contact():
    done = run(
        drawn_world(TWO_ROOMS),
        (1.5, 1.5, 0.0), (2.5, 1.5, 0.0), (1.5, 3.5, 0.0),
    )  # fmt: skip
    assert done.status == 'exploration_complete'
    assert done.curve.team[-1] > 0.99
    assert done.vehicle_collisions == 0
    assert len(done.paths) == 3


def test_a_room_behind_a_door_that_is_too_narrow_does_not_keep_the_team():
    world = narrow(TWO_ROOMS, 0.4)
    done = run(world, (1.5, 1.5, 0.0))
    assert done.status == 'exploration_incomplete'
    assert done.unreached_frontiers > 0
    assert done.unreached_m2 > 1.0
    assert done.curve.team[-1] > 0.99  # of what can be reached
    assert done.duration < 300.0
    assert done.wall_collisions == 0


def test_a_door_that_is_wide_enough_is_driven_through():
    world = narrow(TWO_ROOMS, 1.0)
    done = run(world, (1.5, 1.5, 0.0))
    assert done.status == 'exploration_complete'
    assert done.curve.team[-1] > 0.99
    assert done.paths[0] > 4.0


def test_glass_without_returns_ends_too():
    rows = [row[:12] + 'g' + row[13:] if row[12] == '#' else row for row in TWO_ROOMS]
    rows = [rows[0].replace('g', '#'), *rows[1:-1], rows[-1].replace('g', '#')]
    done = run(drawn_world(rows), (1.5, 1.5, 0.0), limit=1800.0)
    assert done.status == 'exploration_incomplete'  # beams without return pass walls behind glass
    assert done.curve.team[-1] > 0.99
    assert done.wall_collisions == 0


def test_a_glass_wall_without_a_way_round_ends_too():
    rows = ['#########################', *['#...........g...........#'] * 8, '#' * 25]
    done = run(drawn_world(rows), (1.5, 1.5, 0.0), limit=1800.0)
    assert done.status == 'exploration_incomplete'
    assert 'out of reach' in done.reason
    assert done.curve.team[-1] > 0.99
    assert done.duration < 600.0
    assert done.wall_collisions == 0


FLOOR = [
    '########################################',
    *['#..............########................#'] * 5,
    *['#......................................#'] * 2,
    *['#..............########................#'] * 5,
    '########################################',
]  # 20 x 6.5 m, with a corridor of 1 m


def disturbed(*events, starts=((2.0, 2.0, 0.0), (2.0, 4.5, 0.0))):
    poses = {f'robot{index + 1}': Pose2(*start) for index, start in enumerate(starts)}
    config, scenario = StudyConfig(time_limit=900.0), Scenario(events)
    return explore(drawn_world(FLOOR), poses, 'default', 1, config, scenario=scenario)


PERSON = ((9.0, 3.25),)


@pytest.mark.parametrize('size', [1, 2])
def test_a_person_in_the_corridor_is_waited_for(size):
    starts = ((2.0, 2.0, 0.0), (2.0, 4.5, 0.0))[:size]
    done = disturbed(Event('person', 3.0, 60.0, PERSON), starts=starts)
    assert done.status == 'exploration_complete'
    assert done.curve.team[-1] > 0.99
    assert 60.0 < done.duration < 150.0
    assert done.unreached_frontiers == 0


def test_one_who_stays_is_waited_for_in_vain_and_the_end_says_what_is_left():
    done = disturbed(Event('person', 3.0, math.inf, PERSON))
    assert done.status == 'exploration_incomplete'
    assert done.unreached_m2 > 10.0
    assert f'{done.unreached_frontiers} frontier' in done.reason
    assert done.duration < 300.0


def test_a_door_that_opens_late_is_driven_through():
    door = Event('door', 0.0, 6.0, ((9.0, 2.7), (9.0, 3.8)))
    done = disturbed(door, starts=((1.0, 1.0, 3.0),))
    assert done.status == 'exploration_complete'
    assert done.curve.team[-1] > 0.99


def test_the_goal_of_a_vehicle_that_does_not_move_is_taken_by_the_other():
    done = disturbed(Event('stuck', 0.0, vehicle='robot1', factor=0.0))
    assert done.status == 'exploration_complete'
    assert done.curve.team[-1] > 0.99
    assert done.paths[0] == 0.0
    assert done.duration < 250.0


def test_a_vehicle_that_is_silent_for_a_while_takes_part_again():
    done = disturbed(Event('silent', 5.0, 30.0, vehicle='robot1', factor=0.0))
    assert done.status == 'exploration_complete'
    assert done.curve.team[-1] > 0.99
    assert done.paths[0] > 0.5


@pytest.mark.parametrize('size', [1, 2])
def test_a_closed_loop_is_driven_once_and_ends(size):
    starts = [(1.5, 1.5, 0.0), (1.5, 2.5, 0.0)][:size]
    done = run(drawn_world(LOOP), *starts)
    assert done.status == 'exploration_complete'
    assert done.curve.team[-1] > 0.99
    assert max(done.paths) < 60.0


def test_nothing_to_reach_from_the_start_ends_soon():
    cell = drawn_world(['#####', '#...#', '#...#', '#...#', '#####'], 0.4)
    done = run(cell, (1.0, 1.0, 0.0))
    assert done.status == 'exploration_complete'
    assert done.duration < 200.0
    assert done.wall_collisions == 0


def test_a_vehicle_shut_in_ends_as_one_that_cannot_search_or_has_nothing_left():
    tight = drawn_world(['###', '#.#', '###'], 0.6)
    done = run(tight, (0.9, 0.9, 0.0))
    assert done.status in ('exploration_paused', 'exploration_complete')
    assert done.reason
    assert done.duration < 200.0
    assert done.wall_collisions == 0


def test_a_run_out_of_time_says_so():
    done = run(drawn_world(TWO_ROOMS), (1.5, 1.5, 0.0), limit=5.0)
    assert done.status == 'time_limit'
    assert 'not complete after 5 s' in done.reason
    assert done.duration == pytest.approx(5.0)


def test_the_team_comes_home_when_asked_to():
    done = run(drawn_world(TWO_ROOMS), (1.5, 1.5, 0.0), home_at_end=True)
    assert done.status == 'returned_to_origin'


def test_the_same_seed_gives_the_same_run():
    first, second = (
        run(drawn_world(TWO_ROOMS), (1.5, 1.5, 0.0), (2.5, 1.5, 0.0)) for _ in range(2)
    )
    assert first.curve == second.curve
    assert first.paths == second.paths


def run_team(own, *, door=1.0, seconds=900.0, **settings):
    """Explore two rooms from the same places; robot2 has settings of its own."""
    starts = {'robot1': Pose2(1.5, 1.5, 0.0), 'robot2': Pose2(1.5, 3.5, 0.0)}
    config = StudyConfig(time_limit=seconds, **settings)
    one = with_values(GridSimulatorConfig(), own)
    world = narrow(TWO_ROOMS, door)
    return explore(world, starts, 'default', 1, config, own_configs={'robot2': one})


def test_a_slow_vehicle_drives_less_and_the_others_do_its_work():
    alike, unlike = run_team({}), run_team({'cruise_speed': 0.1})
    assert unlike.status == 'exploration_complete'
    assert unlike.paths[1] < 0.5 * alike.paths[1]
    assert unlike.curve.team[-1] > 0.99


def test_a_large_vehicle_is_not_sent_through_a_door():
    large = {'disc_radius': 0.45, 'reach_clearance': 0.53}
    done = run_team(large)
    assert done.status == 'exploration_complete'  # by the other one
    assert done.curve.team[-1] > 0.99
    assert (done.wall_collisions, done.vehicle_collisions) == (0, 0)
    unaware = run_team(large, vehicles_known=False, seconds=200.0)
    assert unaware.stalls > done.stalls  # it is sent where it does not fit


def test_what_the_planner_knows_of_a_vehicle():
    usual = GridSimulatorConfig()
    own = with_values(
        usual,
        {'cruise_speed': 0.25, 'disc_radius': 0.42, 'beam_range': 3.0, 'field_of_view': 1.0},
    )
    vehicles = Vehicles(usual, {'b': own})
    assert vehicles.body('a') == VehicleBody()
    body = vehicles.body('b')
    assert body[:3] == pytest.approx((0.45, 0.2, 0.02))
    assert body[3:] == (3.0, 1.0)
    assert Vehicles(usual, {'b': usual}).body('b') == VehicleBody()


def test_settings_of_vehicles_are_read_from_the_command_line(tmp_path):
    changes = ['cruise_speed=0.4', 'robot2.disc_radius=0.32', 'robot2.beam_range=3']
    study = make_study(tmp_path, [1, 2], ['default'], [0], changes)
    config, own = study.vehicle_configs(2)
    assert (config.cruise_speed, own['robot2'].cruise_speed) == (0.4, 0.4)
    assert own['robot2'].reach_clearance == pytest.approx(0.4)  # as much larger as the disc
    assert (own['robot2'].beam_range, config.beam_range) == (3.0, 8.0)
    assert study.vehicle_configs(1)[1] == {}


@pytest.mark.parametrize(
    ('change', 'error', 'message'),
    [
        ('robot3.disc_radius=0.3', EvaluationError, "vehicles .'robot1', 'robot2'"),
        ('robot2.time_step=0.2', EvaluationError, "expected one of .*'beam_range'"),
        ('robot2.strategy=nearest', EvaluationError, "expected one of .*'beam_range'"),
        ('robot2.disc_radius=-1', ConfigError, 'disc_radius is -1'),
        ('cruise_speed=fast', ConfigError, "cruise_speed is 'fast'"),
    ],
)
def test_wrong_settings_of_vehicles_are_named(tmp_path, change, error, message):
    with pytest.raises(error, match=message):
        make_study(tmp_path, [1, 2], ['default'], [0], [change])


@pytest.fixture(scope='module')
def small_study(tmp_path_factory):
    folder = tmp_path_factory.mktemp('study')
    world = folder / 'rooms.yaml'
    world.write_text(
        'size: [8.0, 5.0]\n'
        'walls:\n  inner:\n'
        '    - {from: [4.0, 0.0], to: [4.0, 5.0], doors: [[2.0, 1.2]]}\n'
    )
    study = make_study(world, [1, 2], ['default', 'nearest'], [0, 1], ['time_limit=600'])
    return study, list(run_study(study, Workers(2)))


def test_a_study_makes_every_run_in_order(small_study):
    study, runs = small_study
    assert [(run.strategy, run.vehicles, run.seed) for run in runs] == list(study.tasks())
    assert len(runs) == 8
    assert {run.status for run in runs} == {'exploration_complete'}


def test_processes_change_nothing(small_study):
    study, runs = small_study
    strategy, size, seed = runs[2].strategy, runs[2].vehicles, runs[2].seed
    assert study.run_one(strategy, size, seed).curve == runs[2].curve


def test_the_table_holds_the_ratios(small_study):
    _, runs = small_study
    rows = {(row[0], row[1]): row for row in table_rows(runs)}
    assert all(len(row) == len(HEADER) for row in rows.values())
    one = [run for run in runs if (run.strategy, run.vehicles) == ('default', 1)]
    two = [run for run in runs if (run.strategy, run.vehicles) == ('default', 2)]
    ratio = sum(r.curve.time_to(0.99) for r in two) / sum(r.curve.time_to(0.99) for r in one)
    assert time_ratio(two, one) == pytest.approx(ratio)
    assert rows['default', '2'][HEADER.index('99 %: x of 1 vehicle')] == f'{ratio:.2f}'
    assert rows['nearest', '1'][HEADER.index('99 %: x of nearest')] == '1.00'
    assert markdown_table(runs).count('\n') == 6


def test_tables_and_pictures_are_written(small_study, tmp_path):
    _, runs = small_study
    paths = save_study(runs, tmp_path / 'out')
    assert [path.name for path in paths] == [
        'table.md', 'runs.csv', 'timings.csv', 'curves.json', 'coverage.png', 'times.png',
    ]  # fmt: skip
    assert all(path.stat().st_size > 100 for path in paths)
    assert paths[4].read_bytes()[:8] == b'\x89PNG\r\n\x1a\n'
    lines = (tmp_path / 'out' / 'runs.csv').read_text().splitlines()
    assert len(lines) == 1 + len(runs)
    assert set(lines[0].split(',')) == set(run_values(runs[0]))


def test_a_ratio_needs_common_seeds_and_runs_that_got_there(small_study):
    _, runs = small_study
    with pytest.raises(EvaluationError, match='no seed is in both'):
        time_ratio(runs[:1], [])
    assert math.isnan(time_ratio(runs[:1], runs[:1], fraction=1.01))
    with pytest.raises(EvaluationError, match='no runs'):
        save_study([], runs)


def test_wrong_studies_are_refused(tmp_path):
    path = tmp_path / 'none.pgm'
    with pytest.raises(ConfigError, match='strategy'):
        make_study(path, [1], ['fastest'], [0])
    with pytest.raises(EvaluationError, match='no seeds'):
        make_study(path, [1], ['default'], [])
    with pytest.raises(EvaluationError, match='team of 0'):
        make_study(path, [0], ['default'], [0])
    with pytest.raises(ConfigError, match='no_such'):
        make_study(path, [1], ['default'], [0], ['no_such=1'])
    with pytest.raises(EvaluationError, match='name=value'):
        make_study(path, [1], ['default'], [0], ['time_limit'])
    with pytest.raises(ExploreSlamError, match=r'none\.pgm'):
        list(run_study(make_study(path, [1], ['default'], [0])))
    with pytest.raises(ConfigError, match='strategy'):
        run(drawn_world(TWO_ROOMS), (1.5, 1.5, 0.0), strategy='fastest')
