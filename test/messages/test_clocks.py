"""Stamps of other clocks are named with the amount."""

from explore_slam.messages.clocks import StampWatch


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


def test_stamps_of_zero_are_counted_except_where_time_begins():
    found = StampWatch()
    assert not found.add('scan', 0.0, 1e9)
    assert found.problems('odom')['scan'].startswith('1 messages have the stamp zero')
    simulated = StampWatch()
    assert simulated.add('scan', 0.0, 0.0)
    assert simulated.problems('odom') == {}
