"""What one beam says, by its range (REP-117)."""

import numpy as np

from explore_slam.mapping.ray_model import FREE_ONLY, HIT, classify_beams


def test_no_return_frees_no_further_than_the_scanner_can_measure():
    ranges = np.array([np.inf, 9.5, 3.0], np.float32)
    lengths, kinds = classify_beams(ranges, 0.05, 8.0, 20.0, 10.0)
    np.testing.assert_allclose(lengths, [8.0, 8.0, 3.0])
    assert kinds.tolist() == [FREE_ONLY, FREE_ONLY, HIT]
