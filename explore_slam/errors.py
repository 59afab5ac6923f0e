"""Every error that the package raises on purpose: one root, one subclass per room."""


class ExploreSlamError(Exception):
    """Root of all errors; a message names the input, the value and what was expected."""


class ConfigError(ExploreSlamError):
    """A setting is unknown, of the wrong type or out of its range."""


class DataError(ExploreSlamError):
    """A record (scan, frame, odometry, observations) is malformed."""


class VisionError(ExploreSlamError):
    """A frame cannot be turned into landmark observations."""


class SlamError(ExploreSlamError):
    """The belief refuses an input; its state is unchanged."""


class MappingError(ExploreSlamError):
    """A scan does not fit the grid, or a map file cannot be read or written."""


class ExplorationError(ExploreSlamError):
    """Frontiers, costs, targets or paths cannot be computed from this input."""


class AgentError(ExploreSlamError):
    """The agent refuses an input or a request."""


class VehicleError(ExploreSlamError):
    """A base, laser, camera or its cable does not do what was asked."""


class SimulationError(ExploreSlamError):
    """A world, a simulated vehicle or the renderer cannot be made."""


class RecordingError(ExploreSlamError):
    """A bag or a data set is missing, truncated or lacks what is needed."""


class EvaluationError(ExploreSlamError):
    """Metrics, reports or experiments cannot be computed from this input."""
