"""Progress on the terminal: a bar (tqdm), or a line for each run of a study."""

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

from tqdm import tqdm

BAR_FORMAT = '{desc} {percentage:3.0f} %|{bar:30}| {remaining} left'


@contextmanager
def progress_bar(label: str, *, enabled: bool = True) -> Iterator[Callable[[float], None]]:
    """Yield a function that draws the fraction done (0 to 1) on stderr, if that is a terminal."""
    with tqdm(
        total=1.0, desc=label, bar_format=BAR_FORMAT, disable=None if enabled else True
    ) as bar:

        def show(fraction: float) -> None:
            bar.update(min(max(fraction, 0.0), 1.0) - bar.n)

        yield show
        show(1.0)


def report_runs[Run](
    made: Iterable[Run],
    total: int,
    described: Callable[[Run], str],
    save: Callable[[list[Run]], object] | None,
) -> list[Run]:
    """Return the runs of a study; print a line on stderr, and save those so far, as each ends."""
    runs: list[Run] = []
    for run in made:
        runs.append(run)
        print(f'[{len(runs)}/{total}] {described(run)}', file=sys.stderr, flush=True)
        if save is not None:
            save(runs)
    return runs
