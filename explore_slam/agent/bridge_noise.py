"""Noise of the odometry between two matched scans, as the matches show it.

Between two poses that scans have measured, odometry errs like a Brownian bridge, in proportion to
the variance of its motion from one to the other. That variance by the settings holds for the worst
of wheels and for any floor; how far matches are from where the odometry leads is measured several
times a second, and scales it (covariance matching; Mehra, "Approaches to adaptive filtering", IEEE
Transactions on Automatic Control, 1972).
"""

import numpy as np

from explore_slam.geometry import Array, Pose2

# Chosen by hand: a vehicle matches 5 to 10 scans a second, so that what is known beforehand counts
# as much as 2 to 4 s of driving, and the floor may change within half a minute.
_PRIOR_MATCHES = 20.0  # that what is known beforehand counts as
_MEMORY = 200.0  # matches
# m, rad: odometry that is more uncertain knows next to nothing, as at the start of one by scans
# alone; being right by chance then would count for more than all that follows.
_VAGUE = 0.1
# Deviations from the odometry beyond which a single match, as after a slip, widens its own bridge.
_SIGMAS = 3.0


class BridgeNoise:
    """Scales the covariance of a vehicle's odometry between matches; positions and headings apart.

    A match has errors of its own, and odometry systematic ones, which lead along the bridge and
    not off it: both count as noise here, so that the scale is rather too large than too small.
    """

    def __init__(self) -> None:
        self._squares, self._expected = np.zeros(2), np.zeros(2)  # sums, of position and heading
        self._matches = np.zeros(2)

    @property
    def scale(self) -> Array:
        """Scale (2,) of the variances of position and heading."""
        known = self._expected > 0.0
        shown = np.divide(self._squares, self._expected, out=np.ones(2), where=known)
        scale: Array = (_PRIOR_MATCHES + self._matches * shown) / (_PRIOR_MATCHES + self._matches)
        return scale

    def scaled(self, off: Pose2, covariance: Array) -> Array:
        """Take a match; return the covariance (3, 3) of the odometry up to it, scaled.

        off: pose of the match in the frame of where the odometry leads, with covariance (3, 3).
        """
        squares = np.array([off.x**2 + off.y**2, off.theta**2])
        expected = np.array([covariance[0, 0] + covariance[1, 1], covariance[2, 2]])
        counts = np.where(expected < _VAGUE**2, 1.0, 0.0)
        kept = 1.0 - counts / _MEMORY
        self._squares = kept * self._squares + counts * squares
        self._expected = kept * self._expected + counts * expected
        self._matches = kept * self._matches + counts
        outlying = squares / np.maximum(_SIGMAS**2 * expected, np.finfo(np.float64).tiny)
        position, heading = np.sqrt(np.maximum(self.scale, outlying))
        factors = np.array([position, position, heading])
        scaled: Array = factors[:, None] * covariance * factors
        return scaled
