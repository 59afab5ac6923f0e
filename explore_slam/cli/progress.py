"""A progress bar on the terminal; silent where stderr is not one."""

import sys
import time
from types import TracebackType

WIDTH = 30


class ProgressBar:
    """Draws at most ten times a second; use it as a context."""

    def __init__(self, label: str, *, enabled: bool = True) -> None:
        self._label = label
        self._enabled = enabled and sys.stderr.isatty()
        self._begin = time.monotonic()
        self._drawn = -1.0

    def __enter__(self) -> 'ProgressBar':
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._enabled:
            if kind is None:
                self._draw(1.0)
            sys.stderr.write('\n')

    def show(self, share: float) -> None:
        """Draw the share (0 to 1) that is done."""
        now = time.monotonic()
        if self._enabled and now - self._drawn >= 0.1:
            self._drawn = now
            self._draw(min(max(share, 0.0), 1.0))

    def _draw(self, share: float) -> None:
        full = round(WIDTH * share)
        spent = time.monotonic() - self._begin
        left = f'{spent * (1.0 - share) / share:4.0f} s left' if share > 0.02 else ''
        bar = '█' * full + '░' * (WIDTH - full)
        sys.stderr.write(f'\r{self._label} {bar} {100.0 * share:3.0f} % {left:12s}')
        sys.stderr.flush()
