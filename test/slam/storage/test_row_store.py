import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from explore_slam.slam.particles.resampling import systematic_ancestors
from explore_slam.slam.storage.ancestry import AncestryTree
from explore_slam.slam.storage.row_store import RowStore


def resample(tree, random):
    weights = random.exponential(size=tree.particles) ** 2
    return descend(tree, systematic_ancestors(weights / weights.sum(), random.random()))


def descend(tree, ancestors):
    for layout in tree.resample(ancestors):
        layout.owner.compact(layout)
    return ancestors


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10_000), st.integers(1, 70))
def test_store_equals_a_full_copy_of_every_row(seed, particles):
    """Two stores, two ancestry trees, against dense arrays that are copied at every resampling.

    The ancestry trees resample apart from each other, in ascending order of ancestors or in any.
    """
    random = np.random.default_rng(seed)
    trees = [AncestryTree(particles), AncestryTree(particles)]
    stores = [RowStore(particles, 3), RowStore(particles, 2)]
    dense = [{}, {}]  # entry: home, rows
    for _ in range(80):
        action = random.integers(0, 5)
        which, at = random.integers(0, 2, 2).tolist()
        store, full, home = stores[which], dense[which], trees[at]
        if action == 0:
            new = len(full) + np.arange(random.integers(1, 4))
            addresses = store.allocate(len(new))
            for entry, address in zip(new, addresses, strict=True):
                rows = random.standard_normal((store.values, particles))
                store.workspace[address] = rows
                full[int(entry)] = (at, rows.copy())
            store.commit(new, addresses, home)
        elif action in (1, 4):
            if action == 1:
                ancestors = resample(home, random)
            else:
                chosen = random.choice(particles, particles, replace=random.random() < 0.5)
                ancestors = descend(home, chosen.astype(np.int32))
            for copies in dense:
                for entry, (its, rows) in copies.items():
                    if its == at:
                        copies[entry] = (its, rows[:, ancestors])
        elif action == 2 and full:
            entries = np.array(sorted(full))[random.random(len(full)) < 0.4]
            addresses = store.stage(entries, home)
            touched = random.random(len(entries)) < 0.6
            for entry, address in zip(entries[touched], addresses[touched], strict=True):
                store.workspace[address, 0] += 1.0
                rows = full[int(entry)][1]
                rows[0] += 1.0
                full[int(entry)] = (at, rows)
            store.discard(entries[~touched], addresses[~touched], home)
            store.commit(entries[touched], addresses[touched], home)
        elif full:
            entries = np.array(sorted(full))
            values = np.array([full[int(entry)][1] for entry in entries])
            np.testing.assert_array_equal(store.read(entries), values)
            assert store.trees_of(entries) == [trees[full[int(entry)][0]] for entry in entries]
            chosen = random.integers(0, particles, 2).tolist()
            expected = [full[int(entry)][1][:, chosen[full[int(entry)][0]]] for entry in entries]
            found = store.read_particle(entries, dict(zip(trees, chosen, strict=True)))
            np.testing.assert_array_equal(found, expected)


def test_old_rows_shrink_to_the_ancestors_that_are_left():
    random = np.random.default_rng(1)
    tree = AncestryTree(1000)
    store = RowStore(1000, 9)
    for n in range(200):
        store.commit(np.array([n]), store.allocate(1), tree)
        resample(tree, random)
    assert store.rows_stored() < 200 * 1000 * 0.08
    assert len(tree.generations) < 200
    distinct = {len(np.unique(generation.index)) for generation in tree.generations}
    assert distinct == {generation.count for generation in tree.generations}


def test_removed_rows_are_used_again():
    tree = AncestryTree(10)
    store = RowStore(10, 3)
    first = store.allocate(3)
    store.commit(np.arange(3), first, tree)
    store.remove(np.array([1]))
    store.remove(np.array([1]))
    assert store.allocate(1)[0] == first[1]
    assert store.rows_stored() == pytest.approx(30)
