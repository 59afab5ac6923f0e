import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from explore_slam.vehicle.arcos_packets import (
    BAUD_CODES,
    RATE_CHANGE_DELAY,
    RATE_CHANGE_TIMEOUT,
    Command,
    PacketDecoder,
    checksum,
    decode_command,
    encode_command,
    encode_packet,
)

PAYLOADS = st.binary(min_size=1, max_size=198)


def slow_checksum(payload):
    """The manual's routine, byte pair by byte pair."""
    total, n = 0, len(payload)
    for i in range(0, n - 1, 2):
        total = (total + (payload[i] << 8 | payload[i + 1])) & 0xFFFF
    return total ^ payload[-1] if n % 2 else total


@given(PAYLOADS)
def test_checksum_is_that_of_the_manual(payload):
    assert checksum(payload) == slow_checksum(payload)


def test_known_packets():
    assert encode_command(0) == bytes.fromhex('fafb03000000')
    assert encode_command(1) == bytes.fromhex('fafb03010001')
    assert encode_command(Command.CLOSE) == bytes.fromhex('fafb03020002')
    assert encode_command(Command.PULSE) == bytes.fromhex('fafb03000000')
    assert encode_command(Command.ENABLE, 1) == bytes.fromhex('fafb06043b0100053b')
    assert encode_command(Command.VEL, -300)[3:7] == bytes([11, 0x1B, 0x2C, 0x01])


@given(st.integers(0, 255), st.integers(-65535, 65535))
def test_integer_arguments_round_trip(command, argument):
    [payload] = PacketDecoder().feed(encode_command(command, argument))
    assert decode_command(payload) == (command, argument)


def test_string_arguments_round_trip():
    [payload] = PacketDecoder().feed(encode_command(15, b'hello'))
    assert decode_command(payload) == (15, b'hello')


@given(st.binary(max_size=60))
def test_any_payload_decodes_as_a_command(data):
    decode_command(b'\x0b' + data)


def test_payloads_that_fit_no_packet_are_refused():
    for payload in (b'', bytes(199)):
        with pytest.raises(ValueError, match='expected 1 to 198'):
            encode_packet(payload)


@given(st.lists(PAYLOADS, max_size=5), st.lists(st.integers(1, 50), min_size=1, max_size=9))
def test_packets_are_found_however_the_bytes_are_cut(payloads, cuts):
    stream = b''.join(map(encode_packet, payloads))
    decoder, found, at = PacketDecoder(), [], 0
    while at < len(stream):
        for cut in cuts:
            found += decoder.feed(stream[at : at + cut])
            at += cut
    assert found == payloads
    assert decoder.rejected == 0


@settings(max_examples=400)
@given(st.binary(max_size=300) | st.lists(st.sampled_from([0xFA, 0xFB, 3, 200])).map(bytes))
def test_after_garbage_the_next_packets_are_found(garbage):
    decoder = PacketDecoder()
    decoder.feed(garbage)
    assert decoder.pending <= 203
    valid = [encode_packet(bytes([0x32, k, 255 - k] * 9)) for k in range(12)]
    found = decoder.feed(b''.join(valid))
    # garbage that looks like the head of a packet holds back at most 200 bytes
    assert found[-5:] == [encode[3:-2] for encode in valid[-5:]]
    assert decoder.pending == 0


def test_doubled_header_byte_is_no_obstacle():
    packet = encode_packet(b'\x32abc')
    assert PacketDecoder().feed(b'\xfa' + packet) == [b'\x32abc']
    assert PacketDecoder().feed(b'\xfa\xfb' + packet * 40)[-1] == b'\x32abc'


def test_a_corrupted_packet_hides_no_other():
    good = encode_packet(b'\x33' + bytes(range(40)))
    bad = bytearray(good)
    bad[10] ^= 0x40
    decoder = PacketDecoder()
    assert len(decoder.feed(good + bytes(bad) + good)) == 2
    assert decoder.rejected == 1


def test_commands_and_rates_are_those_of_the_manual():
    assert {command.name: command.value for command in Command} == {
        'PULSE': 0, 'OPEN': 1, 'CLOSE': 2, 'ENABLE': 4, 'SETA': 5, 'SETV': 6, 'SETO': 7,
        'SETRV': 10, 'VEL': 11, 'CONFIG': 18, 'RVEL': 21, 'SETRA': 23, 'SONAR': 28, 'STOP': 29,
        'VEL2': 32, 'BUMPSTALL': 44, 'HOSTBAUD': 50, 'ESTOP': 55, 'BATTERYINFO': 62,
        'REVCOUNT': 88, 'DRIFTFACTOR': 89, 'TICKSMM': 93,
    }  # fmt: skip
    assert BAUD_CODES == {9600: 0, 19200: 1, 38400: 2, 57600: 3, 115200: 4}
    assert (RATE_CHANGE_DELAY, RATE_CHANGE_TIMEOUT) == (0.01, 0.9)
