import numpy as np
import pytest

from explore_slam.geometry import Pose2
from explore_slam.slam.particles.group import Group
from explore_slam.slam.particles.motion import Segment
from explore_slam.slam.particles.vehicle_states import VehicleStates

STARTS = [Pose2(0.0, 0.0, 0.0), Pose2(3.0, 1.0, 0.5)]
NOISE = np.diag([0.02, 0.01, 0.01]) ** 2
WHITE = np.diag([0.03, 0.03, 0.02]) ** 2


def step(x, covariance=NOISE):
    return Segment.empty()._replace(mean=Pose2(x, 0.0, 0.0), covariance=covariance)


@pytest.fixture
def states():
    """Vehicle 0 has been placed by an update after a motion with a white error."""
    made = VehicleStates(STARTS, 100, 0.1, white_errors=True)
    made.append(0, step(1.0), WHITE)
    predicted, P = made.propagate(0, np.random.default_rng(0))
    normals = np.random.default_rng(1).standard_normal((100, 3))
    made.place(0, predicted + 0.01 * normals, predicted, P)
    return made


def test_motion_goes_on_from_where_the_measured_pose_is(states):
    before, chains = states.poses[0].copy(), states.chains[0].copy()
    assert np.abs(before - chains).max() > 1e-3  # the white error is between them
    states.append(0, step(0.5), np.zeros((3, 3)))
    np.testing.assert_array_equal(states.poses[0], chains)


def test_a_vehicle_placed_elsewhere_goes_on_from_there(states):
    """Not from where the motion before began."""
    elsewhere = Pose2(7.0, -2.0, 0.0)
    states.restart(0, np.asarray(elsewhere), NOISE)
    states.append(0, step(0.5), np.zeros((3, 3)))
    expected = np.tile(elsewhere.compose(Pose2(0.5, 0.0, 0.0)), (100, 1))
    np.testing.assert_allclose(states.predicted(0), expected, atol=1e-12)


def test_resampling_copies_the_whole_state_of_the_vehicles_of_a_group(states):
    group = Group([0], 100)
    before, other = states.arrays[0].copy(), states.arrays[1].copy()
    weights = np.zeros(100)
    weights[7] = 1.0
    ancestors = states.resample(group, weights, np.random.default_rng(2))
    np.testing.assert_array_equal(ancestors, 7)
    np.testing.assert_array_equal(states.arrays[0], np.tile(before[7], (100, 1)))
    np.testing.assert_array_equal(states.arrays[1], other)


def test_a_saved_state_goes_on_bit_by_bit(states):
    saved = {name: np.array(value) for name, value in states.state_dict().items()}
    restored = VehicleStates(STARTS, 100, 0.1, white_errors=True)
    restored.restore(saved)
    for each in (states, restored):
        each.append(0, step(0.5), WHITE)
        each.append(1, step(0.2), np.zeros((3, 3)))
    for number in (0, 1):
        np.testing.assert_array_equal(states.predicted(number), restored.predicted(number))
        weights = np.full(100, 0.01)
        for mine, theirs in zip(
            states.estimate(number, weights), restored.estimate(number, weights), strict=True
        ):
            np.testing.assert_array_equal(mine, theirs)
