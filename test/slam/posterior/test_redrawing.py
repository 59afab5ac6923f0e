"""Redraws beside the updates: samples drawn in another thread are taken at the next update."""

from concurrent.futures import Future
from threading import Event

import numpy as np
import pytest

from explore_slam.geometry import Pose2
from explore_slam.slam import FastSlam
from explore_slam.slam.posterior import redrawing

STARTS = {'a': Pose2(1.0, 1.0, 0.0), 'b': Pose2(5.0, 4.0, 1.0)}
BESIDE = {'async_redraw_threshold': 0, 'redraw_ancestors': 120, 'redraw_fraction': 0.6}


class Late:
    """Runs what is submitted when its result is asked for."""

    def submit(self, call, *arguments):
        class Result(Future):
            def result(self):
                return call(*arguments)

        return Result()


class Early:
    """Runs what is submitted at once."""

    def submit(self, call, *arguments):
        future = Future()
        future.set_result(call(*arguments))
        return future


class Held(Late):
    """Runs what is submitted in the real thread, once it is let go."""

    def __init__(self):
        self.go = Event()
        self.real = redrawing._executor()

    def submit(self, call, *arguments):
        def held():
            assert self.go.wait(60.0)
            return call(*arguments)

        return self.real.submit(held)


def same(one, other):
    a, b = one.state_dict(), other.state_dict()
    assert a.keys() == b.keys()
    return [name for name in a if not np.array_equal(a[name], b[name])] == []


@pytest.fixture
def in_flight(make_world, make_slam, monkeypatch):
    """Return a filter whose redraw waits, its world, the step it is at, and what holds it."""
    world = make_world()
    slam = make_slam(world.start(**STARTS), **BESIDE)
    held = Held()
    monkeypatch.setattr(redrawing, '_executor', lambda: held)
    for step in range(60):
        for i, vehicle in enumerate(slam.vehicles):
            increment = Pose2(0.4, 0.0, 0.3 if i == 0 else -0.3)
            world.drive(vehicle, increment)
            slam.predict(vehicle, increment, 1e-4 * np.eye(3))
            before = slam.redraws
            slam.update(vehicle, world.see(vehicle, float(step)))
            if slam._redrawer._pending is not None:
                yield slam, world, step, held, before
                held.go.set()
                return
    pytest.fail('no redraw was due')


@pytest.mark.parametrize('seed', [0, 1])
def test_results_do_not_depend_on_when_the_thread_is_done(
    make_world, make_slam, drive_circles, monkeypatch, seed
):
    filters = []
    for executor in (Late(), Early(), redrawing._executor()):
        monkeypatch.setattr(redrawing, '_executor', lambda executor=executor: executor)
        world = make_world(seed)
        slam = make_slam(world.start(**STARTS), seed, **BESIDE)
        drive_circles(slam, world, 25)
        filters.append(slam)
    assert filters[0].redraws >= 8
    assert same(filters[0], filters[1])
    assert same(filters[0], filters[2])


def test_an_update_does_not_wait_and_the_next_one_takes_the_samples(in_flight):
    slam, world, step, held, draws = in_flight
    pending = slam._redrawer._pending
    pose = slam.estimate('a')[0]
    path, particles = slam.best_path(), slam.particle_poses('a')
    slam.add_keyframe('a', step + 0.1)
    slam.landmarks()
    assert slam.redraws == draws
    assert not pending.samples.done()
    np.testing.assert_array_equal(slam.particle_poses('a'), particles)
    np.testing.assert_array_equal(slam.best_path()[: len(path)], path)
    # motion goes on meanwhile, and is not lost
    increment = Pose2(0.4, 0.0, 0.3)
    world.drive('a', increment)
    slam.predict('a', increment, 1e-4 * np.eye(3))
    assert slam.estimate('a')[0] == pytest.approx(pose.compose(increment), abs=0.05)
    held.go.set()
    summary = slam.update('a', world.see('a', step + 1.0))
    assert summary.redrawn
    assert slam.redraws >= draws + 1
    assert np.abs(world.error('a', slam.estimate('a')[0])[:2]).max() < 0.3


def test_a_checkpoint_during_a_redraw_continues_exactly(in_flight, drive_circles):
    slam, world, step, held, draws = in_flight
    held.go.set()
    state = slam.state_dict()
    assert slam.redraws == draws + 1
    restored = FastSlam.from_state(state)
    random = world.random.bit_generator.state
    true = dict(world.true)
    ends = []
    for continued in (slam, restored):
        world.random.bit_generator.state, world.true = random, dict(true)
        drive_circles(continued, world, 10, step + 1)
        ends.append(continued)
    assert same(*ends)


@pytest.mark.parametrize(
    'call',
    [
        lambda slam: slam.set_pose('a', Pose2(9.0, 9.0, 1.0), 1e-4 * np.eye(3)),
        lambda slam: slam.displace('b', 1e-2 * np.eye(3)),
        lambda slam: slam.redraw([0]),
        lambda slam: slam.resample_now(),
    ],
    ids=['set_pose', 'displace', 'redraw', 'resample_now'],
)
def test_whatever_changes_the_paths_completes_the_redraw_first(in_flight, call):
    slam, world, step, held, draws = in_flight
    held.go.set()
    call(slam)
    assert slam.redraws >= draws + 1
    for vehicle in slam.vehicles:
        slam.predict(vehicle, Pose2(0.0, 0.0, 0.0), 1e-8 * np.eye(3))
        slam.update(vehicle, world.see(vehicle, step + 1.0))
    assert np.abs(world.error('b', slam.estimate('b')[0])[:2]).max() < 0.3


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_paths_redrawn_beside_the_updates_are_as_accurate(
    make_world, make_slam, drive_circles, seed
):
    errors = {}
    for beside in (0, 10_000_000):
        world = make_world(seed)
        slam = make_slam(
            world.start(**STARTS), seed, **(BESIDE | {'async_redraw_threshold': beside})
        )
        found = drive_circles(slam, world, 60)[20:, :, :2]
        errors[beside] = float(np.sqrt((found**2).sum(axis=2).mean()))
        assert slam.redraws > 10
    assert errors[0] < 1.25 * errors[10_000_000] + 0.01, errors
