import os
import select
import socket
import termios
import time

import pytest

from explore_slam.errors import SimulationError
from explore_slam.simulation.emulators.serial_line import SerialLine


class Echo:
    """Says back what it hears, and what it is told to say."""

    def __init__(self):
        self.baud = 9600
        self.heard = b''
        self.to_say = b''

    def receive(self, data, _now):
        self.heard += data
        self.to_say += data

    def transmit(self, _now):
        said, self.to_say = self.to_say, b''
        return said


@pytest.fixture
def line(tmp_path):
    with SerialLine(Echo(), tmp_path / 'port') as made:
        yield made


def opened(path, rate=termios.B9600):
    port = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    modes = termios.tcgetattr(port)
    modes[4] = modes[5] = rate
    termios.tcsetattr(port, termios.TCSANOW, modes)
    return port


def read(port, count, limit=3.0):
    data, end = b'', time.monotonic() + limit
    while len(data) < count and time.monotonic() < end:
        try:
            data += os.read(port, 4096)
        except BlockingIOError:
            time.sleep(0.002)
    return data


def test_bytes_take_their_time(line):
    port = opened(line.path)
    began = time.monotonic()
    os.write(port, bytes(range(240)))
    assert read(port, 240) == bytes(range(240))
    assert 0.24 <= time.monotonic() - began < 1.0  # 250 ms at 9600 Bd
    os.close(port)


def test_another_rate_is_garbage(line):
    port = opened(line.path, termios.B38400)
    os.write(port, b'hello, can you hear me?')
    assert read(port, 23, 0.5) != b'hello, can you hear me?'
    assert line.device.heard not in (b'', b'hello, can you hear me?')
    os.close(port)


def test_faults_hit_bytes_at_their_rate(line):
    port = opened(line.path)
    line.device.baud = 115200
    os.close(port)
    port = opened(line.path, termios.B115200)
    line.faults.drop_rate = 0.1
    line.device.to_say = b'x' * 4000
    assert 3300 < len(read(port, 4000, 1.5)) < 3900
    line.faults.drop_rate, line.faults.duplicate_rate = 0.0, 0.1
    line.device.to_say = b'x' * 4000
    assert 4100 < len(read(port, 4500, 1.5)) < 4700
    line.faults.duplicate_rate, line.faults.corrupt_rate = 0.0, 0.1
    line.device.to_say = b'x' * 4000
    data = read(port, 4000, 1.5)
    assert 100 < sum(byte != ord('x') for byte in data) < 700
    line.faults.silent = True
    os.write(port, b'?')
    assert read(port, 1, 0.2) == b''
    os.close(port)


def test_an_unplugged_port_is_dead_and_comes_back_under_its_name(line):
    port = opened(line.path)
    line.unplug()
    assert select.select([port], [], [], 5.0)[0]  # the kernel hangs up when it gets to it
    assert os.read(port, 1) == b''
    with pytest.raises(OSError, match='Input/output error'):
        os.write(port, b'?')
    os.close(port)
    assert not os.path.lexists(line.path)
    line.plug()
    port = opened(line.path)
    os.write(port, b'again')
    assert read(port, 5) == b'again'
    os.close(port)


def test_tcp_serves_one_client_after_another():
    with SerialLine(Echo(), tcp_port=0) as line:
        number = int(line.path.rsplit(':', 1)[1])
        for text in (b'one', b'two'):
            with socket.create_connection(('127.0.0.1', number), 2.0) as client:
                client.settimeout(2.0)
                client.sendall(text)
                assert client.recv(10) == text
        with pytest.raises(SimulationError, match=f'TCP port {number}: cannot listen'):
            SerialLine(Echo(), tcp_port=number).start()
