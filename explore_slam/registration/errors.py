"""The error of this package."""

from explore_slam.errors import ExploreSlamError


class RegistrationError(ExploreSlamError):
    """A cloud, a pose or a covariance cannot be registered as it is."""
