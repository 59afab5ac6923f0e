"""Keep-out zones: expiry, permanence, walls, releases for trapped vehicles."""

import math

import numpy as np
import pytest

from explore_slam.exploration.keep_out import KeepOutZones

PLACE = (2.0, 1.0)


@pytest.fixture
def zones():
    made = KeepOutZones()
    made.add(PLACE, 100.0, [])
    return made


def test_a_zone_expires_after_a_minute(zones):
    zones.expire(159.9)
    assert zones.places() == [PLACE]
    zones.expire(160.0)
    assert zones.places() == []


def test_a_place_that_blocks_again_is_avoided_for_good(zones):
    zones.expire(200.0)
    zones.add((2.3, 1.2), 300.0, [])
    zones.add((2.0, 5.0), 300.0, [])
    zones.expire(1e9)
    assert zones.places() == [(2.3, 1.2)]


def test_another_vehicle_in_the_way_makes_no_zone():
    for distance, made in ((1.4, 0), (1.6, 1)):
        zones = KeepOutZones()
        zones.add(PLACE, 0.0, [(9.0, 9.0), (2.0 + distance, 1.0)])
        assert len(zones.places()) == made


def permanent(*places):
    zones = KeepOutZones()
    for place in places:
        zones.add(place, 0.0, [])
        zones.add(place, 1.0, [])
    zones.expire(1e9)
    return zones


def test_between_permanent_zones_near_each_other_there_is_a_wall():
    wall = np.array(permanent((0.0, 0.0), (0.8, 0.6)).places())
    assert len(wall) == 2 + 3
    at = np.sort(np.linalg.norm(wall, axis=1))
    np.testing.assert_allclose(at, [0.0, 0.3, 0.6, 0.9, 1.0])
    np.testing.assert_allclose(wall[:, 0] * 0.6, wall[:, 1] * 0.8, atol=1e-12)
    assert len(permanent((0.0, 0.0), (1.1, 0.0)).places()) == 2


def test_temporary_zones_can_be_released_and_are_remembered(zones):
    assert zones.release_temporary()
    assert not zones.release_temporary()
    zones.add(PLACE, 110.0, [])
    assert not zones.release_temporary()
    assert zones.places() == [PLACE]


def test_zones_around_a_trapped_vehicle_are_released_a_few_times_only():
    zones = permanent((0.0, 0.0), (1.9, 0.0), (-2.1, 0.0))
    assert zones.release_around('a', (0.0, 0.0))
    assert zones.places() == [(-2.1, 0.0)]
    assert not zones.release_around('a', (0.0, 0.0))
    for _ in range(4):
        zones.add((0.5, 0.0), 0.0, [])
        assert zones.release_around('a', (0.0, 0.0))
    zones.add((0.5, 0.0), 0.0, [])
    assert not zones.release_around('a', (0.0, 0.0))
    assert not zones.release_around('a', (1.0, 0.0))
    assert zones.release_around('b', (0.0, 0.0))


def test_releases_are_counted_anew_elsewhere():
    zones = KeepOutZones()
    for _ in range(5):
        zones.add(PLACE, 0.0, [])
        assert zones.release_around('a', PLACE)
    for distance, released in ((7.9, False), (8.1, True)):
        place = (PLACE[0] + distance, PLACE[1])
        zones.add(place, 0.0, [])
        assert zones.release_around('a', place) is released


def test_a_zone_is_permanent_or_ends():
    zones = permanent((0.0, 0.0))
    assert [math.isinf(zone.until) for zone in zones._zones] == [True]
