"""Bias of a gyroscope: estimated while the vehicle stands still, and followed from then on."""

import math

# Of MEMS gyroscopes as small robots have them (InvenSense MPU-6000/MPU-6050, product
# specification PS-MPU-6000A-00, revision 3.4, section 6.1):
# zero-rate output within 20 °/s
_INITIAL_DEVIATION = math.radians(20.0)  # rad/s
# ... which changes by 20 °/s over 125 K: 0.8 °/s in the ten minutes in which a robot warms by 5 K
_DRIFT = math.radians(0.8) ** 2 / 600.0  # rad²/s³
# 0.005 °/s/√Hz; ten times as much on a vehicle that shakes
_LEAST_DENSITY = math.radians(0.05) ** 2  # rad²/s
_LEAST_DEVIATION = 1e-4  # rad/s, of a mean; below the resolution of such a sensor, 0.008 °/s


class GyroBias:
    """Bias (rad/s) of a gyroscope and its variance: a random walk that standstills measure.

    density: of the noise of the rate (rad²/s), measured at standstill, too.
    """

    def __init__(self) -> None:
        self.bias = 0.0
        self.variance = _INITIAL_DEVIATION**2
        self.density = _LEAST_DENSITY
        self.known_at: float | None = None  # stamp (s) of the newest standstill

    @property
    def is_known(self) -> bool:
        """Whether there has been a standstill."""
        return self.known_at is not None

    def add_standstill(self, stamp: float, mean: float, deviation: float, samples: int,
                       duration: float) -> None:  # fmt: skip
        """Take mean and standard deviation (rad/s) of the samples of a standstill (s)."""
        if self.known_at is not None:
            self.variance += _DRIFT * max(stamp - self.known_at, 0.0)
        noise = deviation**2 / samples + _LEAST_DEVIATION**2
        gain = self.variance / (self.variance + noise)
        self.bias += gain * (mean - self.bias)
        self.variance *= 1.0 - gain
        self.density = max(deviation**2 * duration / samples, _LEAST_DENSITY)
        self.known_at = stamp

    def heading_growth(self, begin: float, end: float) -> float:
        """Return by which variance (rad²) the integrated heading grows between two stamps (s).

        The error of the bias is one and the same until the next standstill, so that the variance
        grows with the square of the time since the last one.
        """
        since = 0.0 if self.known_at is None else max(begin - self.known_at, 0.0)
        duration = end - begin
        bias = self.variance * duration * (duration + 2.0 * since)
        return self.density * duration + bias
