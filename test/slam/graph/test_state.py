import numpy as np
import pytest

from explore_slam.errors import SlamError
from explore_slam.slam.graph import GraphConfig, JointGraph


@pytest.fixture
def world(make_world):
    made = make_world(3, config=GraphConfig(graph_visit_gap=3))
    made.circle(40)
    made.graph.optimize()
    return made


def go_on(graph, world):
    """Use everything; returns all numbers that come out."""
    random = np.random.default_rng(0)
    found = [graph.draw(5, random).poses, graph.covariance(81), graph.path()]
    factor = graph.add_relative_pose(0, 81, [0.1, 0.2, 0.3], np.eye(3))
    graph.remove_landmarks(np.arange(0, 30))
    last = 82
    for k in range(20):
        graph.add_keyframe(k % 2, last + k, [0.4, 0.0, 0.2], 1e-4 * np.eye(3), 1e-4 * np.eye(3))
        z = np.array([[2.0, 0.1 * k, 1.0], [1.0, -1.0, 0.5]])
        graph.add_observations(last + k, [35, 36], z, np.tile([0.1, 0, 0, 0.1, 0, 0.1], (2, 1)))
    graph.optimize()
    stored = graph.observations_of(np.arange(world.landmarks))
    found += [graph.draw(5, random).poses, graph.path(), graph.landmarks()[1]]
    return [*found, np.array(factor), graph.live_keyframes(), *stored]


def test_restored_graph_goes_on_bit_by_bit(world):
    state = {name: value.copy() for name, value in world.graph.state_dict().items()}
    restored = JointGraph.from_state(state, world.graph.config)
    for a, b in zip(go_on(world.graph, world), go_on(restored, world), strict=True):
        np.testing.assert_array_equal(a, b)


def test_state_is_made_of_arrays_that_the_graph_does_not_share(world):
    state = world.graph.state_dict()
    copies = {name: value.copy() for name, value in state.items()}
    go_on(world.graph, world)
    for name, value in state.items():
        assert value.dtype != np.object_
        np.testing.assert_array_equal(value, copies[name])


def test_empty_graph_has_a_state():
    graph = JointGraph.from_state(JointGraph().state_dict())
    graph.add_start(4, 0, [0, 0, 0])
    assert graph.optimize().keyframes == 1


def test_truncated_state_is_refused(world):
    state = world.graph.state_dict()
    state['storage/observations/z'] = state['storage/observations/z'][:-1]
    with pytest.raises(SlamError, match='state of observations: z has shape'):
        JointGraph.from_state(state)
    del state['storage/observations/z']
    with pytest.raises(SlamError, match='state of observations: z has shape None'):
        JointGraph.from_state(state)
