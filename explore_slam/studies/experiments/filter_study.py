"""The filter itself on real frames with truth: are the landmarks that it updates those it sees."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from explore_slam.geometry import Array, Pose2, wrap_angles
from explore_slam.settings import with_values
from explore_slam.slam import FastSlam, FastSlamConfig
from explore_slam.studies.experiments.association_study import TOLERANCE
from explore_slam.studies.experiments.scenarios import Noise
from explore_slam.studies.experiments.trials import rms
from explore_slam.studies.experiments.tum_frames import TumFrame

VEHICLE = 'camera'
# truth itself errs by millimetres, and a shutter that rolls bends frames taken while turning
TRUTH_ERROR = 0.005


@dataclass(frozen=True)
class FilterRun:
    """Landmarks updated over all frames, how many of them rightly; errors of pose; odometry's."""

    right: int
    total: int
    position_rms: float
    heading_rms: float
    odometry_rms: float

    @property
    def precision(self) -> float:
        """Share of updates that were right; NaN without any."""
        return self.right / self.total if self.total else float('nan')


def run_filter(frames: Sequence[TumFrame], config: FastSlamConfig, seed: int) -> FilterRun:
    """Run the filter over the frames as the camera of a planar vehicle with drawn odometry noise.

    An update of a landmark is right when truth puts the point that the best particle took for it
    within TOLERANCE of where truth put the point that it was made of.
    """
    rng = np.random.default_rng(seed)
    slam = FastSlam({VEHICLE: frames[0].pose}, config, seed)
    places: dict[int, Array] = {}
    right = total = 0
    errors, drift, drifting = [], [], frames[0].pose
    previous = frames[0].pose
    for frame in frames:
        true = previous.between(frame.pose)
        covariance = Noise().motion_covariance(true) + np.diag([TRUTH_ERROR**2] * 2 + [0.0])
        noisy = np.add(true, rng.multivariate_normal(np.zeros(3), covariance, method='cholesky'))
        increment, previous = Pose2.from_array(noisy), frame.pose
        slam.predict(VEHICLE, increment, covariance)
        drifting = drifting.compose(increment)
        if not len(frame.observations):
            continue
        matches = slam.update(VEHICLE, frame.observations).matches
        for point, number in zip(frame.points, matches.tolist(), strict=True):
            if number in places:
                total += 1
                right += bool(np.linalg.norm(point - places[number]) <= TOLERANCE)
        known = slam.landmarks()
        for number, descriptor in zip(known.ids.tolist(), known.descriptors, strict=True):
            if number not in places:
                places[number] = _place(frame, descriptor)
        estimate, _ = slam.estimate(VEHICLE)
        errors.append(np.subtract(estimate, frame.pose))
        drift.append(np.subtract(drifting, frame.pose))
    table, odometry = np.array(errors), np.array(drift)
    return FilterRun(
        right,
        total,
        rms(np.hypot(table[:, 0], table[:, 1])),
        rms(wrap_angles(table[:, 2])),
        rms(np.hypot(odometry[:, 0], odometry[:, 1])),
    )


def filter_config(e0: float, particles: int) -> FastSlamConfig:
    """Return the settings of the default engine with this E0."""
    return with_values(
        FastSlamConfig(), {'particles': particles, 'maximum_descriptor_distance': e0}
    )


def _place(frame: TumFrame, descriptor: Array) -> Array:
    """Return the true place (3,) m of the observation that a new landmark was made of."""
    likeness = frame.observations.descriptors @ descriptor
    place: Array = frame.points[int(np.argmax(likeness))]
    return place
