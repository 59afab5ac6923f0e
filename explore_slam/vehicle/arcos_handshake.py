"""Handshake with ARCOS (SYNC 0, 1, 2), and a diagnosis of what else answers at the port.

Source: Pioneer 3 operations manual, "Client-Server Communication"; the sequence of retries was
chosen on emulated lines with byte errors (benchmarks/vehicle_faults.py).
"""

import logging
import time

from explore_slam.vehicle.arcos_packets import Command, PacketDecoder, encode_command
from explore_slam.vehicle.arcos_status import RobotIdentity, parse_identity, parse_status
from explore_slam.vehicle.lms200_telegrams import Request, TelegramDecoder, encode_telegram
from explore_slam.vehicle.serial_port import SerialPort

_log = logging.getLogger(__name__)
_REPLY_TIMEOUT = 0.25  # s for an echo of the handshake
_SYNC_ATTEMPTS = 3
_CLOSE_TIME = 0.1  # s, a status period: the robot has ended its session by then
_LONGEST_ECHO = 80  # bytes: the reply to SYNC2 with name, class and subclass
_LOST_COUNT = 255  # id of the reply with which the robot asks to start again at SYNC0
LASER_RATES = (9600, 19200, 38400)  # Bd, of a laser at this port by mistake
FAST_LASER_RATE = 500_000  # Bd, of a laser only
_LASER_TIMEOUT = 0.2  # s; it acknowledges within 60 ms
_KEPT = 4096  # bytes kept for the diagnosis


def shake_hands(port: SerialPort, decoder: PacketDecoder) -> tuple[RobotIdentity | None, bytes]:
    """Synchronize at the present baud rate.

    Returns the identity of the robot, None if none answered, and the bytes received. A session
    that another client left open is closed first.
    """
    port.discard()
    decoder.clear()
    step, failures, collected = 0, 0, b''
    while failures < _SYNC_ATTEMPTS:
        port.write(encode_command(step))
        reply, received = _await_echo(port, decoder, step)
        collected = (collected + received)[-_KEPT:]
        if reply == 'session':  # of a client that crashed
            _log.info('%s: closing a session left open', port.url)
            port.write(encode_command(Command.CLOSE))
            time.sleep(_CLOSE_TIME)
            port.discard()
            decoder.clear()
            step, failures = 0, failures + 1
        elif isinstance(reply, bytes):
            if step == 2:
                return parse_identity(reply), collected
            step += 1
        else:
            step, failures = 0, failures + 1
            if not received and failures == 2:
                break  # twice nothing at all: another baud rate, or no device
    return None, collected


def _await_echo(port: SerialPort, decoder: PacketDecoder, step: int) -> tuple[bytes | str, bytes]:
    """Return the reply to a SYNC step and the bytes received.

    The reply is the echo, or 'session' (open, status packets come), 'lost' (the robot lost count)
    or 'silent'.
    """
    end = time.monotonic() + _REPLY_TIMEOUT + port.transmission_time(_LONGEST_ECHO)
    collected = b''
    while (left := end - time.monotonic()) > 0.0:
        data = port.read(left)
        collected += data
        for payload in decoder.feed(data):
            if payload[0] == step:
                return payload, collected
            if parse_status(payload) is not None:
                return 'session', collected
            if payload[0] == _LOST_COUNT:
                return 'lost', collected
    return 'silent', collected


def is_laser(collected: bytes) -> bool:
    """Return whether bytes hold a telegram of a SICK laser."""
    return bool(TelegramDecoder().feed(collected))


def ask_for_laser(port: SerialPort) -> bytes:
    """Return what a SICK laser at this port, which SYNC leaves silent, replies."""
    received = b''
    for _ in range(2):  # it may take the first request for the rest of a broken telegram
        port.write(encode_telegram(Request.TYPE))
        end = time.monotonic() + _LASER_TIMEOUT
        while (left := end - time.monotonic()) > 0.0 and not is_laser(received):
            received += port.read(left)
    return received


def diagnose_port(collected: bytes, rates: list[int]) -> str:
    """Explain why no robot was found at these baud rates, from the bytes received instead."""
    asked = '/'.join(str(rate) for rate in rates)
    if is_laser(collected):
        return 'a SICK laser is at this port, not a robot; swap base_port and laser_port'
    if collected:
        return (
            f'{len(collected)} bytes received at {asked} Bd but no reply to SYNC; '
            'is another device at this port, or base_baud wrong?'
        )
    return f'no reply to SYNC at {asked} Bd; is the robot switched on and its cable plugged in?'
