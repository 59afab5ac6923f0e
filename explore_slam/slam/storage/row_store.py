"""Storage of values per particle that costs only what is distinct among the particles.

An *entry* (a landmark, or a pose of the path) has a block (V, M) of values, one column per
particle, when it is written. After resamplings only the columns of ancestors that still have
descendants are kept. Blocks lie in slabs of decreasing width (M, M/4, M/16, …, 1 columns); the
*address* of an entry is its place in its slab. An entry moves to a narrower slab when its
generation has shrunk to that width. The widest slab is the *workspace* of the update.

Each entry belongs to the ancestry tree of the particles that wrote it last.
"""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array
from explore_slam.slam.checkpoint import State
from explore_slam.slam.storage.ancestry import AncestryTree, Index, Layout
from explore_slam.slam.storage.row_format import Places

# Each slab is a quarter as wide as the one before: an entry takes less than 4 times the columns
# that it needs, and is moved at most log4(M) times.
_SHRINK = 4
# Address space (bytes) that a slab begins with. Pages that were never written take no memory, and
# a slab that need not grow is not copied in the middle of an update.
_RESERVED = 256 * 2**20


@kernel
def _gather(
    slab: Array, addresses: Places, columns: Index, which: Places, target: Array, at: Places
) -> None:  # pragma: no cover - compiled
    """Write target[at[i], :, m] = slab[addresses[i], :, columns[which[i], m]]."""
    values = slab.shape[1]
    particles = columns.shape[1]
    for i in range(len(addresses)):
        source = slab[addresses[i]]
        goal = target[at[i]]
        column = columns[which[i]]
        for v in range(values):
            for m in range(particles):
                goal[v, m] = source[v, column[m]]


@kernel
def _shrink(
    source: Array, old: Places, keep: Index, target: Array, new: Places
) -> None:  # pragma: no cover - compiled
    """Write target[new[i], :, r] = source[old[i], :, keep[r]]."""
    for i in range(len(old)):
        for v in range(source.shape[1]):
            for r in range(len(keep)):
                target[new[i], v, r] = source[old[i], v, keep[r]]


class Slab:
    """Memory for blocks of one width: values (capacity, V, columns) and free addresses."""

    def __init__(self, values: int, columns: int) -> None:
        self.data = np.zeros((0, values, columns))
        self.free: list[int] = []
        self.used = 0

    def allocate(self, count: int) -> Places:
        """Return addresses (count,), free ones first."""
        reused = [self.free.pop() for _ in range(min(count, len(self.free)))]
        fresh = count - len(reused)
        if self.used + fresh > len(self.data):
            reserved = _RESERVED // max(1, self.data.itemsize * math.prod(self.data.shape[1:]))
            capacity = max(self.used + fresh, 2 * len(self.data), reserved)
            grown = np.zeros((capacity, *self.data.shape[1:]))
            grown[: self.used] = self.data[: self.used]
            self.data = grown
        addresses = np.array(reused + list(range(self.used, self.used + fresh)), np.int64)
        self.used += fresh
        return addresses

    def release(self, addresses: Places) -> None:
        """Free addresses; the last one freed is the first one allocated again."""
        self.free.extend(addresses.tolist())


ParticleOf = Mapping[AncestryTree, int]


class RowStore:
    """Values (V,) per entry and particle, shared along the ancestry of the particles.

    Protocol of an update: `stage` the blocks of entries into the workspace, change them there,
    then `commit` what is to be kept and `discard` the rest.
    """

    def __init__(self, particles: int, values: int) -> None:
        self.values = values
        self.widths = [particles]
        while self.widths[-1] > 1:
            self.widths.append(-(-self.widths[-1] // _SHRINK))
        self.slabs = [Slab(values, width) for width in self.widths]
        self.layouts: dict[int, Layout] = {}
        self.next_number = 0
        self.layout_of = np.empty(0, np.int64)
        self.address_of = np.empty(0, np.int64)

    @property
    def workspace(self) -> Array:
        """The widest slab (addresses, V, M); valid until the next `stage` or `allocate`."""
        return self.slabs[0].data

    @property
    def particles(self) -> int:
        """The number of particles."""
        return self.widths[0]

    def memory(self) -> int:
        """Return the bytes of all addresses in use or free again."""
        return sum(slab.data[: slab.used].nbytes for slab in self.slabs)

    def rows_stored(self) -> int:
        """Return the number of columns in use, over all entries."""
        used = (slab.used - len(slab.free) for slab in self.slabs)
        return sum(width * count for width, count in zip(self.widths, used, strict=True))

    def trees_of(self, entries: Places) -> list[AncestryTree]:
        """Return for each entry the ancestry tree that it belongs to."""
        return [self.layouts[number].tree for number in self.layout_of[entries].tolist()]

    def is_of(self, entries: Places, trees: set[AncestryTree]) -> NDArray[np.bool_]:
        """Return (n,) whether each entry belongs to one of the trees."""
        numbers = [n for n, layout in self.layouts.items() if layout.tree in trees]
        found: NDArray[np.bool_] = np.isin(self.layout_of[entries], numbers)
        return found

    def stage(self, entries: Places, tree: AncestryTree) -> Places:
        """Return workspace addresses (n,) that contain a column per particle of each entry.

        Entries that already have one column per present particle of the tree are changed in
        place; the others are copied, and stay as they are until `commit`.
        """
        addresses = np.empty(len(entries), np.int64)
        here = self._is_present(entries, tree)
        addresses[here] = self.address_of[entries[here]]
        fresh = self.slabs[0].allocate(int(np.count_nonzero(~here)))
        addresses[~here] = fresh
        self._gather_into(self.slabs[0].data, entries[~here], fresh)
        return addresses

    def allocate(self, count: int) -> Places:
        """Return workspace addresses for new entries: fill them, then `commit`."""
        return self.slabs[0].allocate(count)

    def commit(self, entries: Places, addresses: Places, tree: AncestryTree) -> None:
        """Make staged or new blocks those of the entries, and free what they had before."""
        if not len(entries):
            return
        self._reserve(int(entries.max()) + 1)
        away = ~self._is_present(entries, tree)
        moved = entries[away]
        self.remove(moved)
        layout = self._present_layout(tree)
        layout.live += len(moved)
        layout.entries.append(moved.copy())
        self.layout_of[moved] = layout.number
        self.address_of[entries] = addresses

    def discard(self, entries: Places, addresses: Places, tree: AncestryTree) -> None:
        """Free staged blocks that have not been changed."""
        self.slabs[0].release(addresses[~self._is_present(entries, tree)])

    def remove(self, entries: Places) -> None:
        """Free the blocks of entries; entries without a block are ignored."""
        for entry in entries.tolist():
            number = int(self.layout_of[entry])
            if number < 0:
                continue
            layout = self.layouts[number]
            self.slabs[layout.size_class].free.append(int(self.address_of[entry]))
            self.layout_of[entry] = -1
            layout.live -= 1
            if layout.live == 0:
                self._drop(layout)

    def read(self, entries: Places) -> Array:
        """Return blocks (n, V, M) of entries, a column per particle."""
        values = np.empty((len(entries), self.values, self.particles))
        self._gather_into(values, entries, np.arange(len(entries)))
        return values

    def read_particle(self, entries: Places, particle_of: ParticleOf) -> Array:
        """Return values (n, V) of entries, each in the given particle of its ancestry tree."""
        values = np.empty((len(entries), self.values))
        numbers, which = np.unique(self.layout_of[entries], return_inverse=True)
        layouts = [self.layouts[number] for number in numbers.tolist()]
        columns = [layout.column_of(particle_of[layout.tree]) for layout in layouts]
        column_of = np.array(columns, np.int64)[which]
        classes = np.array([layout.size_class for layout in layouts], np.int64)[which]
        for size_class in np.unique(classes).tolist():
            at = np.flatnonzero(classes == size_class)
            data = self.slabs[size_class].data
            values[at] = data[self.address_of[entries[at]], :, column_of[at]]
        return values

    def compact(self, layout: Layout) -> None:
        """Move the entries of a shrunk layout to the narrowest slab that fits, if narrower."""
        count = layout.generation.count
        size_class = max(c for c, width in enumerate(self.widths) if width >= count)
        if size_class == layout.size_class:
            return
        entries = self._live_entries(layout)
        source, target = self.slabs[layout.size_class], self.slabs[size_class]
        old = self.address_of[entries]
        new = target.allocate(len(entries))
        keep = np.arange(count, dtype=np.int32) if layout.columns is None else layout.columns
        _shrink(source.data, old, keep, target.data, new)
        source.release(old)
        self.address_of[entries] = new
        layout.entries = [entries]
        layout.size_class = size_class
        layout.columns = None
        self._merge_dense(layout)

    def adopt(self, layout: Layout) -> None:
        """Register a layout restored from a saved state; see LayoutOwner."""
        layout.entries = [np.flatnonzero(self.layout_of == layout.number)]
        self.layouts[layout.number] = layout

    def state_dict(self) -> State:
        """Return the blocks and their addresses; the ancestry trees save the layouts."""
        state: State = {
            'layout_of': self.layout_of,
            'address_of': self.address_of,
            'next_number': np.array(self.next_number),
        }
        for number, slab in enumerate(self.slabs):
            state[f'data{number}'] = slab.data[: slab.used]
            state[f'free{number}'] = np.array(slab.free, np.int64)
        return state

    def restore(self, state: State) -> None:
        """Restore the blocks; restore the ancestry trees afterwards."""
        self.layout_of, self.address_of = state['layout_of'].copy(), state['address_of'].copy()
        self.next_number = int(state['next_number'])
        self.layouts = {}
        for number, slab in enumerate(self.slabs):
            slab.data = state[f'data{number}'].copy()
            slab.used = len(slab.data)
            slab.free = state[f'free{number}'].tolist()

    def _merge_dense(self, layout: Layout) -> None:
        """Merge the other dense layouts of the same generation and width into this one."""
        for other in list(layout.generation.layouts):
            same_store = other.owner is self and other.size_class == layout.size_class
            if other is layout or not same_store or other.columns is not None:
                continue
            entries = self._live_entries(other)
            self.layout_of[entries] = layout.number
            layout.entries.append(entries)
            layout.live += len(entries)
            self._drop(other)

    def _live_entries(self, layout: Layout) -> Places:
        entries = np.unique(np.concatenate(layout.entries))
        mine: Places = entries[self.layout_of[entries] == layout.number]
        return mine

    def _is_present(self, entries: Places, tree: AncestryTree) -> NDArray[np.bool_]:
        layout = self._dense_layout(tree)
        if layout is None:
            return np.zeros(len(entries), bool)
        here: NDArray[np.bool_] = self.layout_of[entries] == layout.number
        return here

    def _dense_layout(self, tree: AncestryTree) -> Layout | None:
        """Return the layout in which column m is that of the present particle m."""
        return next(
            (
                layout
                for layout in tree.present.layouts
                if layout.owner is self and layout.columns is None
            ),
            None,
        )

    def _present_layout(self, tree: AncestryTree) -> Layout:
        layout = self._dense_layout(tree)
        if layout is None:
            layout = Layout(tree, tree.present, self, self.next_number)
            tree.present.layouts.append(layout)
            self.layouts[self.next_number] = layout
            self.next_number += 1
        return layout

    def _drop(self, layout: Layout) -> None:
        layout.generation.layouts.remove(layout)
        del self.layouts[layout.number]

    def _reserve(self, entries: int) -> None:
        have = len(self.layout_of)
        if entries > have:
            extra = np.full(max(entries - have, have // 2 + 64), -1, np.int64)
            self.layout_of = np.concatenate([self.layout_of, extra])
            self.address_of = np.concatenate([self.address_of, extra])

    def _gather_into(self, target: Array, entries: Places, at: Places) -> None:
        numbers, which = np.unique(self.layout_of[entries], return_inverse=True)
        layouts = [self.layouts[number] for number in numbers.tolist()]
        classes = np.array([layout.size_class for layout in layouts], np.int64)
        for size_class in np.unique(classes).tolist():
            chosen = np.flatnonzero(classes == size_class)
            place = np.full(len(layouts), -1, np.int64)
            place[chosen] = np.arange(len(chosen))
            mine = np.flatnonzero(place[which] >= 0)
            columns = np.array(
                [layouts[i].column_of_particles() for i in chosen.tolist()], np.int32
            )
            addresses = self.address_of[entries[mine]]
            _gather(
                self.slabs[size_class].data, addresses, columns, place[which[mine]], target,
                at[mine],
            )  # fmt: skip
