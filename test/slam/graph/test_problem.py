import numpy as np

from explore_slam.slam.graph.problem import chosen_landmarks

BEFORE, AFTER, SHARED = np.arange(20), np.arange(20, 40), np.arange(40, 46)


def turn_to_something_new():
    """Return keyframes and landmarks (O,): three keyframes each of either place, few shared."""
    seen = [BEFORE, BEFORE, np.r_[BEFORE, SHARED], np.r_[SHARED, AFTER], AFTER, AFTER]
    keyframe = np.concatenate([np.full(len(ids), k) for k, ids in enumerate(seen)])
    return keyframe, np.concatenate(seen)


def test_landmarks_shared_with_the_keyframe_before_are_variables():
    keyframe, landmark = turn_to_something_new()
    most = chosen_landmarks(keyframe, landmark, 2, 5, np.full(6, -1))
    assert not most[SHARED].any()
    chosen = chosen_landmarks(keyframe, landmark, 2, 5, np.arange(6) - 1)
    assert np.count_nonzero(chosen[SHARED]) == 5
    assert (most <= chosen).all()
    for k in range(1, 6):
        here, last = landmark[keyframe == k], landmark[keyframe == k - 1]
        assert np.count_nonzero(chosen[np.intersect1d(here, last)]) >= 5


def test_another_vehicle_between_two_keyframes_does_not_untie_them():
    keyframe, landmark = turn_to_something_new()
    keyframe = 2 * keyframe  # odd rows are those of another vehicle
    before = np.full(11, -1)
    before[2::2] = np.arange(0, 10, 2)
    chosen = chosen_landmarks(keyframe, landmark, 2, 5, before)
    assert np.count_nonzero(chosen[SHARED]) == 5


def test_only_landmarks_observed_often_enough_are_chosen():
    keyframe, landmark = turn_to_something_new()
    chosen = chosen_landmarks(keyframe, landmark, 3, 5, np.arange(6) - 1)
    assert not chosen[SHARED].any()
    assert chosen[BEFORE].any()
    assert chosen[AFTER].any()
