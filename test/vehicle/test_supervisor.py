import logging
import time

import pytest

from explore_slam.errors import VehicleError
from explore_slam.vehicle import Supervisor


class Flaky:
    """A device that fails when it is told to."""

    def __init__(self):
        self.failure = None
        self.calls = []

    def connect(self):
        self.calls.append('connect')
        if self.failure:
            raise self.failure
        return 'device 7'

    def poll(self, timeout):
        assert timeout > 0.0
        time.sleep(0.01)
        if self.failure:
            raise self.failure
        return [len(self.calls)]

    def close(self):
        self.calls.append('close')


@pytest.fixture
def running():
    device, records = Flaky(), []
    part = Supervisor('laser', device, records.append, retry_after=0.05)
    yield device, records, part
    part.stop()


def wait(condition, seconds=3.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return condition()


def test_records_come_and_the_end_closes(running):
    device, records, part = running
    part.start()
    assert wait(lambda: len(records) > 3)
    assert part.health.connected
    assert part.health.message == 'device 7'
    part.stop()
    assert device.calls[-1] == 'close'
    assert not part.health.connected


@pytest.mark.parametrize('failure', [VehicleError('no such port'), RuntimeError('a bug')])
def test_a_failure_is_told_once_and_tried_again(running, caplog, failure):
    device, records, part = running
    device.failure = failure
    with caplog.at_level(logging.INFO):
        part.start()
        assert wait(lambda: part.health.attempts >= 3)
        told = [r for r in caplog.records if r.levelno == logging.ERROR]
        assert len(told) == 1
        assert str(failure) in told[0].getMessage()
        assert str(failure) in part.health.message
        device.failure = None
        assert wait(lambda: bool(records))
        device.failure = failure
        assert wait(lambda: part.health.losses == 1)
        device.failure = None
        count = len(records)
        assert wait(lambda: len(records) > count)
        assert part.health.connected
