"""Every setting of loop closing changes the closures; a new one without a test fails here."""

import pytest
from slam.closures.drives import Vehicle, along, drive
from slam.closures.test_loop_search import LAP, OFFICE

from explore_slam.settings import settings_of, with_values
from explore_slam.slam.closures import ClosureConfig

# Of the agent, which asks for closures: test/agent/test_settings_have_effects.py.
OF_THE_AGENT = {'laser_closures'}


def closures_of(run):
    return [(c.keyframe_a, c.keyframe_b, tuple(c.pose)) for c in run.search.closures]


def lap(config, calibrated=True):
    """Return the closures at the end of a lap by drifting wheels.

    calibrated: the graph says how uncertain the poses are; else errors grow with the distance,
    and the windows are wide.
    """
    vehicle = Vehicle(along(*LAP, LAP[1]), way_scale=1.02, noise=0.01)
    run = drive(lambda *_: OFFICE, [vehicle], config=config, calibrated=calibrated)
    return closures_of(run)


def lap_with_wide_windows(config):
    return lap(config, calibrated=False)


def side_by_side(config):
    """Return the closures of two vehicles that drive 1 m from each other."""
    routes = along((1.8, 1.4), (6.8, 1.4)), along((1.8, 2.4), (6.8, 2.4))
    vehicles = [Vehicle(route) for route in routes]
    return closures_of(drive(lambda *_: OFFICE, vehicles, config=config))


EFFECTS = {
    'closure_every': (3, lap),
    'closure_minimum_distance': (40.0, lap),
    'closure_delay': (0.0, side_by_side),
    'closure_widest_window': (0.5, lap),
    'closure_score': (0.95, lap),
    'closure_overlap': (1.0, lap),
    'closure_rms': (0.005, lap),
    'closure_other_mode': (0.0, lap),
    'closure_agreements': (20, lap_with_wide_windows),
}


@pytest.fixture(scope='module')
def usual():
    """Closures by the usual settings, which many effects are compared with."""
    return {experiment: experiment(ClosureConfig()) for _, experiment in EFFECTS.values()}


@pytest.mark.parametrize('name', EFFECTS)
def test_every_setting_changes_the_closures(name, usual):
    value, experiment = EFFECTS[name]
    assert experiment(with_values(ClosureConfig(), {name: value})) != usual[experiment]


def test_the_same_settings_give_the_same(usual):
    assert lap(ClosureConfig()) == usual[lap]
    assert usual[lap]


def test_no_setting_is_left_out():
    assert {info.name for info, _ in settings_of(ClosureConfig())} == {*EFFECTS, *OF_THE_AGENT}
