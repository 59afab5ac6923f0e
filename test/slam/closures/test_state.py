"""A search goes on from its saved state bit by bit; anchors of known places may go."""

import math

import numpy as np
from registration.ray_caster import scan_of
from slam.closures.drives import Vehicle, along, drive
from slam.closures.test_loop_search import FURNITURE, LAP, OFFICE

from explore_slam.registration import scan_cloud
from explore_slam.slam import checkpoint
from explore_slam.slam.closures import ClosureConfig, LoopSearch, Thinning


def test_a_restored_search_goes_on_bit_by_bit(tmp_path):
    walls, path = np.vstack([OFFICE, FURNITURE]), along(*LAP, *LAP[1:])
    poses = np.array(path)
    poses[:, :2] *= 1.004
    distances_driven = np.cumsum([0.0, *np.hypot(*np.diff(poses[:, :2], axis=0).T)])
    random = np.random.default_rng(3)
    clouds = [scan_cloud(scan_of(walls, pose, 0.01, random)) for pose in path]

    def go_on(search, numbers):
        for k in numbers:
            search.add_anchor(k, 0, clouds[k], float(distances_driven[k]), float(k))
            search.search(k, poses * (1.0 + 1e-5 * k))

    cut = len(path) * 2 // 3
    search = LoopSearch(ClosureConfig())
    go_on(search, range(cut))
    assert len(search.closures) >= 2
    search.recheck(np.r_[np.full(len(search.closures) - 1, 1.0), 1e3])
    checkpoint.write(tmp_path / 'state.npz', search.state_dict())
    restored = LoopSearch.from_state(checkpoint.read(tmp_path / 'state.npz'), ClosureConfig())
    for one in (search, restored):
        go_on(one, range(cut, len(path)))
    assert len(search.closures) > 5
    one, other = search.state_dict(), restored.state_dict()
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def test_anchors_in_different_frames_are_not_compared():
    """The poses of two vehicles are the same, but in frames that have nothing in common yet."""
    walls = np.vstack([OFFICE, FURNITURE])
    run = drive(lambda *_: walls, [Vehicle(along(*LAP)), Vehicle(along(*LAP))])
    poses = run.graph.path()

    def known(_, others):
        return np.tile(1e-4 * np.eye(3), (len(others), 1, 1))

    apart = Thinning(run.search.anchors)
    assert apart.redundant(poses, known, frames=[-1, 1]) == []
    together = Thinning(run.search.anchors)
    assert len(together.redundant(poses, known, frames=[-1, -1])) > 20


def test_several_vehicles_share_the_anchors_of_a_place():
    """The second lap of two vehicles adds hardly an anchor to those of the first."""
    walls = np.vstack([OFFICE, FURNITURE])
    route, later = along(*LAP, *LAP[1:]), along(*LAP[2:], *LAP[1:], *LAP[1:3])
    vehicles = [Vehicle(route, way_scale=1.003), Vehicle(later, way_scale=0.998)]
    run = drive(lambda *_: walls, vehicles)
    thinning = Thinning(run.search.anchors)
    for keyframe in thinning.redundant(run.graph.path(), run.graph.relative_covariance):
        run.search.remove_anchor(keyframe)
    one_lap = len(along(*LAP))
    left = [anchor.vehicle for anchor in run.search.anchors]
    assert len(run.true) > 3.8 * one_lap
    assert len(left) < 2.2 * one_lap
    assert 0.5 * one_lap < left.count(0)
    assert 0.5 * one_lap < left.count(1)


def test_anchors_of_places_seen_often_are_bounded_by_the_area():
    walls = np.vstack([OFFICE, FURNITURE])
    laps = along(*LAP, *LAP[1:], *LAP[1:], *LAP[1:])
    run = drive(lambda *_: walls, [Vehicle(laps, way_scale=1.003)])
    thinning, poses = Thinning(run.search.anchors), run.graph.path()
    one_lap = len(along(*LAP))
    assert len(run.search.anchors) > 3.5 * one_lap
    gone = thinning.redundant(poses, run.graph.relative_covariance)
    for keyframe in gone:
        run.search.remove_anchor(keyframe)
    assert min(gone) >= 0.8 * one_lap
    assert len(run.search.anchors) < 2.0 * one_lap
    assert thinning.redundant(poses, run.graph.relative_covariance) == []
    again = Thinning.from_state(thinning.state_dict(), run.search.anchors)
    assert again.evaluated == thinning.evaluated
    # loops are still found with what is left
    last = len(laps) - 1
    closures = [run.search.search(last, poses)]
    assert all(math.isfinite(c.score) for found in closures for c in found)
    unsure = Thinning(run.search.anchors)
    assert unsure.redundant(poses, lambda _, others: np.tile(np.eye(3), (len(others), 1, 1))) == []
