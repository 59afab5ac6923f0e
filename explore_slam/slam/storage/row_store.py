"""Rows per particle that cost only what is distinct: items × surviving ancestors × values.

An item (a landmark, a pose on the path) has one row of values per particle when it is written.
After resamplings only the rows with descendants are left. Rows lie in slabs of a few sizes
(M, M/4, M/16, …, 1 rows); an item moves to the next smaller slab when its level has shrunk to
it. Within a slab values lie as (item, value, row), so that loops over particles are contiguous.
"""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array
from explore_slam.slam.storage.ancestry import Genealogy, Index, Layout

Items = NDArray[np.int64]
_SHRINK = 4
# Address space that a slab begins with: what nothing was written to takes no memory, and a slab
# that need not grow is not copied in the middle of an update.
_RESERVED = 256 * 2**20


@kernel
def _gather(
    slab: Array, slots: Items, rows: Index, which: Items, target: Array, at: Items
) -> None:  # pragma: no cover - compiled
    """Write target[at[i], :, m] = slab[slots[i], :, rows[which[i], m]]."""
    values = slab.shape[1]
    particles = rows.shape[1]
    for i in range(len(slots)):
        source = slab[slots[i]]
        goal = target[at[i]]
        row = rows[which[i]]
        for v in range(values):
            for m in range(particles):
                goal[v, m] = source[v, row[m]]


@kernel
def _shrink(
    source: Array, old: Items, keep: Index, target: Array, new: Items
) -> None:  # pragma: no cover - compiled
    """Write target[new[i], :, r] = source[old[i], :, keep[r]]."""
    for i in range(len(old)):
        for v in range(source.shape[1]):
            for r in range(len(keep)):
                target[new[i], v, r] = source[old[i], v, keep[r]]


class Slab:
    """Memory for items of one size: values (capacity, V, R) and the slots that are free."""

    def __init__(self, values: int, rows: int) -> None:
        self.data = np.zeros((0, values, rows))
        self.free: list[int] = []
        self.used = 0

    def take(self, count: int) -> Items:
        """Return slots for count items, free ones first."""
        reused = [self.free.pop() for _ in range(min(count, len(self.free)))]
        fresh = count - len(reused)
        if self.used + fresh > len(self.data):
            reserved = _RESERVED // max(1, self.data.itemsize * math.prod(self.data.shape[1:]))
            capacity = max(self.used + fresh, 2 * len(self.data), reserved)
            grown = np.zeros((capacity, *self.data.shape[1:]))
            grown[: self.used] = self.data[: self.used]
            self.data = grown
        slots = np.array(reused + list(range(self.used, self.used + fresh)), np.int64)
        self.used += fresh
        return slots

    def release(self, slots: Items) -> None:
        """Give slots back; the last one given is the first one taken again."""
        self.free.extend(slots.tolist())


ParticleOf = Mapping[Genealogy, int]


class RowStore:
    """Values (V,) per item and particle, shared through genealogies.

    Items hang on the genealogy, named home below, of the particles that wrote them last.
    """

    def __init__(self, particles: int, values: int) -> None:
        self.values = values
        self.sizes = [particles]
        while self.sizes[-1] > 1:
            self.sizes.append(-(-self.sizes[-1] // _SHRINK))
        self.slabs = [Slab(values, size) for size in self.sizes]
        self.layouts: dict[int, Layout] = {}
        self.next_number = 0
        self.layout_of = np.empty(0, np.int64)
        self.slot_of = np.empty(0, np.int64)

    @property
    def present_data(self) -> Array:
        """The largest slab (slots, V, M); valid until the next stage or new_slots."""
        return self.slabs[0].data

    def memory(self) -> int:
        """Return the bytes held in slabs, those of slots given back included."""
        return sum(slab.data[: slab.used].nbytes for slab in self.slabs)

    def rows_held(self) -> int:
        """Return the number of physical rows in use."""
        used = (slab.used - len(slab.free) for slab in self.slabs)
        return sum(size * count for size, count in zip(self.sizes, used, strict=True))

    @property
    def particles(self) -> int:
        """The number of particles."""
        return self.sizes[0]

    def homes(self, items: Items) -> list[Genealogy]:
        """Return for each item the genealogy that it hangs on."""
        return [self.layouts[number].genealogy for number in self.layout_of[items].tolist()]

    def stage(self, items: Items, home: Genealogy) -> Items:
        """Return slots in the largest slab that hold a row per particle of each item.

        Items that have such a row at present at home keep it (write in place); the others are
        copied to new slots, and stay where they are until `commit`.
        """
        slots = np.empty(len(items), np.int64)
        here = self._is_present(items, home)
        slots[here] = self.slot_of[items[here]]
        fresh = self.slabs[0].take(int(np.count_nonzero(~here)))
        slots[~here] = fresh
        self._gather_into(self.slabs[0].data, items[~here], fresh)
        return slots

    def new_slots(self, count: int) -> Items:
        """Return slots of the largest slab for new items; fill them, then commit."""
        return self.slabs[0].take(count)

    def commit(self, items: Items, slots: Items, home: Genealogy) -> None:
        """Make slots staged for a home, or new ones, the rows of items; free what they held."""
        if not len(items):
            return
        self._reserve(int(items.max()) + 1)
        away = ~self._is_present(items, home)
        moved = items[away]
        self.remove(moved)
        layout = self._present_layout(home)
        layout.live += len(moved)
        layout.items.append(moved.copy())
        self.layout_of[moved] = layout.number
        self.slot_of[items] = slots

    def revert(self, items: Items, slots: Items, home: Genealogy) -> None:
        """Give slots staged for a home back without having changed the items."""
        self.slabs[0].release(slots[~self._is_present(items, home)])

    def remove(self, items: Items) -> None:
        """Free the rows of items; items without rows are passed over."""
        for item in items.tolist():
            number = int(self.layout_of[item])
            if number < 0:
                continue
            layout = self.layouts[number]
            self.slabs[layout.size_class].free.append(int(self.slot_of[item]))
            self.layout_of[item] = -1
            layout.live -= 1
            if layout.live == 0:
                self._drop(layout)

    def read(self, items: Items) -> Array:
        """Return values (n, V, M) of the items in all particles."""
        values = np.empty((len(items), self.values, self.particles))
        self._gather_into(values, items, np.arange(len(items)))
        return values

    def read_particle(self, items: Items, particle_of: ParticleOf) -> Array:
        """Return values (n, V) of the items, each in the particle of its genealogy."""
        values = np.empty((len(items), self.values))
        numbers, which = np.unique(self.layout_of[items], return_inverse=True)
        layouts = [self.layouts[number] for number in numbers.tolist()]
        rows = [layout.physical_row(particle_of[layout.genealogy]) for layout in layouts]
        row_of = np.array(rows, np.int64)[which]
        classes = np.array([layout.size_class for layout in layouts], np.int64)[which]
        for size_class in np.unique(classes).tolist():
            at = np.flatnonzero(classes == size_class)
            data = self.slabs[size_class].data
            values[at] = data[self.slot_of[items[at]], :, row_of[at]]
        return values

    def compact(self, layout: Layout) -> None:
        """Move the items of a shrunk layout to the smallest slab that takes them, if smaller."""
        count = layout.level.count
        size_class = max(c for c, size in enumerate(self.sizes) if size >= count)
        if size_class == layout.size_class:
            return
        items = self._live_items(layout)
        source, target = self.slabs[layout.size_class], self.slabs[size_class]
        old = self.slot_of[items]
        new = target.take(len(items))
        keep = np.arange(count, dtype=np.int32) if layout.slots is None else layout.slots
        _shrink(source.data, old, keep, target.data, new)
        source.release(old)
        self.slot_of[items] = new
        layout.items = [items]
        layout.size_class = size_class
        layout.slots = None
        self._merge_dense(layout)

    def _merge_dense(self, layout: Layout) -> None:
        """Merge the other dense layouts of the same level and size into this one."""
        for other in list(layout.level.layouts):
            alike = other.owner is self and other.size_class == layout.size_class
            if other is layout or not alike or other.slots is not None:
                continue
            items = self._live_items(other)
            self.layout_of[items] = layout.number
            layout.items.append(items)
            layout.live += len(items)
            self._drop(other)

    def _live_items(self, layout: Layout) -> Items:
        items = np.unique(np.concatenate(layout.items))
        mine: Items = items[self.layout_of[items] == layout.number]
        return mine

    def _is_present(self, items: Items, home: Genealogy) -> NDArray[np.bool_]:
        layout = self._dense_layout(home)
        if layout is None:
            return np.zeros(len(items), bool)
        here: NDArray[np.bool_] = self.layout_of[items] == layout.number
        return here

    def _dense_layout(self, home: Genealogy) -> Layout | None:
        """Return the layout in which row m is that of particle m at present."""
        return next(
            (
                layout
                for layout in home.present.layouts
                if layout.owner is self and layout.slots is None
            ),
            None,
        )

    def _present_layout(self, home: Genealogy) -> Layout:
        layout = self._dense_layout(home)
        if layout is None:
            layout = Layout(home, home.present, self, self.next_number)
            home.present.layouts.append(layout)
            self.layouts[self.next_number] = layout
            self.next_number += 1
        return layout

    def _drop(self, layout: Layout) -> None:
        layout.level.layouts.remove(layout)
        del self.layouts[layout.number]

    def _reserve(self, items: int) -> None:
        have = len(self.layout_of)
        if items > have:
            extra = np.full(max(items - have, have // 2 + 64), -1, np.int64)
            self.layout_of = np.concatenate([self.layout_of, extra])
            self.slot_of = np.concatenate([self.slot_of, extra])

    def _gather_into(self, target: Array, items: Items, at: Items) -> None:
        numbers, which = np.unique(self.layout_of[items], return_inverse=True)
        layouts = [self.layouts[number] for number in numbers.tolist()]
        classes = np.array([layout.size_class for layout in layouts], np.int64)
        for size_class in np.unique(classes).tolist():
            chosen = np.flatnonzero(classes == size_class)
            place = np.full(len(layouts), -1, np.int64)
            place[chosen] = np.arange(len(chosen))
            mine = np.flatnonzero(place[which] >= 0)
            rows = np.array([layouts[i].physical_rows() for i in chosen.tolist()], np.int32)
            slots = self.slot_of[items[mine]]
            _gather(self.slabs[size_class].data, slots, rows, place[which[mine]], target, at[mine])
