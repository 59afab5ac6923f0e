"""Messages come by stamp, whatever the order they were logged in."""

import struct

from hypothesis import given
from hypothesis import strategies as st

from explore_slam.recording.ordering import WINDOW, StampOrder, header_stamp
from explore_slam.recording.storage.storage import RawMessage

SECOND = 10**9


def message(stamp: int, log_time: int, topic: str = '/a/odom') -> RawMessage:
    seconds, nanoseconds = divmod(stamp, SECOND)
    data = b'\x00\x01\x00\x00' + struct.pack('<iI', seconds, nanoseconds)
    return RawMessage(topic, 'nav_msgs/msg/Odometry', log_time, data)


def test_reads_the_stamp_of_either_byte_order():
    assert header_stamp(b'\x00\x01\x00\x00' + struct.pack('<iI', 5, 7)) == 5 * SECOND + 7
    assert header_stamp(b'\x00\x00\x00\x00' + struct.pack('>iI', 5, 7)) == 5 * SECOND + 7
    assert header_stamp(b'\x00\x01') is None


@given(st.lists(st.integers(0, WINDOW - 1), max_size=50), st.integers(0, 10**18))
def test_delays_within_the_window_are_undone(delays, offset):
    stamps = [SECOND + index * SECOND // 10 for index in range(len(delays))]
    logged = sorted(
        (message(s, s + d + offset) for s, d in zip(stamps, delays, strict=True)),
        key=lambda m: m.log_time,
    )
    order = StampOrder()
    assert [stamp for stamp, _ in order.sort(logged)] == stamps
    assert order.late == {}
    assert order.clock_jumps == []


def test_what_comes_too_late_is_counted():
    logged = [message(10 * SECOND + i * SECOND, i * SECOND) for i in range(6)]
    logged.append(message(11 * SECOND, 6 * SECOND, '/a/scan'))
    order = StampOrder()
    found = [stamp // SECOND for stamp, _ in order.sort(logged)]
    assert found == [10, 11, 12, 13, 14, 15]
    assert order.late == {'/a/scan': 1}


def test_a_clock_that_jumps_back_starts_again():
    logged = [message(100 * SECOND, 0), message(101 * SECOND, SECOND)]
    logged += [message(1 * SECOND, 2 * SECOND), message(2 * SECOND, 3 * SECOND)]
    order = StampOrder()
    assert [stamp // SECOND for stamp, _ in order.sort(logged)] == [100, 101, 1, 2]
    assert order.clock_jumps == [(101.0, 1.0)]
    assert order.notes()[0] == 'the recorded clock jumps back from 101.000 s to 1.000 s'


def test_clock_jumps_are_one_note_with_their_number():
    stamps = [100, 101, 1, 2, 90, 91, 5, 6]
    order = StampOrder()
    list(order.sort([message(s * SECOND, k * SECOND) for k, s in enumerate(stamps)]))
    note = 'the recorded clock jumps back from 101.000 s to 1.000 s, the first of 2 jumps'
    assert order.notes()[0] == note


def test_data_without_a_header_are_counted():
    order = StampOrder()
    short = RawMessage('/a/scan', 'sensor_msgs/msg/LaserScan', 0, b'\x00\x01')
    assert list(order.sort([short])) == []
    assert order.malformed == {'/a/scan': 1}


def test_topics_without_stamps_get_the_log_time():
    stamped = [message(100 * SECOND + i * SECOND, 100 * SECOND + i * SECOND) for i in range(5)]
    zero = [message(0, m.log_time + 1, '/a/scan') for m in stamped]
    merged = [m for pair in zip(stamped, zero, strict=True) for m in pair]
    order = StampOrder()
    found = [(m.topic, stamp) for stamp, m in order.sort(merged)]
    assert found == [(m.topic, m.log_time) for m in merged]
    assert order.notes() == [
        '5 of 5 messages on /a/scan have the stamp zero: the log time is used'
    ]


def test_simulated_time_may_begin_at_zero():
    logged = [message(i * SECOND, i * SECOND) for i in range(5)]
    order = StampOrder()
    assert [stamp for stamp, _ in order.sort(logged)] == [i * SECOND for i in range(5)]
    assert order.notes() == []


def test_a_clock_of_one_topic_that_is_off_is_one_note_with_the_amount():
    logged = []
    for i in range(100):
        at = 1000 * SECOND + i * SECOND // 10
        logged += [message(at, at), message(at + 30 * SECOND, at + 1, '/a/scan')]
    order = StampOrder()
    assert len(list(order.sort(logged))) == 200
    assert order.clock_jumps == []
    (note,) = order.notes()
    assert note.startswith('stamps on /a/scan are 30.000 s ahead of those on /a/odom')
    # with the offset all is well
    corrected = StampOrder(offsets={'/a/scan': -30 * SECOND})
    stamps = [stamp for stamp, _ in corrected.sort(logged)]
    assert stamps == sorted(stamps)
    assert corrected.notes() == []


def test_stamps_that_go_back_are_one_note_with_the_amount():
    stamps = [10, 11, 12, 11, 13, 14, 13, 15]
    logged = [message(s * SECOND // 10, k * SECOND // 10) for k, s in enumerate(stamps)]
    order = StampOrder()
    assert len(list(order.sort(logged))) == len(stamps)
    assert order.notes() == ['stamps on /a/odom go back 2 times, by up to 0.100 s']
