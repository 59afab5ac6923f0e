"""Diagnostics of the agent node: rates, latency, drops, effective particles, vehicle states."""

import time
from collections import Counter, defaultdict, deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from explore_slam.agent import KeyframeEvent
from explore_slam.data import VehicleState, VehicleStatus
from explore_slam.exploration import PlanningResult
from explore_slam.messages.frame_pairing import FRAME
from explore_slam.nodes.agent_inputs import VehicleInputs
from explore_slam.nodes.inbox import Inbox
from explore_slam.nodes.node_support import OK, WARN

WINDOW = 10.0  # s over which rates are averaged
BEHIND = 2.0  # s that measurements wait for the agent, from which on it counts as behind
KEPT = 2000  # newest latencies kept
Part = tuple[bytes, str, Mapping[str, Any]]

# states of a vehicle that need the attention of the operator
_WARNED = {
    VehicleState.LOST, VehicleState.SILENT, VehicleState.BLOCKED, VehicleState.UNLOCALIZED,
    VehicleState.BATTERY_CRITICAL,
}  # fmt: skip


def explain_delay(inbox: Inbox) -> str:
    """Return by how much the agent is behind, and what waits; '' if it is not."""
    delay = inbox.delay
    if delay <= BEHIND:
        return ''
    waiting = ', '.join(
        f'{source} {kind} {count}' for (kind, source), count in sorted(inbox.waiting().items())
    )
    return (
        f'the agent is {delay:.1f} s behind its measurements ({waiting} wait): send scans and '
        'frames less often, lower the number of particles, or use a faster computer'
    )


class AgentStatistics:
    """Collects figures on the worker's thread; `parts` returns the diagnostics."""

    def __init__(self) -> None:
        self._busy: defaultdict[str, float] = defaultdict(float)
        self._done: Counter[str] = Counter()
        self._keyframes: dict[str, deque[float]] = {}
        self._last: dict[str, KeyframeEvent] = {}
        self._latency: deque[float] = deque(maxlen=KEPT)
        self._wall_latency: deque[float] = deque(maxlen=KEPT)
        self._began = time.monotonic()

    @contextmanager
    def timed(self, kind: str) -> Iterator[None]:
        """Count one piece of work and measure its duration."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self._busy[kind] += time.perf_counter() - start
            self._done[kind] += 1

    def add_keyframe(self, event: KeyframeEvent, now: float, received: float | None) -> None:
        """Add a keyframe whose pose has just been published.

        now: ROS time (s). received: time.monotonic() at which its image arrived, None if unknown.
        """
        self._keyframes.setdefault(event.vehicle, deque()).append(time.monotonic())
        if event.update is None:
            return
        self._last[event.vehicle] = event
        self._latency.append(now - event.stamp)
        if received is not None:
            self._wall_latency.append(time.monotonic() - received)

    def _rate(self, vehicle: str) -> float:
        times = self._keyframes.get(vehicle, deque())
        now = time.monotonic()
        while times and times[0] < now - WINDOW:
            times.popleft()
        return len(times) / min(WINDOW, max(now - self._began, 1e-3))

    def parts(
        self,
        statuses: Iterable[VehicleStatus],
        figures: Mapping[str, Mapping[str, float | str]],
        inputs: Iterable[VehicleInputs],
        inbox: Inbox,
        planning: PlanningResult,
        warnings: Mapping[str, str],
    ) -> dict[str, Part]:
        """Return name -> (level, message, values) for the agent and for every vehicle.

        figures: further values by vehicle. warnings: what else is wrong with each vehicle, or ''.
        """
        by_vehicle = {one.vehicle: one for one in inputs}
        parts = {'agent': self._agent(inbox, planning)}
        for status in statuses:
            name = status.vehicle
            values = self._vehicle(status, by_vehicle[name], inbox)
            values.update(figures.get(name, {}))
            bad = status.state in _WARNED
            problems = sorted(by_vehicle[name].clock_problems().items())
            clocks = [f'{topic}: {problem.text}' for topic, problem in problems]
            warning = warnings.get(name, '')
            poor = str(values.get('odometry_problem', ''))
            bad |= bool(clocks or warning or poor)
            waits = planning.waiting.get(name, '')
            if status.state is VehicleState.UNLOCALIZED:
                waits = 'start pose unknown, not found in the map yet'
            reason = '; '.join(filter(None, [waits, warning, *clocks, poor]))
            text = status.state.value + (f': {reason}' if reason else '')
            parts[f'vehicle {name}'] = (WARN if bad else OK, text, values)
        return parts

    def _agent(self, inbox: Inbox, planning: PlanningResult) -> Part:
        values: dict[str, Any] = {
            'status': planning.status.value,
            'reason': planning.reason,
            'frontiers': len(planning.frontiers),
            'unreached_frontiers': planning.unreachable,
            'unreached_m2': planning.unreached_m2,
            'waiting': len(inbox),
            'delay_s': inbox.delay,
            'dropped': sum(inbox.dropped.values()),
        }
        for name, samples in (('ros', self._latency), ('wall', self._wall_latency)):
            if samples:
                values[f'{name}_latency_median_s'] = float(np.median(samples))
                values[f'{name}_latency_p95_s'] = float(np.percentile(samples, 95))
        for kind, count in self._done.items():
            values[f'{kind}_mean_ms'] = 1e3 * self._busy[kind] / count
            values[f'{kind}_count'] = count
        behind = explain_delay(inbox)
        level = WARN if behind or planning.warning or not planning.searched else OK
        reason = planning.reason or planning.status.value
        text = '; '.join(filter(None, (reason, planning.warning)))
        return level, behind or text, values

    def _vehicle(
        self, status: VehicleStatus, inputs: VehicleInputs, inbox: Inbox
    ) -> dict[str, Any]:
        name = status.vehicle
        deviation = np.sqrt(np.maximum(np.diag(status.covariance), 0.0))
        values: dict[str, Any] = {'state': status.state.value}
        if status.state is not VehicleState.UNLOCALIZED:
            values |= {
                'x': status.pose.x,
                'y': status.pose.y,
                'heading': status.pose.theta,
                'position_deviation_m': float(np.hypot(deviation[0], deviation[1])),
                'heading_deviation_rad': float(deviation[2]),
            }
        values |= {
            'goal': '' if status.goal is None else f'{status.goal.x:.2f} {status.goal.y:.2f}',
            'keyframes_per_second': self._rate(name),
            **inputs.losses(),
            'dropped_frames': inbox.dropped[(FRAME.name, name)],
        }
        last = self._last.get(name)
        if last is not None and last.update is not None:
            update = last.update
            values['observed'] = update.observed
            values['associated'] = update.associated
            values['inserted'] = update.inserted
            values['effective_particles'] = float(update.effective_particles)
            others = [vehicle for vehicle in update.together if vehicle != name]
            values['shares_landmarks_with'] = ' '.join(others) or 'none'
        return values
