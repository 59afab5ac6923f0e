"""State of a filter as named arrays, and back; a friend of FastSlam that knows its insides."""

from typing import TYPE_CHECKING

import numpy as np

from explore_slam.errors import SlamError
from explore_slam.geometry import Pose2
from explore_slam.settings import values_of, with_values
from explore_slam.slam import checkpoint
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.particles.group import Group
from explore_slam.slam.relocalization import Matches, Recovery
from explore_slam.slam.storage.ancestry import Genealogy
from explore_slam.slam.storage.row_store import RowStore

if TYPE_CHECKING:
    from explore_slam.slam.fast_slam import FastSlam


def state_of(slam: 'FastSlam') -> State:
    """Return the whole state of a filter."""
    pending = [
        [vehicle, *mean, *covariance.ravel()]
        for vehicle, motion in enumerate(slam._pending)
        for mean, covariance in motion.segments
    ]
    about = {
        'settings': values_of(slam.config),
        'vehicles': list(slam.vehicles),
        'random': slam._random.bit_generator.state,
        'contributed': sorted(slam._contributed),
        'groups': [[group.vehicles, len(group.genealogies)] for group in slam.groups.all],
        'regions': [[x, y, owner] for (x, y), owner in slam._keeper.regions.items()],
    }
    state = {
        'about': checkpoint.text_array(about),
        'poses': slam._poses,
        'pending': np.array(pending, np.float64).reshape(-1, 13),
        'moved': np.array(slam._moved),
        'stamps': np.array(slam._stamps),
        'path_stamps': np.array(slam.path.stamps, np.float64),
        'path_vehicles': np.array(slam.path.vehicles, np.int64),
        **under('map', checkpoint.map_state(slam.map)),
        **under('path', checkpoint.store_state(slam.path.rows)),
    }
    for number, group in enumerate(slam.groups.all):
        state |= under(f'group{number}', _group_state(group, [slam.map.rows, slam.path.rows]))
    for number, recovery in enumerate(slam._recovery):
        state |= under(f'recovery{number}', _recovery_state(recovery))
    return {name: np.array(value) for name, value in state.items()}


def restored[T: 'FastSlam'](cls: type[T], state: State) -> T:
    """Make a filter of a state; SlamError where something is absent or of the wrong shape."""
    try:
        about = checkpoint.text_value(state['about'])
        starts = dict.fromkeys(about['vehicles'], Pose2(0.0, 0.0, 0.0))
        slam = cls(starts, with_values(FastSlamConfig(), about['settings']))
        slam._random.bit_generator.state = about['random']
        slam._contributed = set(about['contributed'])
        slam._keeper.regions.update({(x, y): owner for x, y, owner in about['regions']})
        _restore_arrays(slam, state)
        stores = [slam.map.rows, slam.path.rows]
        slam.groups.all = [
            _restored_group(vehicles, trees, stores, part(f'group{number}', state))
            for number, (vehicles, trees) in enumerate(about['groups'])
        ]
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise SlamError(f'the state of the belief is not whole: {error!r}') from error
    return slam


def _restore_arrays(slam: 'FastSlam', state: State) -> None:
    slam._poses = state['poses'].copy()
    for row in state['pending']:
        segment = (Pose2(*row[1:4].tolist()), row[4:].reshape(3, 3).copy())
        slam._pending[int(row[0])].segments.append(segment)
    slam._moved = state['moved'].tolist()
    slam._stamps = state['stamps'].tolist()
    slam.path.stamps = state['path_stamps'].tolist()
    slam.path.vehicles = state['path_vehicles'].tolist()
    checkpoint.restore_map(slam.map, part('map', state))
    checkpoint.restore_store(slam.path.rows, part('path', state))
    for number, recovery in enumerate(slam._recovery):
        _restore_recovery(recovery, part(f'recovery{number}', state))


def _group_state(group: Group, stores: list[RowStore]) -> State:
    state: State = {'log_weights': group.log_weights, 'score': group.score}
    for number, genealogy in enumerate(group.genealogies):
        state |= under(f'tree{number}', checkpoint.genealogy_state(genealogy, stores))
    return state


def _restored_group(
    vehicles: list[int], trees: int, stores: list[RowStore], state: State
) -> Group:
    particles = len(state['score'])
    group = Group(vehicles, particles, [Genealogy(particles) for _ in range(trees)])
    group.log_weights, group.score = state['log_weights'].copy(), state['score'].copy()
    for number, genealogy in enumerate(group.genealogies):
        checkpoint.restore_genealogy(genealogy, stores, part(f'tree{number}', state))
    return group


def _recovery_state(recovery: Recovery) -> State:
    state: State = {
        'motion': np.array([*recovery.odometry, recovery.way, recovery.way_driven]),
        'updates': np.array(len(recovery.updates)),
    }
    for number, update in enumerate(recovery.updates):
        state |= under(
            str(number),
            {
                'points': update.points,
                'deviations': update.deviations,
                'alike': update.alike,
                'agreed': update.agreed,
                'way': np.array(update.way),
            },
        )
    return state


def _restore_recovery(recovery: Recovery, state: State) -> None:
    x, y, theta, recovery.way, recovery.way_driven = state['motion'].tolist()
    recovery.odometry = Pose2(x, y, theta)
    for number in range(int(state['updates'])):
        update = part(str(number), state)
        recovery.updates.append(
            Matches(
                update['points'],
                update['deviations'],
                update['alike'],
                update['agreed'],
                float(update['way']),
            )
        )
