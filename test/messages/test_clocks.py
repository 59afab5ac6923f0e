"""Stamps of other clocks are named with the amount."""

from explore_slam.messages.clocks import NamedProblems, StampWatch


def watch(**ahead):
    found = StampWatch()
    for topic, offset in ahead.items():
        for k in range(10):
            assert found.add(topic, 100.0 + 0.1 * k + offset, 100.0 + 0.1 * k)
    return found


def test_one_clock_and_small_latencies_are_fine():
    assert watch(odom=-0.02, scan=-0.15).problems('odom') == {}


def test_a_topic_that_is_off_is_compared_with_odometry():
    assert watch(odom=0.0, scan=30.0).problems('odom') == {
        'scan': 'stamps are 30.0 s ahead of those of odom'
    }
    assert watch(scan=-7.0).problems('odom') == {
        'scan': 'stamps are 7.0 s behind the clock of this node'
    }


def test_a_vehicle_that_is_off_is_compared_with_the_clock():
    problems = watch(odom=3600.0, scan=3599.9).problems('odom')
    assert problems['odom'] == 'stamps are 3600.0 s ahead of the clock of this node'
    assert problems['scan'] == 'stamps are 3599.9 s ahead of the clock of this node'


def test_one_late_message_is_no_other_clock():
    found = watch(odom=0.0)
    found.add('odom', 50.0, 101.0)
    assert found.problems('odom') == {}


def test_a_burst_of_late_messages_does_not_change_the_amount():
    found = StampWatch()
    for k in range(5):
        found.add('odom', 100.0 + 0.1 * k, 100.4)
        found.add('scan', 130.0 + 0.1 * k, 100.0 + 0.1 * k)
    assert found.problems('odom') == {'scan': 'stamps are 30.0 s ahead of those of odom'}


def test_stamps_of_zero_are_counted_except_where_time_begins():
    found = StampWatch()
    assert not found.add('scan', 0.0, 1e9)
    assert found.problems('odom')['scan'].startswith('1 messages have the stamp zero')
    simulated = StampWatch()
    assert simulated.add('scan', 0.0, 0.0)
    assert simulated.problems('odom') == {}


def test_a_problem_is_named_again_when_it_changes_or_returns():
    named = NamedProblems()
    ahead = {'scan': 'stamps are 30.0 s ahead of those of odom'}
    assert named.news(ahead) == ['scan: stamps are 30.0 s ahead of those of odom']
    assert named.news(ahead) == []
    assert named.news({'scan': 'stamps are 30.4 s ahead of those of odom'}) == []
    behind = {'scan': 'stamps are 30.0 s behind those of odom'}
    assert len(named.news(behind)) == 1
    assert len(named.news({'scan': 'stamps are 300.0 s behind those of odom'})) == 1
    assert named.news({}) == []
    assert len(named.news(behind)) == 1
    assert (
        len(named.news({**behind, 'odom': 'stamps are 2.0 s behind the clock of this node'})) == 1
    )


def test_messages_without_stamp_are_named_once_however_many_come():
    named = NamedProblems()
    found = StampWatch()
    news = []
    for k in range(200):
        found.add('scan', 0.0, 1e9 + k)
        news += named.news(found.problems('odom'))
    assert news == ['scan: 1 messages have the stamp zero; the time of receipt is used']


def test_a_problem_without_an_amount_is_named_once():
    named = NamedProblems()
    problem = {'/clock': 'use_sim_time is true, but no time has come'}
    assert [len(named.news(problem)) for _ in range(3)] == [1, 0, 0]


def test_stamps_that_become_zero_are_named_instead_of_what_was_wrong_before():
    found = watch(odom=20.0)
    assert 'ahead' in found.problems('odom')['odom']
    found.add('odom', 0.0, 102.0)
    assert 'have the stamp zero' in found.problems('odom')['odom']
