"""The table of measurement kinds: unknown records, a kind of one's own."""

from dataclasses import dataclass

import pytest
from synthetic import SyntheticVehicle, SyntheticWorld

from explore_slam.agent import Agent, AgentConfig, measurements
from explore_slam.agent.measurements.kind import MeasurementHandler
from explore_slam.errors import AgentError
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values

START = Pose2(-1.0, -1.5, 0.0)


@dataclass(frozen=True)
class Bump:
    stamp: float


def make_agent():
    agent = Agent(with_values(AgentConfig(), {'particles': 20}), {'robot1': START}, 1)
    return agent, SyntheticVehicle(SyntheticWorld(), START)


def test_unknown_records_are_named_and_change_nothing():
    agent, _ = make_agent()
    with pytest.raises(AgentError, match=r"measurement is a Bump, expected one of .*'LaserScan'"):
        agent.add('robot1', Bump(1.0))
    assert len(agent.track('robot1').waiting) == 0
    assert agent.summary()['robot1'] == {'odometry_resets': 0}


def test_another_kind_is_an_entry_of_the_table(monkeypatch):
    processed = []

    def process(_team, track, bump):
        processed.append((track.name, bump.stamp))

    def check(_team, bump):
        if bump.stamp > 100.0:
            raise AgentError('too far ahead')

    kind = MeasurementHandler(Bump, process, check)
    monkeypatch.setitem(measurements._BY_RECORD, Bump, kind)
    agent, vehicle = make_agent()
    agent.add('robot1', vehicle.advance())
    agent.add('robot1', Bump(0.15))
    agent.add('robot1', vehicle.advance())
    assert processed == []
    agent.add('robot1', vehicle.advance())
    assert processed == [('robot1', 0.15)]
    with pytest.raises(AgentError, match='too far ahead'):
        agent.add('robot1', Bump(101.0))


def test_every_kind_has_a_record_type_of_its_own():
    assert len({kind.record for kind in measurements.KINDS}) == len(measurements.KINDS) >= 4
