"""Stamps against the clock of the receiver and against those of other topics of a vehicle."""

import math
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

# Chosen by hand; test_clocks shows what they decide.
CLOCKS_APART = 1.0  # s of difference that is named
_SAMPLES = 20  # newest stamps per topic; the least delayed of them counts
_MINIMUM = 5  # stamps before a topic is judged


class StampProblem(NamedTuple):
    """What is wrong with the stamps of a topic.

    kind: equal for the same problem, whatever its amount (s; None: it has none that matters).
    """

    text: str
    kind: str
    amount: float | None = None


class StampWatch:
    """How far the stamps of a vehicle's topics are ahead of the receiver's clock.

    unstamped: topics whose messages have the stamp zero, with their numbers.
    """

    def __init__(self) -> None:
        self._ahead: dict[str, deque[float]] = {}
        self.unstamped: dict[str, int] = {}

    def add(self, topic: str, stamp: float, now: float) -> bool:
        """Add a stamp (s) received at a time (s); return whether it is usable.

        A stamp of zero is counted and not usable, unless the receiver's clock is near zero too, as
        simulated time is at first.
        """
        if stamp == 0.0 and now > CLOCKS_APART:
            self.unstamped[topic] = self.unstamped.get(topic, 0) + 1
            self._ahead.pop(topic, None)  # its stamps before no longer matter
            return False
        self._ahead.setdefault(topic, deque(maxlen=_SAMPLES)).append(stamp - now)
        return True

    def ahead(self) -> dict[str, float]:
        """Return by how much (s) the stamps of each topic are ahead of the clock.

        Messages come late, as in a burst after start-up, but never early: of the newest, the least
        delayed one tells the offset of the clocks.
        """
        return {
            topic: max(values) for topic, values in self._ahead.items() if len(values) >= _MINIMUM
        }

    def problems(self, reference: str) -> dict[str, StampProblem]:
        """Return topic -> what is wrong with its stamps.

        reference: topic with which the others are compared first; its own stamps, and those of
        others if it has none, are compared with the clock.
        """
        found = {
            topic: StampProblem(
                f'{count} messages have the stamp zero; the time of receipt is used', 'zero'
            )
            for topic, count in self.unstamped.items()
        }
        ahead = self.ahead()
        base = ahead.get(reference, math.nan)
        for topic, value in ahead.items():
            if topic != reference and abs(value - base) > CLOCKS_APART:
                found[topic] = _apart(value - base, f'those of {reference}')
            elif not abs(value) <= CLOCKS_APART:
                found[topic] = _apart(value, 'the clock of this node')
        return found


class NamedProblems:
    """The problems of stamps that have been named; one that changes or returns is named again."""

    def __init__(self) -> None:
        self._named: dict[str, StampProblem] = {}

    def news(self, problems: Mapping[str, StampProblem]) -> list[str]:
        """Return 'topic: problem' for each problem not named yet, and forget those that ended.

        A problem is named again when its kind changes, or its amount doubles or halves.
        """
        self._named = {topic: one for topic, one in self._named.items() if topic in problems}
        found = []
        for topic, problem in sorted(problems.items()):
            named = self._named.get(topic)
            if named is None or not _is_same(named, problem):
                self._named[topic] = problem
                found.append(f'{topic}: {problem.text}')
        return found


def _is_same(named: StampProblem, problem: StampProblem) -> bool:
    if named.kind != problem.kind or named.amount is None or problem.amount is None:
        return named.kind == problem.kind
    return 0.5 * named.amount < problem.amount < 2.0 * named.amount


def _apart(seconds: float, than: str) -> StampProblem:
    relation = f'{"ahead of" if seconds > 0.0 else "behind"} {than}'
    return StampProblem(f'stamps are {abs(seconds):.1f} s {relation}', relation, abs(seconds))
