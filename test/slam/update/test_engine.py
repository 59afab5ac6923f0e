"""What both engines share."""

import numpy as np
import pytest

from explore_slam.slam.update.engine import PoseProposal


def test_the_effective_particles_are_those_after_the_observations():
    weights, likelihoods = np.array([0.4, 0.3, 0.2, 0.1]), np.array([1.5, 2.0, 3.0, 6.0])
    proposal = PoseProposal.at(np.zeros((4, 3)))
    assert proposal.effective_particles(np.log(weights)) == pytest.approx(1 / (weights**2).sum())
    proposal.given.log_likelihoods[:] = np.log(likelihoods)  # all products are equal
    assert proposal.effective_particles(np.log(weights)) == pytest.approx(4.0)
    proposal.given.log_likelihoods[:] = (0.0, -np.inf, -np.inf, -np.inf)
    assert proposal.effective_particles(np.log(weights)) == pytest.approx(1.0)


def test_an_overflow_is_refused():
    proposal = PoseProposal.at(np.zeros((2, 3)))
    assert proposal.checked() is proposal
    proposal.given.log_likelihoods[1] = np.nan
    with pytest.raises(FloatingPointError, match='not finite'):
        proposal.checked()
