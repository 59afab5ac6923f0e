"""The import rules of the house, read off the syntax tree of every module."""

import ast
from pathlib import Path
from xml.etree import ElementTree

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / 'explore_slam'
ROOMS = {
    'agent', 'cli', 'evaluation', 'exploration', 'mapping', 'nodes', 'recording', 'simulation',
    'slam', 'vehicle', 'vision',
}  # fmt: skip
ROS = {
    'rclpy', 'builtin_interfaces', 'diagnostic_msgs', 'geometry_msgs', 'nav_msgs',
    'rcl_interfaces', 'rosgraph_msgs', 'sensor_msgs', 'std_msgs', 'std_srvs', 'tf2_msgs',
    'visualization_msgs',
    'ament_index_python', 'launch', 'launch_ros',
}  # fmt: skip
ONLY_IN = {
    **{name: {'nodes'} for name in ROS},
    'cv2': {'vision'},
    'mujoco': {'simulation'},
    'serial': {'vehicle'},
    'freenect': {'vehicle'},
    'matplotlib': {'evaluation'},
    'rosbags': {'recording'},
}
# what a room must not know of the others
FORBIDDEN = {
    'vision': {'slam', 'mapping', 'exploration', 'agent'},
    'slam': {'mapping', 'exploration', 'agent', 'vision'},
    'mapping': {'slam', 'exploration', 'agent', 'vision'},
    'exploration': {'slam', 'agent', 'vision'},
    'agent': set(),
    'vehicle': {'slam', 'mapping', 'exploration', 'agent', 'vision'},
    'simulation': {'slam', 'agent', 'vision'},
}
OUTER = {'nodes', 'cli', 'recording', 'evaluation', 'simulation'}


def modules():
    return sorted(PACKAGE.rglob('*.py'))


def imports_of(path):
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{path}: relative import'
            yield node.module
            yield from (f'{node.module}.{name.name}' for name in node.names)


@pytest.mark.parametrize('path', modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_keep_to_the_house_plan(path):
    parts = path.relative_to(PACKAGE).parts
    room = parts[0] if len(parts) > 1 else ''
    for name in imports_of(path):
        top, *rest = name.split('.')
        assert room in ONLY_IN.get(top, {room}), f'{path} imports {name}'
        if top != 'explore_slam' or not rest or rest[0] not in ROOMS or rest[0] == room:
            continue
        assert room, f'{path}: the foundation imports a room ({name})'
        if name.startswith('explore_slam.nodes.conversions'):
            continue  # free of ROS on purpose, so that bags go through the same code
        assert rest[0] not in FORBIDDEN.get(room, set()), f'{path} imports {name}'
        assert not (room in FORBIDDEN and rest[0] in OUTER - {room}), f'{path} imports {name}'


def test_conversions_import_no_ros():
    for path in (PACKAGE / 'nodes' / 'conversions').glob('*.py'):
        assert not {name.split('.')[0] for name in imports_of(path)} & ROS, path


def test_one_version_number():
    from importlib.metadata import version

    manifest = ElementTree.parse(PACKAGE.parent / 'package.xml').getroot()
    assert manifest.findtext('version') == version('explore_slam')
