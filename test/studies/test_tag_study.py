"""Tags among equal rooms through drawn images, the detector and the agent."""

import json

import numpy as np
import pytest

from explore_slam.cli.main import main
from explore_slam.data import Intrinsics
from explore_slam.errors import ConfigError, EvaluationError
from explore_slam.geometry import Pose2, compose
from explore_slam.simulation.worlds.tagged_rooms import tags_in_view, tags_of_rooms
from explore_slam.simulation.worlds.twin_corridors import twin_corridors
from explore_slam.studies import tag_study
from explore_slam.studies.tag_study import TagStudy, frame_error, run_world
from explore_slam.vision import CameraMount, tags_available

pytestmark = pytest.mark.skipif(not tags_available(), reason='this OpenCV finds no tags')


def test_signs_are_seen_by_vehicles_that_drive_towards_them():
    world, camera = twin_corridors(1), Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)
    mount, tags = CameraMount(0.1, 0.0, 0.4), tags_of_rooms(twin_corridors(1))
    assert len({item.tag for item in tags}) == len(tags) == 24

    def seen(x, y, theta):
        return [t.tag for t in tags_in_view(world, tags, Pose2(x, y, theta), camera, mount)]

    assert seen(9.0, 0.0, 0.0) == [3]  # at 12 m; the next one is too far away
    assert seen(11.5, 0.0, 0.0) == [4]  # the one beside is out of view
    assert seen(9.0, 0.0, np.pi) == []  # signs have one side
    assert seen(9.0, 8.0, np.pi) == [12]  # at 4 m
    assert seen(2.0, 4.0, 0.0) == []  # behind walls


def test_a_wrong_study_is_refused():
    for values, message in [
        ({'worlds': ()}, 'no worlds'),
        ({'surveyed': 3}, 'surveyed is 3'),
        ({'misread': 1.5}, 'misread is 1.5'),
    ]:
        with pytest.raises(EvaluationError, match=message):
            TagStudy(**values)
    with pytest.raises(ConfigError, match='particle'):
        TagStudy(settings={'particle': 3})


def test_the_error_of_a_frame_is_a_rigid_motion():
    random = np.random.default_rng(0)
    estimated = np.column_stack([random.uniform(-9, 9, (50, 2)), np.zeros(50)])
    true = compose(np.array([0.3, -0.4, 0.1]), estimated)
    centre = np.abs(true[:, :2].mean(axis=0) - estimated[:, :2].mean(axis=0))
    assert frame_error(true, estimated) == pytest.approx((np.hypot(*centre), 0.1))


def test_two_vehicles_of_unknown_start_and_two_surveyed_tags(monkeypatch, tmp_path, capsys):
    """A smaller world, with many numbers read wrong: the map is where the survey has it."""
    monkeypatch.setattr('explore_slam.simulation.worlds.twin_corridors.ROOMS', 5)
    study = TagStudy(misread=0.05, settings={'particles': 50, 'laser_closures': False})
    run = run_world(study, 1)
    assert run.misread > 5
    assert run.tags > 150
    assert run.false_closures == run.false_joins == 0
    assert run.tag_closures == run.closures > 5
    assert run.joined_after_m < 30.0
    assert run.frame_m < 0.05
    assert run.frame_deg < 0.5
    assert run.error_m < 0.1
    monkeypatch.setattr(tag_study, 'run_world', lambda _, seed: run._replace(world=seed))
    command = ['benchmark', 'tags', '--worlds', '1', '--misread', '0.05', '--surveyed', '2']
    assert main([*command, '--output', str(tmp_path)]) == 0
    table = capsys.readouterr().out.splitlines()
    assert table[-2].startswith('| 1 | 4 |')
    assert f'| {run.closures} | {run.tag_closures} | 0 | 1 of 1 | 0 |' in table[-1]
    content = json.loads((tmp_path / 'tags.json').read_text())
    assert (content['misread'], content['runs'][0]['false_joins']) == (0.05, 0)
