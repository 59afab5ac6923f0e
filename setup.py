"""ament_python package; name and version are defined only in package.xml."""

from glob import glob
from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup
from setuptools.command.develop import develop

# `colcon build --symlink-install` runs a link to this file, in a folder with links to some others
SOURCE = Path(__file__).resolve().parent
manifest = ElementTree.parse(SOURCE / 'package.xml').getroot()
name = manifest.findtext('name')


def files(pattern):
    """Files only: a pattern must not pick up __pycache__ or folders."""
    return sorted(path for path in glob(pattern) if Path(path).is_file())


def requirements(path):
    lines = (SOURCE / path).read_text().splitlines()
    return [line for line in lines if line and not line.startswith(('#', '-'))]


class Develop(develop):
    """Honour [build_scripts] in `colcon build --symlink-install`, too."""

    def write_script(self, script_name, contents, mode='t', blockers=()):
        interpreter, end, rest = contents.partition('\n')
        if interpreter.startswith('#!'):
            interpreter = f'#!{self.get_finalized_command("build_scripts").executable}'
        super().write_script(script_name, f'{interpreter}{end}{rest}', mode, blockers)


setup(
    name=name,
    version=manifest.findtext('version'),
    description=manifest.findtext('description'),
    maintainer=manifest.findtext('maintainer'),
    maintainer_email=manifest.find('maintainer').get('email'),
    license=manifest.findtext('license'),
    packages=find_packages(include=[name, f'{name}.*']),
    package_data={name: ['py.typed', 'results/templates/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{name}']),
        (f'share/{name}', ['package.xml']),
        (f'share/{name}/config', files('config/*.*')),
        (f'share/{name}/config/worlds', files('config/worlds/*.*')),
        (f'share/{name}/launch', files('launch/*.launch.*')),
    ],
    python_requires='>=3.12',
    install_requires=['setuptools', *requirements('requirements.txt')],
    extras_require={
        'kinect': ['freenect'],  # compiles against libfreenect-dev
        'cluster': ['dask', 'distributed', 'joblib>=1.4'],  # runs of studies on a Dask cluster
    },
    zip_safe=True,
    cmdclass={'develop': Develop},
    tests_require=['pytest'],
    entry_points={
        'console_scripts': [
            'explore_slam = explore_slam.cli.main:main',
            'agent = explore_slam.nodes.executables:agent',
            'pioneer_driver = explore_slam.nodes.executables:pioneer_driver',
            'path_follower = explore_slam.nodes.executables:path_follower',
            'feature_extractor = explore_slam.nodes.executables:feature_extractor',
            'simulator = explore_slam.nodes.executables:simulator',
            'recorder = explore_slam.nodes.executables:recorder',
            'player = explore_slam.nodes.executables:player',
        ],
    },
)
