"""Stamps of other clocks are named with the amount."""

from explore_slam.messages.clocks import NamedProblems, StampProblem, StampWatch


def watch(**ahead):
    found = StampWatch()
    for topic, offset in ahead.items():
        for k in range(10):
            assert found.add(topic, 100.0 + 0.1 * k + offset, 100.0 + 0.1 * k)
    return found


def texts(found):
    return {topic: problem.text for topic, problem in found.problems('odom').items()}


def off(seconds):
    """Return the problems of scans that are ahead of odometry, or behind it."""
    return watch(odom=0.0, scan=seconds).problems('odom')


def test_one_clock_and_small_latencies_are_fine():
    assert texts(watch(odom=-0.02, scan=-0.15)) == {}


def test_a_topic_that_is_off_is_compared_with_odometry():
    assert texts(watch(odom=0.0, scan=30.0)) == {
        'scan': 'stamps are 30.0 s ahead of those of odom'
    }
    assert texts(watch(scan=-7.0)) == {'scan': 'stamps are 7.0 s behind the clock of this node'}


def test_a_vehicle_that_is_off_is_compared_with_the_clock():
    problems = texts(watch(odom=3600.0, scan=3599.9))
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
    assert texts(found) == {'scan': 'stamps are 30.0 s ahead of those of odom'}


def test_stamps_of_zero_are_counted_except_where_time_begins():
    found = StampWatch()
    assert not found.add('scan', 0.0, 1e9)
    assert texts(found)['scan'].startswith('1 messages have the stamp zero')
    simulated = StampWatch()
    assert simulated.add('scan', 0.0, 0.0)
    assert simulated.problems('odom') == {}


def test_a_problem_is_named_again_when_it_changes_or_returns():
    named = NamedProblems()
    assert named.news(off(30.0)) == ['scan: stamps are 30.0 s ahead of those of odom']
    assert named.news(off(30.0)) == []
    assert named.news(off(30.4)) == []
    assert len(named.news(off(-30.0))) == 1
    assert len(named.news(off(-300.0))) == 1
    assert named.news({}) == []
    assert len(named.news(off(-30.0))) == 1
    both = watch(odom=-2.0, scan=-32.0).problems('odom')
    assert named.news(both) == ['odom: stamps are 2.0 s behind the clock of this node']


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
    problem = {'/clock': StampProblem('no time has come', 'no time')}
    assert [len(named.news(problem)) for _ in range(3)] == [1, 0, 0]


def test_stamps_that_become_zero_are_named_instead_of_what_was_wrong_before():
    found = watch(odom=20.0)
    assert 'ahead' in texts(found)['odom']
    found.add('odom', 0.0, 102.0)
    assert 'have the stamp zero' in texts(found)['odom']
