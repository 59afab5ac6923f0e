"""The errors that the package raises on purpose: one root, one subclass per package."""


class ExploreSlamError(Exception):
    """Root of all errors; messages name the input, the value and what was expected."""


class ConfigError(ExploreSlamError):
    """A setting is unknown, of the wrong type or out of range."""


class MachineError(ExploreSlamError):
    """A variable of the shell, a folder or a library of this machine cannot be used."""


class DataError(ExploreSlamError):
    """A record (scan, frame, odometry, observations) is malformed."""


class VisionError(ExploreSlamError):
    """A frame cannot be turned into landmark observations."""


class RegistrationError(ExploreSlamError):
    """A point cloud, a pose or a covariance is not one that scans can be registered with."""


class SlamError(ExploreSlamError):
    """The filter rejects an input, or a saved state is unusable; the filter is unchanged."""


class MappingError(ExploreSlamError):
    """A scan does not fit the grid, or a map file cannot be read or written."""


class ExplorationError(ExploreSlamError):
    """Frontiers, costs, targets or paths cannot be computed from this input."""


class AgentError(ExploreSlamError):
    """The agent rejects an input or a request."""


class VehicleError(ExploreSlamError):
    """A base, laser, camera or their connection does not work as commanded."""


class SimulationError(ExploreSlamError):
    """A world, a simulated vehicle or the renderer cannot be created."""


class RecordingError(ExploreSlamError):
    """A bag or a data set is missing, truncated or incomplete."""


class EvaluationError(ExploreSlamError):
    """Metrics, reports or experiments cannot be computed from this input."""
