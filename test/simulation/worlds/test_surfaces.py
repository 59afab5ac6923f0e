"""Painted surfaces, and their packing on texture pages."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from explore_slam.simulation.worlds.atlas import (
    MAX_PAGES,
    PAGE_SIZE,
    Surface,
    _arrange,
    build_atlas,
)
from explore_slam.simulation.worlds.paint import STYLES, paint_floor, paint_surface


@pytest.mark.parametrize('style', sorted(STYLES))
def test_a_surface_repeats_with_its_seed_and_is_not_plain(style):
    def paint(seed, shape=(200, 260)):
        return paint_surface(style, shape, 0.006, np.random.default_rng(seed))

    first, again, other = paint(1), paint(1), paint(2)
    assert first.shape == (200, 260, 3)
    assert first.dtype == np.uint8
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert first.std() > 5.0


@pytest.mark.parametrize('style', sorted(STYLES))
@pytest.mark.parametrize('shape', [(2, 2), (2, 300), (300, 2), (30, 9), (61, 40)])
def test_surfaces_of_any_size_can_be_painted(style, shape):
    image = paint_surface(style, shape, 0.02, np.random.default_rng(0))
    assert image.shape == (*shape, 3)


def test_the_floor_has_the_size_asked():
    assert paint_floor((40, 70), 0.02, np.random.default_rng(0)).shape == (40, 70, 3)


sizes = st.lists(
    st.tuples(st.integers(2, PAGE_SIZE - 2), st.integers(2, 700)), min_size=1, max_size=60
)


@given(sizes)
@settings(max_examples=60, deadline=None)
def test_patches_lie_on_pages_and_do_not_overlap(sizes):
    surfaces = [Surface(('plaster', 'brick')[i % 2], 1.0, 1.0) for i in range(len(sizes))]
    placed = _arrange(surfaces, sizes)
    assert len(placed) == len(sizes)
    own = []
    for (patch, is_own), (columns, rows) in zip(placed, sizes, strict=True):
        assert 0 <= patch.left < patch.right <= PAGE_SIZE
        assert 0 <= patch.top < patch.bottom <= PAGE_SIZE
        assert 0 <= patch.page < MAX_PAGES
        if is_own:
            assert (patch.right - patch.left, patch.bottom - patch.top) == (columns, rows)
            own.append(patch)
    assert own
    for i, a in enumerate(own):
        for b in own[:i]:
            assert (
                a.page != b.page
                or a.right <= b.left
                or b.right <= a.left
                or a.bottom <= b.top
                or b.bottom <= a.top
            )


def test_a_surface_keeps_its_look_when_others_change():
    wall = Surface('brick', 2.0, 1.0)
    alone = build_atlas([wall], 0.01, 3)
    joined = build_atlas([wall, Surface('plaster', 3.0, 2.0)], 0.01, 3)

    def look(atlas):
        patch = atlas.patches[0]
        return atlas.pages[patch.page][patch.top : patch.bottom, patch.left : patch.right]

    assert np.array_equal(look(alone), look(joined))


def test_surfaces_beyond_the_pages_share_patches_of_their_style():
    styles = ['brick'] * 30 + ['plaster'] * 2
    placed = _arrange([Surface(style, 20.0, 10.0) for style in styles], [(2000, 1000)] * 32)
    own = {patch for patch, is_own in placed[:30] if is_own}
    assert len(own) == 16  # two columns and four rows on each of two pages
    assert {patch for patch, is_own in placed[:30] if not is_own} <= own
