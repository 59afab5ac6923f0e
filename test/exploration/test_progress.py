"""Progress towards targets: what counts as getting nearer, and when a target has failed."""

import math

from explore_slam.exploration.progress import BlockageCounter, Progress


def test_only_a_path_that_gets_clearly_shorter_is_progress():
    progress = Progress(0.0)
    progress.update(5.0, 1.0, arrived=False, waiting=False)
    assert (progress.remaining, progress.since) == (5.0, 1.0)
    progress.update(4.95, 2.0, arrived=False, waiting=False)
    assert (progress.remaining, progress.since) == (5.0, 1.0)
    progress.update(4.8, 3.0, arrived=False, waiting=False)
    assert (progress.remaining, progress.since) == (4.8, 3.0)


def test_waiting_for_others_is_no_delay():
    progress = Progress(0.0)
    progress.update(5.0, 1.0, arrived=False, waiting=False)
    progress.update(6.0, 9.0, arrived=False, waiting=True)
    assert (progress.remaining, progress.since) == (5.0, 9.0)


def test_a_target_is_exhausted_after_three_cycles_there():
    progress = Progress(0.0)
    for cycle in range(3):
        assert not progress.exhausted
        progress.update(0.1, float(cycle), arrived=True, waiting=False)
    assert progress.exhausted


def test_another_path_may_be_longer_but_time_and_arrivals_go_on():
    progress = Progress(7.0, 3.0, 2)
    again = progress.restart()
    assert (again.since, again.remaining, again.arrivals) == (7.0, math.inf, 2)


def test_blockages_near_the_target_or_three_on_the_way_are_a_failure():
    counter = BlockageCounter()
    assert counter.add('a', near_target=True)
    assert not counter.add('a', near_target=False)
    assert not counter.add('a', near_target=False)
    assert not counter.add('b', near_target=False)
    assert counter.add('a', near_target=False)
    assert not counter.add('a', near_target=False)


def test_reset_forgets_the_blockages_of_one_vehicle():
    counter = BlockageCounter()
    for name in ('a', 'b'):
        counter.add(name, near_target=False)
        counter.add(name, near_target=False)
    counter.reset('a')
    assert not counter.add('a', near_target=False)
    assert counter.add('b', near_target=False)
