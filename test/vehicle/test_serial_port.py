import errno

import pytest

from explore_slam.errors import VehicleError
from explore_slam.simulation.emulators.serial_line import SerialLine
from explore_slam.vehicle.serial_port import SerialPort, _advice


class Quiet:
    """A device that says nothing."""

    baud = 38400

    def receive(self, data, now):
        """Hear nothing."""

    def transmit(self, _now):
        return b''


@pytest.mark.parametrize(
    ('number', 'text'),
    [
        (errno.EACCES, 'no permission; add the user to the group'),
        (errno.EBUSY, 'busy; another program uses it'),
        (errno.ENOTTY, 'cannot be opened as a serial line'),
    ],
)
def test_each_failure_says_what_to_do(number, text):
    assert text in _advice('/dev/null', OSError(number, 'refused'))


def test_rates_and_times_on_the_line(tmp_path):
    with SerialLine(Quiet(), tmp_path / 'port') as line:
        port = SerialPort(line.path, 9600)
        assert port.transmission_time(96) == pytest.approx(0.1)
        port.set_baud(38400)
        assert port.baud == 38400
        assert port.read(0.01) == b''
        port.close()
        port.close()
        with pytest.raises(VehicleError, match='lost'):
            port.write(b'?')
