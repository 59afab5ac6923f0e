"""The import rules of the package, read off the syntax tree of every module: no exemptions."""

import importlib.util
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
_SPEC = importlib.util.spec_from_file_location(
    'import_graph', REPOSITORY / 'tools' / 'import_graph.py'
)
import_graph = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(import_graph)

ROS = {
    'rclpy', 'action_msgs', 'builtin_interfaces', 'diagnostic_msgs', 'geometry_msgs',
    'lifecycle_msgs', 'map_msgs', 'nav2_msgs', 'nav_msgs', 'rcl_interfaces', 'rosgraph_msgs',
    'sensor_msgs', 'std_msgs', 'std_srvs', 'tf2_msgs', 'visualization_msgs',
    'ament_index_python', 'launch', 'launch_ros',
}  # fmt: skip
# third-party packages and the members of layers that may import them
HOMES = {
    **{name: {'nodes', 'live'} for name in ROS},
    'cv2': {'vision', 'mapping'},  # images of cameras and of map files
    'mujoco': {'simulation'},
    'serial': {'vehicle'},
    'freenect': {'vehicle'},
    'rosbags': {'recording'},
    'mcap': {'recording'},
    'matplotlib': {'results', 'studies'},
    'jinja2': {'results'},
    'gtsam': {'studies'},
    'skimage': {'studies'},
    'numba': {'compiled'},
    'tqdm': {'cli'},
    'joblib': {'studies'},
    'distributed': {'studies'},
}
RANK = {
    member: rank for rank, layer in enumerate(reversed(import_graph.LAYERS)) for member in layer
}
ARROWS = import_graph.graph()


def test_every_package_has_its_place_in_the_layers():
    members = {import_graph.package_of(module) for module in ARROWS} - {''}
    assert members - RANK.keys() == set()


@pytest.mark.parametrize('module', sorted(ARROWS))
def test_imports_point_down_and_third_parties_stay_at_home(module):
    here = import_graph.package_of(module)
    for target in sorted(ARROWS[module]):
        top = target.split('.')[0]
        assert here in HOMES.get(top, {here}), f'{module} imports {target}'
        there = import_graph.package_of(target) if top == 'explore_slam' else ''
        if here and there and here != there:
            assert RANK[there] <= RANK[here], f'{module} imports {target}, which lies above it'


def test_no_circle_between_packages():
    assert import_graph.circles(import_graph.between_packages(ARROWS)) == []


def test_no_circle_between_modules():
    # a package's __init__ gathers what its modules export; a module that imports its own
    # package's __init__ is part of a circle like any other
    assert import_graph.circles(ARROWS) == []


DOCUMENT = REPOSITORY / 'doc' / 'architecture.md'


def test_the_diagram_in_the_document_is_that_of_the_code():
    text = DOCUMENT.read_text(encoding='utf-8')
    assert import_graph.with_diagram(text) == text, (
        'run: python tools/import_graph.py --write doc/architecture.md'
    )


def test_the_document_describes_every_package():
    text = DOCUMENT.read_text(encoding='utf-8')
    described = set(re.findall(r'^\| `(\w+)` \|', text, re.MULTILINE))
    present = {import_graph.package_of(module) for module in ARROWS} - {''}
    assert present - described == set(), 'describe it in the table of doc/architecture.md'
    assert described - RANK.keys() == set()


def test_the_document_describes_every_subpackage_and_no_other():
    text = DOCUMENT.read_text(encoding='utf-8')
    described = set(re.findall(r'^\| `(\w+/\w+)` \|', text, re.MULTILINE))
    root = import_graph.PACKAGE
    present = {path.parent.relative_to(root).as_posix() for path in root.glob('*/*/__init__.py')}
    assert described == present, 'correct the table of subpackages in doc/architecture.md'


def test_paths_named_in_the_document_exist():
    text = DOCUMENT.read_text(encoding='utf-8')
    for name in re.findall(r'`((?:\w+/)+(?:\w+\.(?:py|md))?)`', text):
        inside, beside = import_graph.PACKAGE / name, REPOSITORY / name
        assert inside.exists() or beside.exists(), name


def test_one_version_number():
    from importlib.metadata import version

    manifest = ElementTree.parse(REPOSITORY / 'package.xml').getroot()
    assert manifest.findtext('version') == version('explore_slam')
