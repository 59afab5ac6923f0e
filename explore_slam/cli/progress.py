"""A progress bar on the terminal (tqdm)."""

from collections.abc import Callable, Iterator
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
