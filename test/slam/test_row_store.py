import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from explore_slam.slam.genealogy import Genealogy
from explore_slam.slam.resampling import systematic_ancestors
from explore_slam.slam.row_store import RowStore


def resample(genealogy, random):
    weights = random.exponential(size=genealogy.particles) ** 2
    ancestors = systematic_ancestors(weights / weights.sum(), random.random())
    for layout in genealogy.resample(ancestors):
        layout.owner.compact(layout)
    return ancestors


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000), st.integers(1, 70))
def test_store_equals_a_full_copy_of_every_row(seed, particles):
    """Two stores on one genealogy, against dense arrays that are copied at every resampling."""
    random = np.random.default_rng(seed)
    genealogy = Genealogy(particles)
    stores = [RowStore(particles, 3), RowStore(particles, 2)]
    dense = [{}, {}]
    for _ in range(60):
        action = random.integers(0, 4)
        which = int(random.integers(0, 2))
        store, full = stores[which], dense[which]
        if action == 0:
            new = len(full) + np.arange(random.integers(1, 4))
            slots = store.new_slots(len(new))
            for item, slot in zip(new, slots, strict=True):
                rows = random.standard_normal((store.values, particles))
                store.present_data[slot] = rows
                full[int(item)] = rows.copy()
            store.commit(new, slots, genealogy)
        elif action == 1:
            ancestors = resample(genealogy, random)
            for copies in dense:
                for item in copies:
                    copies[item] = copies[item][:, ancestors]
        elif action == 2 and full:
            items = np.array(sorted(full))[random.random(len(full)) < 0.4]
            slots = store.stage(items, genealogy)
            touched = random.random(len(items)) < 0.6
            for item, slot in zip(items[touched], slots[touched], strict=True):
                store.present_data[slot, 0] += 1.0
                full[int(item)][0] += 1.0
            store.revert(items[~touched], slots[~touched], genealogy)
            store.commit(items[touched], slots[touched], genealogy)
        elif full:
            items = np.array(sorted(full))
            particle = int(random.integers(0, particles))
            values = np.array([full[int(item)] for item in items])
            np.testing.assert_array_equal(store.read(items), values)
            np.testing.assert_array_equal(
                store.read_particle(items, particle), values[:, :, particle]
            )


def test_old_rows_shrink_to_the_ancestors_that_are_left():
    random = np.random.default_rng(1)
    genealogy = Genealogy(1000)
    store = RowStore(1000, 9)
    for n in range(200):
        store.commit(np.array([n]), store.new_slots(1), genealogy)
        resample(genealogy, random)
    assert store.rows_held() < 200 * 1000 * 0.08
    assert len(genealogy.levels) < 200
    distinct = {len(np.unique(level.index)) for level in genealogy.levels}
    assert distinct == {level.count for level in genealogy.levels}


def test_removed_rows_are_used_again():
    genealogy = Genealogy(10)
    store = RowStore(10, 3)
    first = store.new_slots(3)
    store.commit(np.arange(3), first, genealogy)
    store.remove(np.array([1]))
    store.remove(np.array([1]))
    assert store.new_slots(1)[0] == first[1]
    assert store.rows_held() == pytest.approx(30)
