"""Bags without ROS: write, read, replay through the agent, import of public data sets."""

from explore_slam.recording.bag import BagReader, BagWriter
from explore_slam.recording.events import Event
from explore_slam.recording.replay import Replay
from explore_slam.recording.topics import TopicKind

__all__ = ['BagReader', 'BagWriter', 'Event', 'Replay', 'TopicKind']
