"""Compile message packages that PyPI does not have into this virtual environment.

    python tools/build_messages.py tf2_msgs map_msgs

The wheels of ROS hold common_interfaces alone; /tf needs tf2_msgs. The definitions in interfaces/
have the names, fields and types of the packages that a ROS installation has, so that its nodes
understand them. A package that is installed already is left alone, unless it lacks one of them.
Without a C++ compiler or CMake nothing is compiled: one line says what will be missing, and the
exit code is 0.
"""

import importlib.metadata
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import numpy

REPOSITORY = Path(__file__).resolve().parents[1]
DEFINITIONS = REPOSITORY / 'interfaces'
PREFIX = Path(sys.prefix)
# folders of the machine that built the wheels, which their CMake files name
FOREIGN_INCLUDE = '/opt/python/cp312-cp312/include/python3.12'
FOREIGN_NUMPY = '/opt/python/cp312-cp312/lib/python3.12/site-packages/numpy/_core/include'
LOST = {
    'tf2_msgs': 'no transforms on /tf and /tf_static; sensor mounts come from parameters',
    'map_msgs': 'no map_updates, the whole map is published instead',
    'nav2_msgs': 'no navigator nav2; its tests are skipped',
}

CMAKE = """cmake_minimum_required(VERSION 3.8)
project({name})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{find}
rosidl_generate_interfaces({name} {files} DEPENDENCIES {dependencies})
ament_package()
"""
MANIFEST = """<package format="3">
  <name>{name}</name>
  <version>0.0.0</version>
  <description>Messages of {name} that explore_slam uses</description>
  <maintainer email="maintainers@explore-slam.example.org">explore_slam developers</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  {depend}
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export><build_type>ament_cmake</build_type></export>
</package>
"""


def main(names: list[str]) -> int:
    """Build the packages that are missing."""
    missing = [name for name in names if not _is_complete(name)]
    if not missing:
        return 0
    tools = {'C++ compiler': ('c++', 'g++', 'clang++'), 'CMake': ('cmake',)}
    absent = [what for what, commands in tools.items() if not any(map(shutil.which, commands))]
    if absent:
        for name in missing:
            print(f'{name} is not built ({" and ".join(absent)} missing): {LOST[name]}')
        return 0
    print(f'Compiling {", ".join(missing)} (once) ...', flush=True)
    pip = [sys.executable, '-m', 'pip', '--disable-pip-version-check', 'install', '-q', '-r']
    if not _run([*pip, str(REPOSITORY / f'requirements-messages-{_distribution()}.txt')]):
        return 1
    _correct_include_folders()
    with tempfile.TemporaryDirectory() as folder:
        return 0 if all(_build(name, Path(folder) / name) for name in missing) else 1


def _distribution() -> str:
    """Return the distribution of ROS that is installed from PyPI."""
    installed = (item.metadata['Name'] for item in importlib.metadata.distributions())
    found = (re.fullmatch(r'ros[-_]([a-z]+)[-_]rclpy', name or '') for name in installed)
    return next((match[1] for match in found if match), 'jazzy')


def _is_complete(name: str) -> bool:
    """Return whether a package is installed with all the types of its definitions."""
    found = importlib.util.find_spec(name)
    if found is None or not found.submodule_search_locations:
        return False
    folder = Path(next(iter(found.submodule_search_locations)))
    return all(
        (folder / path.parent.name / f'_{_module_name(path.stem)}.py').exists()
        for path in (DEFINITIONS / name).glob('*/*')
    )


def _module_name(type_name: str) -> str:
    """Return the name of the module of a type: FollowPath -> follow_path."""
    spaced = re.sub(r'(.)([A-Z][a-z]+)', r'\1_\2', type_name)
    return re.sub(r'([a-z0-9])([A-Z])', r'\1_\2', spaced).lower()


def _correct_include_folders() -> None:
    """Replace folders of the wheels' build machine by those of this Python and of its NumPy."""
    python = sysconfig.get_paths()['include']
    for file in (PREFIX / 'share').glob('*/cmake/*.cmake'):
        text = file.read_text(encoding='utf-8')
        own = text.replace(FOREIGN_INCLUDE, python)
        own = own.replace(FOREIGN_NUMPY, numpy.get_include())
        if own != text:
            file.write_text(own, encoding='utf-8')


def _build(name: str, folder: Path) -> bool:
    source = folder / 'source'
    shutil.copytree(DEFINITIONS / name, source)
    files = sorted(
        path for path in source.rglob('*') if path.suffix in ('.msg', '.srv', '.action')
    )
    found = (re.findall(r'^(\w+)/\w+', path.read_text(), re.MULTILINE) for path in files)
    needed = sorted({package for packages in found for package in packages} - {name})
    if any(path.suffix == '.action' for path in files):
        needed.append('action_msgs')
    relative = ' '.join(f'"{path.relative_to(source)}"' for path in files)
    find = '\n'.join(f'find_package({package} REQUIRED)' for package in needed)
    depend = '\n  '.join(f'<depend>{package}</depend>' for package in needed)
    (source / 'CMakeLists.txt').write_text(
        CMAKE.format(name=name, find=find, files=relative, dependencies=' '.join(needed))
    )
    (source / 'package.xml').write_text(MANIFEST.format(name=name, depend=depend))
    build = str(folder / 'build')
    configure = [
        'cmake', '-S', str(source), '-B', build, '-DCMAKE_BUILD_TYPE=Release',
        f'-DCMAKE_PREFIX_PATH={PREFIX}', f'-DCMAKE_INSTALL_PREFIX={PREFIX}',
        f'-DPython3_EXECUTABLE={sys.executable}', '-DBUILD_TESTING=OFF',
    ]  # fmt: skip
    jobs = str(os.cpu_count() or 1)
    return _run(configure) and _run(['cmake', '--build', build, '-j', jobs, '--target', 'install'])


def _run(command: list[str]) -> bool:
    """Run a command; print its output and return False if it fails."""
    environment = {**os.environ, 'AMENT_PREFIX_PATH': str(PREFIX)}
    path = os.pathsep.join((str(PREFIX / 'bin'), os.environ.get('PATH', '')))
    done = subprocess.run(
        command,
        env={**environment, 'PATH': path},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if done.returncode:
        print(f'{" ".join(command)} failed with exit code {done.returncode}:')
        print('\n'.join(done.stdout.splitlines()[-30:]))
    return done.returncode == 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
