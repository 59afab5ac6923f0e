"""The queue of the agent's worker: order, limits, what goes ahead, and how long things wait."""

import threading

import pytest

from explore_slam.nodes import agent_statistics, inbox
from explore_slam.nodes.agent_statistics import explain_delay
from explore_slam.nodes.inbox import Inbox


@pytest.fixture
def clock(monkeypatch):
    """Let a test say what time (s) it is."""
    now = [100.0]
    monkeypatch.setattr(inbox.time, 'monotonic', lambda: now[0])
    return now


def filled(**options):
    made = Inbox({'scan': 3, 'odometry': 10, 'report': 2}, **options)
    for number in range(5):
        made.put('scan', 'robot1', print, number)
        made.put('odometry', 'robot1', print, number)
        made.put('scan', 'robot2', print, number)
    return made


def drained(made):
    items = []
    while len(made):
        items.append(made.get(0.0))
    return [(item.kind, item.source, item.payload) for item in items]


def test_measurements_keep_their_order_and_the_oldest_is_dropped():
    made = filled()
    assert made.dropped == {('scan', 'robot1'): 2, ('scan', 'robot2'): 2}
    items = drained(made)
    assert [i[2] for i in items if i[:2] == ('scan', 'robot1')] == [2, 3, 4]
    assert [i[2] for i in items if i[0] == 'odometry'] == [0, 1, 2, 3, 4]
    assert items[0] == ('odometry', 'robot1', 0)
    assert made.get(0.0) is None


def test_requests_go_ahead_of_measurements_in_their_own_order():
    made = filled(prompt=('report',))
    for number in range(4):
        made.put('request', f'pause {number}', print, None)
        made.put('report', 'robot1', print, number)
    ahead = drained(made)[:6]
    assert [source for kind, source, _ in ahead if kind == 'request'] == [
        f'pause {number}' for number in range(4)
    ]
    assert [number for kind, _, number in ahead if kind == 'report'] == [2, 3]


def test_waiting_measurements_can_be_taken_out():
    made = filled()
    made.put('pose', 'robot1', print, None)
    taken = made.take_out('robot1', 'odometry')
    assert [item.payload for item in taken] == [0, 1, 2, 3, 4]
    assert {(i.kind, i.source) for i in made.take_out('robot1')} == {('scan', 'robot1')}
    assert made.waiting() == {('pose', 'robot1'): 1, ('scan', 'robot2'): 3}
    for number in range(3):  # the limit counts what waits
        made.put('scan', 'robot1', print, number)
    assert made.dropped['scan', 'robot1'] == 2
    assert len(made.take_out()) == 6
    assert [item[0] for item in drained(made)] == ['pose']


def test_a_backlog_is_named(clock):
    made = filled()
    made.put('request', 'pause', print, None)
    assert made.delay == 0.0
    clock[0] += agent_statistics.BEHIND
    assert explain_delay(made) == ''
    clock[0] += 1.0
    assert made.delay == pytest.approx(3.0)
    text = explain_delay(made)
    assert 'the agent is 3.0 s behind its measurements' in text
    assert 'robot1 odometry 5' in text
    assert 'robot2 scan 3' in text
    made.take_out()
    assert (made.delay, explain_delay(made)) == (0.0, '')


def test_a_closed_inbox_wakes_who_waits():
    made = Inbox({})
    got = []
    thread = threading.Thread(target=lambda: got.append(made.get(60.0)))
    thread.start()
    made.close()
    thread.join(timeout=10.0)
    assert got == [None]
    assert made.closed
