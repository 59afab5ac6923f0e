"""What beams say about cells, by their range (REP-117), and the cells that they cross."""

import math

import numpy as np
import pytest

from explore_slam.mapping.ray_model import (
    FREE_ONLY,
    HIT,
    NOTHING,
    UNKNOWN,
    Beams,
    BeamSteps,
    Canvas,
    classify_beams,
    draw_beams,
    drop_bodies,
)


def test_no_return_frees_no_further_than_the_scanner_can_measure():
    ranges = np.array([np.inf, 9.5, 3.0], np.float32)
    lengths, kinds = classify_beams(ranges, 0.05, 8.0, 20.0, 10.0)
    np.testing.assert_allclose(lengths, [8.0, 8.0, 3.0])
    assert kinds.tolist() == [FREE_ONLY, FREE_ONLY, HIT]


def test_beams_by_their_range():
    ranges = np.array([np.nan, -np.inf, 0.04, 0.05, 5.0, 5.1, 8.0, 8.1, np.inf], np.float32)
    lengths, kinds = classify_beams(ranges, 0.05, 8.0, 5.0, 3.0)
    np.testing.assert_allclose(lengths, [0, 0, 0, 0.05, 5.0, 5.0, 5.0, 3.0, 3.0], rtol=1e-6)
    expected = [NOTHING] * 3 + [HIT] * 2 + [FREE_ONLY] * 4
    assert kinds.tolist() == expected
    _, ignored = classify_beams(ranges[-1:], 0.05, 8.0, 5.0, 0.0)
    assert ignored.tolist() == [NOTHING]


def dropped(length, heading, bodies, kind=HIT, x=1.0, y=-2.0):
    lengths, kinds = np.array([length]), np.array([kind], np.uint8)
    beams = Beams(x, y, np.array([heading]), lengths, kinds)
    drop_bodies(beams, np.array(bodies, float))
    return lengths[0], kinds[0]


def test_a_beam_that_ends_on_a_body_frees_cells_up_to_the_body():
    heading = 0.5
    ahead = (1.0 + 3.0 * math.cos(heading), -2.0 + 3.0 * math.sin(heading), 0.5)
    for length in (2.55, 3.0, 3.45):
        cut, kind = dropped(length, heading, [ahead])
        assert (cut, kind) == (pytest.approx(2.5), FREE_ONLY)
    for length in (2.45, 3.55):
        assert dropped(length, heading, [ahead]) == (length, HIT)


def test_a_beam_that_ends_on_the_side_of_a_body_is_cut_where_it_enters():
    """The body's centre lies 0.3 m beside the beam: its chord begins 0.4 m before it."""
    cut, kind = dropped(3.1, 0.0, [(4.0, -1.7, 0.5)])
    assert (cut, kind) == (pytest.approx(2.6), FREE_ONLY)


def test_a_beam_from_within_a_body_frees_nothing():
    assert dropped(0.2, 0.0, [(1.0, -2.0, 0.5)]) == (0.0, FREE_ONLY)


def test_beams_without_a_hit_and_several_bodies():
    body = (4.0, -2.0, 0.5)
    assert dropped(3.0, 0.0, [body], FREE_ONLY) == (3.0, FREE_ONLY)
    assert dropped(3.0, 0.0, [(9.0, 9.0, 1.0), body]) == (pytest.approx(2.5), FREE_ONLY)


STEPS = BeamSteps(10, -4, -9, 25)


def drawn(beams, start=None):
    """Evidence of a row of 12 cells after beams from (0.5, 1.5): length in cells and kind."""
    evidence = np.full((3, 12), UNKNOWN) if start is None else start.copy()
    lengths, kinds = zip(*beams, strict=True)
    headings = np.zeros(len(beams))
    draw_beams(
        Canvas(evidence, np.zeros((3, 12), np.int32), 0, 0, 1, STEPS),
        Beams(0.5, 1.5, headings, np.array(lengths, float), np.array(kinds, np.uint8)),
    )
    return evidence


def test_a_hit_and_the_cells_before_it():
    evidence = drawn([(5.2, HIT)])
    assert evidence[1].tolist() == [-4] * 5 + [10] + [UNKNOWN] * 6
    assert (evidence[[0, 2]] == UNKNOWN).all()


def test_a_beam_without_a_hit_frees_the_cells_before_its_end():
    assert drawn([(5.2, FREE_ONLY)])[1].tolist() == [-4] * 5 + [UNKNOWN] * 7
    assert (drawn([(5.2, NOTHING)]) == UNKNOWN).all()


def test_one_scan_counts_once_and_a_hit_outweighs_a_pass():
    evidence = drawn([(5.2, HIT), (5.4, HIT), (8.0, FREE_ONLY)])
    assert evidence[1].tolist() == [-4] * 5 + [10] + [-4] * 2 + [UNKNOWN] * 4


def test_evidence_is_added_and_clamped():
    start = np.full((3, 12), np.int16(-6))
    start[1, 5] = 18
    evidence = drawn([(5.2, HIT)], start=start)
    assert evidence[1].tolist() == [-9] * 5 + [25] + [-6] * 6


@pytest.mark.parametrize('heading', np.linspace(-math.pi, math.pi, 17))
def test_a_ray_visits_connected_cells_from_its_origin_to_its_end(heading):
    evidence = np.full((40, 40), UNKNOWN)
    x, y, length = 20.3, 19.6, 15.0
    draw_beams(
        Canvas(evidence, np.zeros((40, 40), np.int32), 0, 0, 1, STEPS),
        Beams(x, y, np.array([heading]), np.array([length]), np.array([HIT], np.uint8)),
    )
    end = math.floor(y + length * math.sin(heading)), math.floor(x + length * math.cos(heading))
    assert evidence[end] == 10
    visited = np.argwhere(evidence == -4)
    assert len(visited) == abs(end[0] - 19) + abs(end[1] - 20)
    order = visited[np.argsort(np.abs(visited - (19, 20)).sum(axis=1))]
    steps = np.abs(np.diff(np.vstack([order, end]), axis=0)).sum(axis=1)
    assert (steps == 1).all()
    along = np.linspace(0.0, length, 4000)[:, None]
    points = np.array([y, x]) + along * [math.sin(heading), math.cos(heading)]
    inner = np.abs(points - np.rint(points)).min(axis=1) > 1e-3
    crossed = set(map(tuple, np.floor(points[inner]).astype(int).tolist()))
    assert crossed <= set(map(tuple, visited.tolist())) | {end}
