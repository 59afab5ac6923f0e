"""The engines by the name of the setting `engine`."""

from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.update.engine import Engine
from explore_slam.slam.update.fastslam2_engine import FastSlam2Engine
from explore_slam.slam.update.paper_engine import PaperEngine


def make_engine(config: FastSlamConfig) -> Engine:
    """Return the engine that the settings name."""
    return PaperEngine(config) if config.engine == 'paper' else FastSlam2Engine(config)
