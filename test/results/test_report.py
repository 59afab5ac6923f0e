"""The report: a self-contained page with the data of the run."""

import dataclasses
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from explore_slam.geometry import Pose2
from explore_slam.results import RunData, RunRecorder, Series, VehicleRun
from explore_slam.results.plots import (
    coverage_figure,
    error_figure,
    figures,
    map_figure,
    particles_figure,
)
from explore_slam.results.report import render_report
from explore_slam.results.trajectory import Trajectory
from explore_slam.slam import OdometryCalibration


class Page(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.ids: list[str] = []
        self.texts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        for name, value in attrs:
            if name in ('src', 'href', 'xlink:href'):
                self.links.append(value)
            elif name == 'id':
                self.ids.append(value)

    def handle_data(self, data):
        self.texts.append(data)


def test_the_page_is_complete_and_needs_no_other_file(some_run):
    page = Page(render_report(some_run()))
    assert page.tags.count('svg') == 5
    assert 'script' not in page.tags
    assert all(link.startswith(('#', 'data:')) for link in page.links)
    assert len(page.ids) == len(set(page.ids))
    text = ' '.join(page.texts)
    for expected in (
        'a run',
        'Map and trajectories',
        '0.050',
        '98.0 %',
        'Consistency',
        'a <warning>',
        'robot2',
    ):
        assert expected in text


def test_every_id_that_a_figure_refers_to_exists(some_run):
    text = render_report(some_run())
    page = Page(text)
    used = set(re.findall(r'url\(#([^)]+)\)', text)) | {
        link[1:] for link in page.links if link.startswith('#')
    }
    assert used <= set(page.ids)


def test_the_page_is_the_same_every_time(some_run):
    assert render_report(some_run()) == render_report(some_run())


def test_a_run_without_truth_grid_and_coverage_still_has_a_page():
    recorder = RunRecorder('bare', {'robot1': Pose2(0, 0, 0)})
    recorder.add_pose('robot1', 1.0, Pose2(0, 0, 0))
    recorder.add_pose('robot1', 2.0, Pose2(1, 0, 0))
    data = recorder.finish({})
    assert error_figure(data) is None
    assert coverage_figure(data) is None
    assert particles_figure(data) is None
    assert [title for title, _, _ in figures(data)] == ['Map and trajectories']
    assert 'Errors' not in render_report(data)


def test_the_page_says_what_was_left_out_of_reach():
    left = RunData('office', (), {'unreached_frontiers': 3, 'unreached_m2': 81.3})
    assert '3 frontiers (81 m²)' in render_report(left)
    assert 'out of reach' in render_report(left)
    nothing = RunData('office', (), {'unreached_frontiers': 0, 'unreached_m2': 0.0})
    assert 'out of reach' not in render_report(nothing)


def test_an_empty_run_has_a_page():
    data = RunData('empty', (), {})
    assert map_figure(data) is None
    assert '<h1>empty</h1>' in render_report(data)


def test_names_are_escaped():
    run = VehicleRun('<b>', online=Trajectory.of([1.0, 2.0], [[0, 0, 0], [1, 0, 0]]))
    page = render_report(RunData('<i>title', (run,), {'vehicles': {'<b>': {'online': None}}}))
    assert '<i>title' not in page
    assert '<b>&lt;b&gt;' not in page
    assert '&lt;b&gt;' in page


@pytest.mark.parametrize('count', [2, 500, 5000])
def test_long_runs_stay_small_and_keep_their_peaks(count):
    stamps = np.arange(float(count))
    values = np.full(count, 300.0)
    values[count // 3] = 1.0
    data = RunData('long', (), {}, effective_particles=Series(stamps, values), particles=500)
    svg = particles_figure(data)
    assert len(svg) < 200_000
    run = VehicleRun('a', online=Trajectory.of(stamps, np.column_stack([stamps] * 3) * 1e-3))
    assert len(map_figure(RunData('long', (run,), {}))) < 200_000


def test_the_calibration_of_the_wheels_has_a_table(some_run):
    data = some_run()
    assert 'Wheel odometry' not in render_report(data)
    found = OdometryCalibration.of(np.array([-0.2, 0.05, 0.1]), np.diag([0.01, 0.02, 0.03]) ** 2)
    metrics = {**data.metrics, 'odometry_calibration': {'robot1': found._asdict(), 'robot2': {}}}
    page = Page(render_report(dataclasses.replace(data, metrics=metrics)))
    text = ' '.join(page.texts)
    for expected in ('Wheel odometry', '0.800 ± 0.010', '1.050 ± 0.020', '5.73 ± 1.72'):
        assert expected in text
    assert 'odometry_calibration.robot1' not in text
