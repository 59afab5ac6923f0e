"""Bags without ROS: reading, writing, repair, replay through the agent, importers of data sets."""

from explore_slam.messages.topics import TopicKind
from explore_slam.recording.bag import BagReader, BagWriter
from explore_slam.recording.events import Event
from explore_slam.recording.replay import Replay

__all__ = ['BagReader', 'BagWriter', 'Event', 'Replay', 'TopicKind']
