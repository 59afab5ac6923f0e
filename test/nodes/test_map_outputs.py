"""`map` over real DDS, read as AMCL and as the StaticLayer of nav2 read it."""

import time

import numpy as np
import pytest
import rclpy
from nav_msgs.msg import OccupancyGrid as GridMessage
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from ros_domain import own_domain

from explore_slam.data import LaserScan
from explore_slam.geometry import Pose2
from explore_slam.mapping import OccupancyGrid
from explore_slam.messages.maps import changed_rectangle, grid_arrays
from explore_slam.nodes.map_outputs import MapOutputs

DOMAIN = own_domain(94)
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
FREE_SPACE, LETHAL_OBSTACLE, NO_INFORMATION = 0, 254, 255  # costs of nav2_costmap_2d


def amcl_states(message):
    """Return the cells as nav2_amcl converts them: -1 free, 1 occupied, 0 unknown."""
    cells, _, _ = grid_arrays(message)
    return np.where(cells == 0, -1, np.where(cells == 100, 1, 0))


def static_layer_costs(message, lethal_threshold=100, unknown_value=255):
    """Return the costs of nav2's StaticLayer: trinary_costmap, track_unknown_space."""
    cells, _, _ = grid_arrays(message)
    values = cells.astype(np.uint8)  # -1 arrives as 255
    costs = np.where(values >= lethal_threshold, LETHAL_OBSTACLE, FREE_SPACE)
    return np.where(values == unknown_value, NO_INFORMATION, costs)


def room(side=2.0):
    """Return a grid of one room, seen thrice from its middle."""
    grid = OccupancyGrid()
    angles = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    ranges = side / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    scan = LaserScan(1.0, -np.pi, angles[1] - angles[0], ranges.astype(np.float32), 0.1, 10.0)
    for _ in range(3):
        grid.insert_scan(Pose2(0.0, 0.0, 0.0), scan)
    return grid


@pytest.fixture
def nodes():
    """Return a publishing and a listening node, and a function that spins until a condition."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    executor = SingleThreadedExecutor(context=context)
    made = [rclpy.create_node(name, context=context) for name in ('maps', 'reader')]
    for node in made:
        executor.add_node(node)

    def spin_until(condition, seconds=20.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, 'nothing arrived'
            executor.spin_once(timeout_sec=0.02)

    yield *made, spin_until
    for node in made:
        node.destroy_node()
    rclpy.shutdown(context=context)


def test_amcl_and_the_static_layer_find_the_walls_and_the_free_space(nodes):
    sender, reader, spin_until = nodes
    heard = {}
    outputs, grid = MapOutputs(sender), room()
    outputs.publish(3.0, 'map', grid)
    for name in ('map', 'map_probability'):  # late joiners get the latched messages
        reader.create_subscription(
            GridMessage, name, lambda m, name=name: heard.update({name: m}), LATCHED
        )
    spin_until(lambda: len(heard) == 2)
    message = heard['map']
    states, costs = amcl_states(message), static_layer_costs(message)
    inside = tuple(grid.to_cell([(0.5, 0.5)])[0])
    walls = tuple(grid.to_cell([(2.0, 0.3), (-2.03, 0.3), (0.3, -2.03)]).T)
    beyond = tuple(grid.to_cell([(2.0, 2.0)])[0] + 1)
    assert states[inside] == -1
    assert costs[inside] == FREE_SPACE
    assert (states[walls] == 1).all()
    assert (costs[walls] == LETHAL_OBSTACLE).all()
    if grid.contains([beyond])[0]:
        assert states[beyond] == 0
        assert costs[beyond] == NO_INFORMATION
    # what is known to be a wall is one for both, and nothing else is
    occupied = grid.probability() >= grid.config.map_occupied_threshold
    assert np.count_nonzero(occupied) > 250
    assert np.array_equal(states == 1, occupied)
    assert np.array_equal(costs == LETHAL_OBSTACLE, occupied)
    assert np.array_equal(costs == NO_INFORMATION, states == 0)
    percent, _, _ = grid_arrays(heard['map_probability'])
    assert set(np.unique(grid_arrays(message)[0])) == {-1, 0, 100}
    assert np.array_equal(percent, grid.to_percent())
    assert np.array_equal(percent < 0, ~grid.known())


def test_updates_bring_a_receiver_to_the_same_map(nodes):
    update = pytest.importorskip('map_msgs.msg', reason='map_msgs is not installed')
    sender, reader, spin_until = nodes
    maps, updates = [], []
    outputs, grid = MapOutputs(sender), room()
    assert not outputs.wants_updates
    reader.create_subscription(GridMessage, 'map', maps.append, LATCHED)
    reader.create_subscription(update.OccupancyGridUpdate, 'map_updates', updates.append, 10)
    spin_until(lambda: outputs.wants_updates)
    outputs.publish(3.0, 'map', grid)
    spin_until(lambda: maps)
    outputs.publish_update(3.5, 'map', grid)  # nothing has changed
    obstacle = LaserScan(4.0, 0.0, 0.01, np.full(10, 1.0, np.float32), 0.1, 10.0)
    for _ in range(6):
        grid.insert_scan(Pose2(0.0, 0.0, 0.0), obstacle)
    outputs.publish_update(4.0, 'map', grid)
    spin_until(lambda: updates)
    assert len(updates) == 1
    patch = updates[0]
    assert patch.header.frame_id == 'map'
    assert patch.width * patch.height == len(patch.data) < 200
    cells, _, _ = grid_arrays(maps[0])
    patched = cells.copy()
    block = np.array(patch.data, np.int8).reshape(patch.height, patch.width)
    patched[patch.y : patch.y + patch.height, patch.x : patch.x + patch.width] = block
    assert not np.array_equal(patched, cells)
    assert np.array_equal(patched, grid.to_trinary())
    far = LaserScan(5.0, 0.0, 0.01, np.full(10, 9.0, np.float32), 0.1, 10.0)
    grid.insert_scan(Pose2(0.0, 0.0, 0.0), far)
    outputs.publish_update(5.0, 'map', grid)  # the grid has grown: the next map shows it
    outputs.publish(5.5, 'map', grid)
    spin_until(lambda: len(maps) == 2)
    assert len(updates) == 1
    assert np.array_equal(grid_arrays(maps[1])[0], grid.to_trinary())


def block_of(update):
    """Return rows, columns and cells of an update."""
    rows = slice(update.y, update.y + update.height)
    columns = slice(update.x, update.x + update.width)
    return rows, columns, np.array(update.data, np.int8).reshape(update.height, update.width)


def test_who_joins_between_two_maps_is_up_to_date_with_the_next_update(nodes):
    update = pytest.importorskip('map_msgs.msg', reason='map_msgs is not installed')
    sender, reader, spin_until = nodes
    early, late = {}, {}

    def join(heard):
        def on_map(message):
            heard['map'] = grid_arrays(message)[0].copy()

        def on_update(message):
            rows, columns, cells = block_of(message)
            heard['map'][rows, columns] = cells
            heard['updates'] = heard.get('updates', 0) + 1

        reader.create_subscription(GridMessage, 'map', on_map, LATCHED)
        spin_until(lambda: 'map' in heard)
        before = sender.count_subscribers('map_updates')
        reader.create_subscription(update.OccupancyGridUpdate, 'map_updates', on_update, 10)
        spin_until(lambda: sender.count_subscribers('map_updates') > before)

    def insert_obstacle(heading):
        scan = LaserScan(4.0, 0.0, 0.01, np.full(10, 1.0, np.float32), 0.1, 10.0)
        for _ in range(6):
            grid.insert_scan(Pose2(0.0, 0.0, heading), scan)

    outputs, grid = MapOutputs(sender), room()
    outputs.publish(1.0, 'map', grid)
    first = grid.to_trinary()
    join(early)
    insert_obstacle(0.0)
    outputs.publish_update(2.0, 'map', grid)
    spin_until(lambda: early.get('updates') == 1)
    join(late)
    insert_obstacle(2.0)
    outputs.publish_update(3.0, 'map', grid)
    outputs.publish_update(3.1, 'map', grid)  # nothing new
    spin_until(lambda: late.get('updates') == 1 and early['updates'] == 2)
    for heard in (early, late):
        assert np.array_equal(heard['map'], grid.to_trinary())
    outputs.publish_update(4.0, 'map', room())  # all is again as the map has it
    spin_until(lambda: late['updates'] == 2 and early['updates'] == 3)
    for heard in (early, late):
        assert np.array_equal(heard['map'], first)


def test_there_is_no_map_before_there_are_data(nodes):
    sender, reader, spin_until = nodes
    maps = []
    outputs = MapOutputs(sender)
    reader.create_subscription(GridMessage, 'map', maps.append, LATCHED)
    outputs.publish(1.0, 'map', OccupancyGrid())
    outputs.publish(2.0, 'map', room())
    spin_until(lambda: maps)
    assert len(maps) == 1
    assert maps[0].info.width > 0


def test_the_changed_rectangle_holds_all_changes():
    before = np.zeros((5, 7), np.int8)
    after = before.copy()
    assert changed_rectangle(before, after) is None
    after[1, 5] = after[3, 2] = 100
    rows, columns = changed_rectangle(before, after)
    assert (rows, columns) == (slice(1, 4), slice(2, 6))
