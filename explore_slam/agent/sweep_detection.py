"""Whether a lidar measures its beams one after the other, shown by its scans.

Messages of many spinning lidars do not say when their beams are measured, or say it wrongly. Two
scans at different turn rates differ in shape if the beams are measured one after the other, and
agree only when each is undone by the right sweep: all at one moment, forward or backward. At equal
turn rates they agree under each of them, which is why scan matching notices nothing.

Where the message states a duration that does not suit the time between scans, the duration is
tested as well: a sweep from scan to scan, forward or backward, and the stated one.

A wrong stamp shows as well: the turn between two scans then differs from that of odometry in
proportion to the difference of their turn rates, whereas wheels of a wrong size err in proportion
to the turn. Both are estimated together (least squares).
"""

import logging
import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from explore_slam.data import LaserScan, OdometryReading
from explore_slam.errors import RegistrationError
from explore_slam.geometry import IDENTITY, Array, Pose2, wrap_angle
from explore_slam.registration import LocalMap, PointCloud, Prior, SearchWindow, scan_cloud
from explore_slam.sweeps import Sweep, deskewed

logger = logging.getLogger(__name__)

# Where no other source is given, values were chosen on the sensor rig (`benchmark sensors`).
_HISTORY = 4.0  # s of scans that a new one is compared with
_ODOMETRY = 8.0  # s of odometry kept
_FARTHEST = 20.0  # m; returns beyond it are few and far apart
# rad; difference of the turns within two sweeps from which their shapes differ: 6 cm at 3 m
_LEAST_SKEW = 0.04
_MOST_TURN = 2.0  # rad between two scans that are compared: odometry is the first guess
_MOST_TRAVEL = 1.0  # m
# share of the difference of turn rates by which a turn rate may change within its sweep
_STEADY = 0.25
_WINDOW = (0.3, 0.45)  # m, rad around the odometry: 15 % of the turn, and a wrong stamp
_REACH = 0.4  # m, of the alignment at first; it ends at 0.15 m
_NO_PARTNER = 0.08  # m, residual that counts for a return without a surface
_LEAST_SHARE = 0.4  # of the returns that have a surface
_HEADING_DEVIATION = 0.01  # rad, of an alignment; in a round room it does not show the turn
_WEAK = np.diag([1.0 / 0.3**2, 1.0 / 0.3**2, 1.0 / 0.45**2])  # information of the odometry
_FEWEST = 6  # comparisons before a decision
_MOST = 60  # comparisons after which there is no decision
# A shape is found when the squared residuals under every other one are so many times as large, and
# larger in this share of the comparisons. The second row is for real rooms, where edges and rough
# surfaces leave residuals under the right shape too; it asks for more comparisons.
_CRITERIA = ((_FEWEST, 2.0, 0.8), (12, 1.5, 0.95))  # comparisons, factor, share
# The delay of the stamps in units of the sweep: 0 is stamped at the first beam, 1 at the last.
_FIRST, _LAST, _DELAY_DEVIATION = 0.35, 0.65, 0.12

# Share of the time between scans below which a stated duration gives nearly the shape of one
# moment, so that scans could not tell the two apart: at 5.5 Hz and 0.9 rad/s, _LEAST_SKEW.
_NEARLY_MOMENT = 0.25

_SHAPES = ('moment', 'forward', 'backward')
_STATED_SHAPES = ('stated forward', 'stated backward')


@dataclass
class _Probe:
    """A scan with the odometry around it.

    sweeps: shape -> sweep, stamped at its first beam. duration: of the longest one (s).
    at (m,) s and poses (m, 3), headings unwrapped; rate: mean turn rate (rad/s) from a sweep
    before the stamp to one after it; change: of the turn rate between the two halves.
    """

    scan: LaserScan
    sweeps: dict[str, Sweep]
    duration: float
    at: Array
    poses: Array
    laser: Pose2
    rate: float
    change: float
    clouds: dict[str, PointCloud] = field(default_factory=dict)
    maps: dict[str, LocalMap] = field(default_factory=dict)

    def middle(self, shape: str) -> Pose2:
        """Return the odometry pose at the time to which a shape refers the scan."""
        stamp = self.scan.stamp + self.sweeps[shape].middle
        columns = [np.interp(stamp, self.at, c) for c in self.poses.T]
        return Pose2.from_array(columns)

    def cloud(self, shape: str) -> PointCloud:
        """Return the cloud under a shape, stamped at its first beam."""
        if shape not in self.clouds:
            scan = self.scan
            if shape != 'moment':
                scan = deskewed(scan, self.sweeps[shape], self.at, self.poses, self.laser)
            self.clouds[shape] = scan_cloud(scan, self.laser, _FARTHEST)
        return self.clouds[shape]

    def map(self, shape: str) -> LocalMap:
        """Return the cloud as a map."""
        if shape not in self.maps:
            self.maps[shape] = LocalMap.of([self.cloud(shape)], [IDENTITY])
        return self.maps[shape]


class SweepDetector:
    """Compares the scans of one laser until they have shown the timing of its sweeps.

    found: what they have shown; of duration 0: all beams at one moment. None: nothing yet.
    gave_up: they did not show it in many comparisons.
    """

    def __init__(self, vehicle: str) -> None:
        self.vehicle = vehicle
        self.found: Sweep | None = None
        self.gave_up = False
        self._odometry: deque[tuple[float, float, float, float]] = deque()
        self._probes: deque[_Probe] = deque()
        self._costs: list[tuple[float, ...]] = []  # m², per comparison and shape
        self._turns: dict[str, list[tuple[float, float, float]]] = {}  # see _compare
        self._shapes: tuple[str, ...] = _SHAPES
        self._is_stated_tested = False

    @property
    def is_done(self) -> bool:
        """Whether no more scans are compared."""
        return self.gave_up or self.found is not None

    @property
    def comparisons(self) -> int:
        """Number of pairs of scans that were compared."""
        return len(self._costs)

    def add_odometry(self, reading: OdometryReading) -> None:
        """Add a reading as the base reports it: matching would hide the errors of the stamps."""
        if self.is_done:
            return
        x, y, theta = reading.pose
        if self._odometry:
            stamp, _, _, before = self._odometry[-1]
            if reading.stamp <= stamp:
                self.clear()
            else:
                theta = before + wrap_angle(theta - before)
        self._odometry.append((reading.stamp, x, y, theta))
        while self._odometry[0][0] < reading.stamp - _ODOMETRY:
            self._odometry.popleft()

    def clear(self) -> None:
        """Forget odometry and scans: the clock, or the odometry, has jumped."""
        self._odometry.clear()
        self._probes.clear()

    def turn_within(self, scan: LaserScan, duration: float) -> float:
        """Return the largest turn (rad) of the vehicle in a sweep before or after the stamp."""
        table = np.array(self._odometry)
        if not len(table):
            return 0.0
        at = scan.stamp + np.array([-duration, 0.0, duration])
        return float(np.abs(np.diff(np.interp(at, table[:, 0], table[:, 3]))).max())

    def add(self, scan: LaserScan, duration: float, laser: Pose2, stated: float = 0.0) -> None:
        """Compare a scan with an earlier one; odometry has come up to a sweep after its stamp.

        duration: of a sweep, if its beams are measured one after the other (s). laser: its pose in
        the vehicle frame. stated: implausible duration by the message (s), tested too; 0: none.
        """
        if self.is_done:
            return
        if (stated > 0.0) != self._is_stated_tested:
            self._begin_again(duration, stated)
        probe = self._probe(scan, duration, stated, laser)
        if probe is None:
            return
        while self._probes and self._probes[0].scan.stamp < scan.stamp - _HISTORY:
            self._probes.popleft()
        others = [other for other in self._probes if self._tells(other, probe)]
        self._probes.append(probe)
        if not others:
            return
        # of those whose turn rates differ most each in its turn, the newest first: the errors of
        # wheels and stamps can be told apart where the turns between the scans differ
        most = max(abs(other.rate - probe.rate) for other in others)
        chosen = [other for other in others if abs(other.rate - probe.rate) > 0.9 * most]
        self._compare(chosen[-1 - self.comparisons % len(chosen)], probe)
        self._decide(probe, stated)

    def _begin_again(self, duration: float, stated: float) -> None:
        """Forget the comparisons: other shapes are tested from now on."""
        self._probes.clear()
        self._costs.clear()
        self._turns.clear()
        self._is_stated_tested = stated > 0.0
        apart = stated > _NEARLY_MOMENT * duration
        self._shapes = _SHAPES + _STATED_SHAPES if apart else _SHAPES

    def _probe(
        self, scan: LaserScan, duration: float, stated: float, laser: Pose2
    ) -> _Probe | None:
        """Return a scan with its odometry, None where that does not cover it."""
        durations = (0.0, duration, duration, stated, stated)
        sweeps = {
            shape: Sweep(one, shape.endswith('backward'))
            for shape, one in zip(self._shapes, durations, strict=False)
        }
        duration = max(sweep.duration for sweep in sweeps.values())
        table = np.array(self._odometry)
        begin, end = scan.stamp - duration, scan.stamp + duration
        if len(table) < 3 or table[0, 0] > begin or table[-1, 0] < end:
            return None
        low = int(np.searchsorted(table[:, 0], begin, side='right')) - 1
        high = int(np.searchsorted(table[:, 0], end)) + 1
        at, poses = table[low:high, 0], table[low:high, 1:]
        headings = np.interp((begin, scan.stamp, end), table[:, 0], table[:, 3])
        before, after = np.diff(headings) / duration
        rate, change = 0.5 * float(before + after), abs(float(after - before))
        return _Probe(scan, sweeps, duration, at, poses, laser, rate, change)

    @staticmethod
    def _tells(a: _Probe, b: _Probe) -> bool:
        """Return whether the sweeps of two scans differ enough in turn, and each is steady."""
        apart = abs(a.rate - b.rate)
        if apart * b.duration <= _LEAST_SKEW or max(a.change, b.change) >= _STEADY * apart:
            return False
        moved = a.middle('moment').between(b.middle('moment'))
        turned = abs(float(b.poses[0, 2] - a.poses[0, 2]))
        return turned < _MOST_TURN and math.hypot(moved.x, moved.y) < _MOST_TRAVEL

    def _compare(self, a: _Probe, b: _Probe) -> None:
        """Align scan b with scan a under every shape; note the residuals and the turns.

        The turns of a shape: that by odometry (rad), the difference of the turn rates (rad/s), and
        by how much the alignment turns further than odometry (rad).
        """
        costs, turns = [], {}
        for shape in self._shapes:
            prior = a.middle(shape).between(b.middle(shape))
            window = SearchWindow(prior, *_WINDOW)
            cloud = b.cloud(shape)
            try:
                peak = a.map(shape).find_peak(cloud.query_points, window, 0.0)
                start = prior if peak is None else peak.pose
                found = a.map(shape).align(cloud, start, _REACH, Prior(prior, _WEAK))
            except RegistrationError:
                return
            if found is None:
                costs.append(_NO_PARTNER**2)
                continue
            costs.append(found.overlap * found.rms**2 + (1.0 - found.overlap) * _NO_PARTNER**2)
            if found.overlap >= _LEAST_SHARE and _shows_turn(found.information):
                further = wrap_angle(found.pose.theta - prior.theta)
                turns[shape] = (prior.theta, b.rate - a.rate, further)
        if turns:
            self._costs.append(tuple(costs))
            for shape, row in turns.items():
                self._turns.setdefault(shape, []).append(row)

    def _decide(self, probe: _Probe, stated: float) -> None:
        late = self.comparisons >= _MOST
        shape = self._best_shape() if self.comparisons >= _FEWEST else None
        if shape == 'moment':
            # it stands for a stated duration that is too short to be told from it
            self.found = Sweep(0.0 if len(self._shapes) > len(_SHAPES) else stated)
            self._report(self.found, '', probe.scan, stated)
        elif shape is not None:
            sweep = probe.sweeps[shape]
            delay, deviation = self._delay(shape, sweep.duration)
            known = deviation < _DELAY_DEVIATION and (delay < _FIRST or delay > _LAST)
            if known or late:
                self.found = sweep._replace(last=known and delay > _LAST)
                remark = '' if known else ' (the stamp is assumed)'
                self._report(self.found, remark, probe.scan, stated)
        elif late:
            self.gave_up = True
            logger.info(
                '%s: %d comparisons of scans do not show when their beams are measured; they are '
                'used as the messages say%s; set sweep_time if that is wrong',
                self.vehicle,
                self.comparisons,
                f' (a sweep of {stated:.3g} s)' if stated else '',
            )
        if self.is_done:
            self.clear()

    def _report(self, found: Sweep, remark: str, scan: LaserScan, stated: float) -> None:
        """Log what the scans have shown, and what the message states if that is implausible."""
        advice = (
            'with sweep_time, sweep_direction and sweep_stamp set, it is known from the start, '
            'and to the path follower'
        )
        moment = 'that all beams are measured at one moment'
        shown = f'{found}{remark}' if found.duration else moment
        if not stated:
            logger.info(
                '%s: the scans show %s (%d comparisons)%s',
                self.vehicle,
                shown,
                self.comparisons,
                f'; {advice}' if found.duration else '',
            )
            return
        confirmed = found.duration == stated
        logger.log(
            logging.INFO if confirmed else logging.WARNING,
            '%s: time_increment of the scans is %.4g s, a sweep of %.3g s, which is not the time '
            'between scans; the scans show %s (%d comparisons)%s',
            self.vehicle,
            scan.time_increment,
            stated,
            shown,
            self.comparisons,
            '' if confirmed else f'; correct the driver; {advice}',
        )

    def _best_shape(self) -> str | None:
        """Return the shape under which scans agree much better than under the others, or None.

        Of two durations in one direction, the better one suffices: where scans do not tell them
        apart clearly, either is much better than the wrong direction meanwhile.
        """
        costs = np.array(self._costs)
        total = costs.sum(axis=0)
        best = int(np.argmin(total))
        direction = self._shapes[best].split()[-1]
        rivals = [
            index for index, shape in enumerate(self._shapes) if not shape.endswith(direction)
        ]
        wins = (costs[:, rivals] > costs[:, [best]]).mean(axis=0)
        worse = total[rivals] / total[best]
        found = any(
            len(costs) >= fewest and (worse >= factor).all() and (wins >= share).all()
            for fewest, factor, share in _CRITERIA
        )
        return self._shapes[best] if found else None

    def _delay(self, shape: str, duration: float) -> tuple[float, float]:
        """Return by how many sweeps the stamps are late, and the standard deviation of that."""
        table = np.array(self._turns.get(shape, ()))
        if len(table) < _FEWEST:
            return math.nan, math.inf
        design = table[:, :2] * (1.0, duration)
        normal = design.T @ design + np.diag([1e-6, 0.0])
        solution = np.linalg.solve(normal, design.T @ table[:, 2])
        residuals = table[:, 2] - design @ solution
        variance = float(residuals @ residuals) / (len(table) - 2)
        deviation = math.sqrt(max(variance * float(np.linalg.inv(normal)[1, 1]), 0.0))
        return -float(solution[1]), deviation


def _shows_turn(information: Array) -> bool:
    """Return whether the geometry alone fixes the heading of an alignment."""
    across = information[:2, 2]
    values = np.linalg.eigvalsh(information[:2, :2])
    if values[0] <= 0.0:
        return False
    marginal = information[2, 2] - across @ np.linalg.solve(information[:2, :2], across)
    return bool(marginal > 1.0 / _HEADING_DEVIATION**2)
