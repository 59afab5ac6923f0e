"""The handshake with ARCOS: SYNC 0, 1, 2, sessions left open, and who else may be at the port."""

import logging
import time

from explore_slam.vehicle.arcos_packets import Command, PacketDecoder, encode_command
from explore_slam.vehicle.arcos_status import RobotIdentity, parse_identity, parse_status
from explore_slam.vehicle.lms200_telegrams import TelegramDecoder
from explore_slam.vehicle.serial_port import SerialPort

_log = logging.getLogger(__name__)
_REPLY_TIMEOUT = 0.25  # s for an echo of the handshake
_SYNC_ATTEMPTS = 3


def shake_hands(port: SerialPort, decoder: PacketDecoder) -> tuple[RobotIdentity | None, bytes]:
    """Shake hands at the present rate; return identity or None, and the bytes that came."""
    port.discard()
    decoder.clear()
    step, failures, heard = 0, 0, b''
    while failures < _SYNC_ATTEMPTS:
        port.write(encode_command(step))
        reply, came = _await_echo(port, decoder, step)
        heard = (heard + came)[-4096:]
        if reply == 'session':  # of a client that crashed
            _log.info('%s: closing a session left open', port.url)
            port.write(encode_command(Command.CLOSE))
            time.sleep(0.1)
            port.discard()
            decoder.clear()
            step, failures = 0, failures + 1
        elif isinstance(reply, bytes):
            if step == 2:
                return parse_identity(reply), heard
            step += 1
        else:
            step, failures = 0, failures + 1
            if not came and failures == 2:
                break  # nothing at all twice: another rate, or nobody
    return None, heard


def _await_echo(port: SerialPort, decoder: PacketDecoder, step: int) -> tuple[bytes | str, bytes]:
    """Return the echo of a sync step, 'session', 'lost' or 'silent', and what came."""
    end = time.monotonic() + _REPLY_TIMEOUT + port.transmission_time(80)
    heard = b''
    while (left := end - time.monotonic()) > 0.0:
        data = port.read(left)
        heard += data
        for payload in decoder.feed(data):
            if payload[0] == step:
                return payload, heard
            if parse_status(payload) is not None:
                return 'session', heard
            if payload[0] == 255:
                return 'lost', heard
    return 'silent', heard


def who_is_there(heard: bytes, rates: list[int]) -> str:
    """Return why no robot was found, from the bytes that came instead of its answers."""
    asked = '/'.join(str(rate) for rate in rates)
    if TelegramDecoder().feed(heard):
        return 'a SICK laser is at this port, not a robot; exchange base_port and laser_port'
    if heard:
        return (
            f'{len(heard)} bytes came at {asked} Bd but no answer to SYNC; '
            'is another device at this port, or base_baud wrong?'
        )
    return f'no answer to SYNC at {asked} Bd; is the robot switched on and its cable plugged in?'
