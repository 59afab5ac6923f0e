"""When the pose of a vehicle is reliable (Placement): doubt, displacement and what ends them."""

import numpy as np
import pytest

from explore_slam.agent.placement import Placement
from explore_slam.geometry import Pose2
from explore_slam.slam import UpdateSummary


def summary(associated, relocated=False):
    return UpdateSummary(
        stamp=0.0, vehicle='robot1', observed=20, with_candidates=20, associated=associated,
        inserted=0, removed=0, effective_particles=1.0, resampled=False, redrawn=False,
        lost=False, relocated=relocated, matches=np.empty(0, np.int64), together=('robot1',),
    )  # fmt: skip


def test_a_vehicle_in_doubt_is_not_reliable_until_the_pose_is_confirmed(caplog):
    placement = Placement('robot1', start_known=True)
    assert placement.is_reliable
    placement.check_first_reading(Pose2(3.0, 0.0, 0.0))
    assert not placement.is_reliable
    placement.check_first_reading(Pose2(4.0, 0.0, 0.0))  # after a reset: known already
    assert 'odometry begins at (3.00 m' in placement.doubt
    assert len(caplog.records) == 1
    placement.confirm()
    assert placement.is_reliable


def test_odometry_of_a_vehicle_with_a_given_pose_may_begin_anywhere():
    placement = Placement('robot1', start_known=True)
    placement.set_by_operator()
    placement.check_first_reading(Pose2(3.0, 0.0, 0.0))
    assert placement.is_reliable


@pytest.mark.parametrize(
    ('updates', 'reliable'),
    [
        ([summary(20)], True),  # it has not moved
        ([summary(9)], False),
        ([summary(9), summary(20)], False),  # with landmarks that it inserted since
        ([summary(9), summary(20), summary(20, relocated=True)], True),
    ],
)
def test_a_displaced_vehicle_is_reliable_when_landmarks_show_where_it_is(updates, reliable):
    placement = Placement('robot1', start_known=True)
    placement.displace()
    assert not placement.is_reliable
    for update in updates:
        placement.check_update(update)
    assert placement.is_reliable is reliable
