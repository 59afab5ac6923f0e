"""Repeated observations of a landmark count as its autoregressive error lets them."""

import numpy as np
import pytest

from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.slam.config import CorrelationConfig
from explore_slam.slam.update.observation_correlation import ObservationCorrelation

LENGTHS = {'correlation_distance': 0.5, 'correlation_turn': 0.25, 'correlation_time': 10.0}
ENTRIES, IDS = np.array([0, 5, -1]), np.array([40, 45, -1])


@pytest.fixture
def correlation():
    return ObservationCorrelation(2, with_values(CorrelationConfig(), LENGTHS))


def inflation(exponent):
    rho = min(np.exp(-exponent), 0.998)
    return (1.0 + rho) / (1.0 - rho)


def test_first_observations_and_unknown_landmarks_count_fully(correlation):
    assert correlation.factors(0, 3.0, ENTRIES, IDS).tolist() == [1.0, 1.0, 1.0]
    correlation.add(0, 3.0, ENTRIES, IDS)
    # another vehicle, and another landmark that took the place of one that was removed
    assert correlation.factors(1, 3.0, ENTRIES, IDS).tolist() == [1.0, 1.0, 1.0]
    assert correlation.factors(0, 3.0, ENTRIES[:1], np.array([41])).tolist() == [1.0]
    assert correlation.factors(0, 3.0, ENTRIES, IDS)[2] == 1.0


def test_distance_turn_and_time_since_the_last_observation_add_up(correlation):
    correlation.add(0, 3.0, ENTRIES, IDS)
    for _ in range(3):
        correlation.predict(0, Pose2(0.03, 0.04, -0.05))
    exponent = 0.15 / 0.5 + 0.15 / 0.25 + 2.0 / 10.0
    expected = pytest.approx(inflation(exponent), rel=1e-12)
    assert correlation.factors(0, 5.0, ENTRIES, IDS)[1] == expected
    correlation.add(0, 5.0, ENTRIES[1:], IDS[1:])  # entry 0 was not seen again
    factors = correlation.factors(0, 6.0, ENTRIES, IDS)
    assert factors[0] == pytest.approx(inflation(exponent + 0.1), rel=1e-12)
    assert factors[1] == pytest.approx(inflation(0.1), rel=1e-12)


def test_a_vehicle_that_stands_still_learns_little_but_not_nothing(correlation):
    correlation.add(0, 3.0, ENTRIES, IDS)
    assert correlation.factors(0, 3.0, ENTRIES, IDS)[0] == pytest.approx(1.998 / 0.002)


def test_far_away_observations_are_independent(correlation):
    correlation.add(0, 3.0, ENTRIES, IDS)
    correlation.predict(0, Pose2(20.0, 0.0, 0.0))
    assert correlation.factors(0, 3.0, ENTRIES, IDS)[0] == pytest.approx(1.0, abs=1e-12)


def test_n_observations_have_the_information_of_the_autoregressive_process():
    """Σ 1/(R f) against 1ᵀ C⁻¹ 1 of n samples with C_ij = ρ^|i−j|."""
    config = with_values(CorrelationConfig(), LENGTHS)
    correlation, n, step = ObservationCorrelation(1, config), 200, 4.0
    information = 0.0
    for k in range(n):
        factor = correlation.factors(0, k * step, ENTRIES[:1], IDS[:1])[0]
        correlation.add(0, k * step, ENTRIES[:1], IDS[:1])
        information += 1.0 / factor
    rho = np.exp(-step / 10.0)
    C = rho ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    exact = np.ones(n) @ np.linalg.solve(C, np.ones(n))
    assert information == pytest.approx(exact, rel=0.02)


def test_vehicles_that_observe_each_other(correlation):
    assert correlation.factor_between(0, 1, 3.0) == 1.0
    correlation.add_between(0, 1, 3.0)
    correlation.predict(0, Pose2(0.1, 0.0, 0.0))
    correlation.predict(1, Pose2(0.0, 0.0, 0.1))
    expected = inflation(0.1 / 0.5 + 0.1 / 0.25 + 1.0 / 10.0)
    assert correlation.factor_between(0, 1, 4.0) == pytest.approx(expected, rel=1e-12)
    assert correlation.factor_between(1, 0, 4.0) == 1.0


def test_switched_off_everything_counts_fully():
    values = LENGTHS | {'correlated_observations': False}
    correlation = ObservationCorrelation(2, with_values(CorrelationConfig(), values))
    correlation.add(0, 3.0, ENTRIES, IDS)
    correlation.add_between(0, 1, 3.0)
    assert correlation.factors(0, 3.0, ENTRIES, IDS).tolist() == [1.0, 1.0, 1.0]
    assert correlation.factor_between(0, 1, 3.0) == 1.0


def test_state_round_trip(correlation):
    many = np.arange(0, 3000, 7)
    correlation.add(1, 2.0, many, many + 5)
    correlation.add_between(0, 1, 1.0)
    correlation.predict(1, Pose2(0.3, 0.0, 0.2))
    again = ObservationCorrelation(2, correlation.config)
    again.restore({name: np.array(value) for name, value in correlation.state_dict().items()})
    np.testing.assert_array_equal(
        again.factors(1, 3.0, many, many + 5), correlation.factors(1, 3.0, many, many + 5)
    )
    assert again.factor_between(0, 1, 2.0) == correlation.factor_between(0, 1, 2.0) > 1.0
