import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from explore_slam.slam.particles.resampling import systematic_ancestors
from explore_slam.slam.storage.ancestry import Genealogy
from explore_slam.slam.storage.row_store import RowStore


def resample(genealogy, random):
    weights = random.exponential(size=genealogy.particles) ** 2
    return descend(genealogy, systematic_ancestors(weights / weights.sum(), random.random()))


def descend(genealogy, ancestors):
    for layout in genealogy.resample(ancestors):
        layout.owner.compact(layout)
    return ancestors


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10_000), st.integers(1, 70))
def test_store_equals_a_full_copy_of_every_row(seed, particles):
    """Two stores, two genealogies, against dense arrays that are copied at every resampling.

    The genealogies resample apart from each other, in ascending order of ancestors or in any.
    """
    random = np.random.default_rng(seed)
    homes = [Genealogy(particles), Genealogy(particles)]
    stores = [RowStore(particles, 3), RowStore(particles, 2)]
    dense = [{}, {}]  # item: home, rows
    for _ in range(80):
        action = random.integers(0, 5)
        which, at = random.integers(0, 2, 2).tolist()
        store, full, home = stores[which], dense[which], homes[at]
        if action == 0:
            new = len(full) + np.arange(random.integers(1, 4))
            slots = store.new_slots(len(new))
            for item, slot in zip(new, slots, strict=True):
                rows = random.standard_normal((store.values, particles))
                store.present_data[slot] = rows
                full[int(item)] = (at, rows.copy())
            store.commit(new, slots, home)
        elif action in (1, 4):
            if action == 1:
                ancestors = resample(home, random)
            else:
                chosen = random.choice(particles, particles, replace=random.random() < 0.5)
                ancestors = descend(home, chosen.astype(np.int32))
            for copies in dense:
                for item, (its, rows) in copies.items():
                    if its == at:
                        copies[item] = (its, rows[:, ancestors])
        elif action == 2 and full:
            items = np.array(sorted(full))[random.random(len(full)) < 0.4]
            slots = store.stage(items, home)
            touched = random.random(len(items)) < 0.6
            for item, slot in zip(items[touched], slots[touched], strict=True):
                store.present_data[slot, 0] += 1.0
                rows = full[int(item)][1]
                rows[0] += 1.0
                full[int(item)] = (at, rows)
            store.revert(items[~touched], slots[~touched], home)
            store.commit(items[touched], slots[touched], home)
        elif full:
            items = np.array(sorted(full))
            values = np.array([full[int(item)][1] for item in items])
            np.testing.assert_array_equal(store.read(items), values)
            assert store.homes(items) == [homes[full[int(item)][0]] for item in items]
            chosen = random.integers(0, particles, 2).tolist()
            expected = [full[int(item)][1][:, chosen[full[int(item)][0]]] for item in items]
            found = store.read_particle(items, dict(zip(homes, chosen, strict=True)))
            np.testing.assert_array_equal(found, expected)


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
