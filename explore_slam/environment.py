"""Variables of the user's shell that a self-contained run does not use.

A shell may be set up for another ROS, another Python or another installation of packages. `make`
and the demo use what is in their virtual environment and talk on this machine alone; what they
clear and set is named here, once. Nodes on a robot keep the variables of ROS of their shell.
"""

import contextlib
import ctypes
import logging
import os
import sys
import sysconfig
import tempfile
from collections.abc import Mapping, MutableMapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from explore_slam.errors import MachineError

logger = logging.getLogger(__name__)

# The Makefile reads both tables, too: one quoted name in a line.
# Where Python, pip and the linker look for packages and libraries.
SEARCH_PATHS = (
    'PYTHONHOME',
    'PYTHONPATH',
    'PYTHONSTARTUP',
    'PYTHONUSERBASE',
    'PYTHONPLATLIBDIR',
    'PYTHONSAFEPATH',
    'VIRTUAL_ENV',
    'PIP_TARGET',
    'PIP_PREFIX',
    'PIP_ROOT',
    'PIP_CONSTRAINT',
    'PIP_REQUIREMENT',
    'PIP_DRY_RUN',
    'PIP_NO_DEPS',
    'PIP_PYTHON',
    'LD_LIBRARY_PATH',
    'LD_PRELOAD',
    'AMENT_PREFIX_PATH',
    'COLCON_PREFIX_PATH',
    'CMAKE_PREFIX_PATH',
    '_ROS_WHEELS_BOOTSTRAP_COMPLETE',
)
# How nodes find and hear each other, and what draws.
MIDDLEWARE = (
    'RMW_IMPLEMENTATION',
    'RMW_FASTRTPS_USE_QOS_FROM_XML',
    'RMW_FASTRTPS_PUBLICATION_MODE',
    'RCL_LOGGING_IMPLEMENTATION',
    'ROS_DISCOVERY_SERVER',
    'ROS_SUPER_CLIENT',
    'ROS_AUTOMATIC_DISCOVERY_RANGE',
    'ROS_STATIC_PEERS',
    'ROS_LOCALHOST_ONLY',
    'ROS_SECURITY_ENABLE',
    'ROS_SECURITY_STRATEGY',
    'ROS_SECURITY_KEYSTORE',
    'ROS_SECURITY_ENCLAVE_OVERRIDE',
    'ROS_DISABLE_LOANED_MESSAGES',
    'ROS_LOG_DIR',
    'ROS_HOME',
    'FASTRTPS_DEFAULT_PROFILES_FILE',
    'FASTDDS_DEFAULT_PROFILES_FILE',
    'FASTDDS_BUILTIN_TRANSPORTS',
    'FASTDDS_ENVIRONMENT_FILE',
    'SKIP_DEFAULT_XML',
    'CYCLONEDDS_URI',
    'PYOPENGL_PLATFORM',
    'MPLBACKEND',
)
MIDDLEWARE_USED = 'rmw_fastrtps_cpp'  # of the wheels, and the default of a ROS installation
_RENAMED = 9  # major version of rclpy since which Fast DDS 3 is used
HIGHEST_DOMAIN = 232  # the ports of higher ones would lie above 65535
_SET_APART = ('ROS_LOG_DIR', 'ROS_HOME', 'MPLBACKEND')  # not by `one_machine` alone
_DRAWING = ('egl', 'osmesa')  # how MuJoCo draws without a window
_ISOLATED = '_EXPLORE_SLAM_ISOLATED'  # set in a process that was started again
_MMAP_THRESHOLD = -3  # M_MMAP_THRESHOLD of malloc.h
_PACKAGE = Path(__file__).resolve().parent


def domain_of(environment: Mapping[str, str]) -> int | None:
    """Return the domain that ROS_DOMAIN_ID names; None without one, or for an unusable one."""
    text = environment.get('ROS_DOMAIN_ID', '').strip()
    return int(text) if text.isascii() and text.isdigit() and int(text) <= HIGHEST_DOMAIN else None


def profile_variable() -> str:
    """Return the variable that names the settings of Fast DDS.

    It was renamed with Kilted (rclpy 9), which warns where the old name is set, whatever the new
    one; Jazzy does not know the new one.
    """
    for name in ('rclpy', 'ros-rclpy'):  # of ROS itself, of the wheels
        with contextlib.suppress(PackageNotFoundError):
            if int(version(name).partition('.')[0]) >= _RENAMED:
                return 'FASTDDS_DEFAULT_PROFILES_FILE'
            break
    return 'FASTRTPS_DEFAULT_PROFILES_FILE'


def one_machine(
    given: Mapping[str, str], profile: Path, log_folder: Path | None = None
) -> dict[str, str]:
    """Return the environment of nodes that communicate on this machine only.

    profile: settings of Fast DDS.
    log_folder: of ROS; by default the usual one if it can be written.
    A usable ROS_DOMAIN_ID is kept; otherwise the process id determines one, so that two demos do
    not mix. What of the given environment is not used is logged in one line.
    """
    domain = domain_of(given)
    unused_names = [name for name in MIDDLEWARE if name not in _SET_APART]
    used = {
        **{name: value for name, value in given.items() if name not in unused_names},
        'ROS_DOMAIN_ID': str(1 + os.getpid() % 100 if domain is None else domain),
        'RMW_IMPLEMENTATION': MIDDLEWARE_USED,
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        profile_variable(): str(profile),
    }
    if given.get('MUJOCO_GL') not in _DRAWING:
        used['MUJOCO_GL'] = _DRAWING[0]
    folder = log_folder or ros_log_folder(given)
    if folder is not None:
        used['ROS_LOG_DIR'] = str(folder)
    names = (*unused_names, 'ROS_DOMAIN_ID', 'MUJOCO_GL')
    unused = [name for name in names if given.get(name) and used.get(name) != given[name]]
    if unused:
        logger.warning(
            'not used, as all nodes run on this machine: %s',
            ', '.join(f'{name}={given[name]}' for name in unused),
        )
    return used


def prepare_ros(environment: MutableMapping[str, str]) -> None:
    """Make ready for ROS, with the variables of this shell, before it is imported.

    MachineError for a middleware that is not installed: ROS would end the process.
    """
    name = environment.get('RMW_IMPLEMENTATION')
    if name:
        try:
            ctypes.CDLL(f'lib{name}.so')
        except OSError as error:
            raise MachineError(
                f'RMW_IMPLEMENTATION is {name!r}, which is not installed here ({error}): '
                f'unset it, or set it to {MIDDLEWARE_USED}'
            ) from error
    if environment.get('ROS_DOMAIN_ID', '').strip() and domain_of(environment) is None:
        raise MachineError(
            f'ROS_DOMAIN_ID is {environment["ROS_DOMAIN_ID"]!r}, expected a whole number from 0 '
            f'to {HIGHEST_DOMAIN}'
        )
    folder = ros_log_folder(environment)
    if folder is not None:
        environment['ROS_LOG_DIR'] = str(folder)


def ros_log_folder(given: Mapping[str, str]) -> Path | None:
    """Return a folder for the logs of ROS if the usual one cannot be written, else None."""
    home = Path(given.get('ROS_HOME') or Path(given.get('HOME') or '/nonexistent') / '.ros')
    usual = Path(given.get('ROS_LOG_DIR') or home / 'log')
    if is_writable(usual):
        return None
    folder = scratch_folder() / 'ros_log'
    logger.warning('%s cannot be written: the logs of ROS are in %s', usual, folder)
    return folder


def prepare_libraries(environment: MutableMapping[str, str]) -> None:
    """Let reports be drawn off screen, also where the home, with its settings, is not writable."""
    environment['MPLBACKEND'] = 'agg'
    home = environment.get('XDG_CONFIG_HOME') or environment.get('HOME') or '/nonexistent'
    if 'MPLCONFIGDIR' not in environment and not os.access(home, os.W_OK):
        environment['MPLCONFIGDIR'] = str(scratch_folder() / 'matplotlib')


def return_large_arrays() -> None:
    """Let the C library return arrays of 1 MiB and more to the system as soon as they are freed.

    By default glibc raises that size to the largest that was freed, up to 32 MiB, and what is
    smaller stays with the process: 100 MiB of an agent after five minutes, and more with time.
    Other C libraries have no such setting.
    """
    mallopt = getattr(ctypes.CDLL(None), 'mallopt', None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, 2**20)


def is_writable(folder: Path) -> bool:
    """Return whether files can be made in a folder, which is made if it does not exist."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except (OSError, RuntimeError, ValueError):
        return False


def scratch_folder() -> Path:
    """Return a folder for temporary files of this user, the same in every run if possible.

    Another user's folder of the same name is never used: what lies in it may be executed.
    """
    folder = Path(tempfile.gettempdir()) / f'explore_slam_{os.getuid()}'
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
        if status.st_uid == os.getuid() and not status.st_mode & 0o022 and not folder.is_symlink():
            return folder
    except OSError:
        pass
    return Path(tempfile.mkdtemp(prefix='explore_slam_'))


def start_isolated() -> None:
    """Start this process again if it would load packages or libraries of another installation.

    That is so in a virtual environment that holds ROS itself, in a shell that has another one's
    folders in PYTHONPATH or LD_LIBRARY_PATH. Returns if nothing is to be changed.
    """
    if sys.prefix == sys.base_prefix or _ISOLATED in os.environ:
        return
    if not (Path(sysconfig.get_path('purelib')) / 'ros_wheels_bootstrapper').is_dir():
        return  # ROS comes from elsewhere, by these very variables
    found = isolated(os.environ, Path(sys.prefix))
    if found != dict(os.environ):
        unused = [
            f'{name}={os.environ[name]}'
            for name in ('PYTHONPATH', 'LD_LIBRARY_PATH', 'AMENT_PREFIX_PATH')
            if os.environ.get(name) != found.get(name)
        ]
        sys.stderr.write(f'not used, ROS is in {sys.prefix}: {", ".join(unused)}\n')
        sys.stderr.flush()
        os.execve(sys.executable, sys.orig_argv, {**found, _ISOLATED: '1'})


def isolated(given: Mapping[str, str], prefix: Path) -> dict[str, str]:
    """Return an environment without search paths of another ROS than that of a prefix.

    PYTHONPATH keeps the folder of this package; the linker keeps what holds no ROS.
    """
    found = dict(given)
    _keep(
        found, 'PYTHONPATH', [entry for entry in _entries(given, 'PYTHONPATH') if _is_own(entry)]
    )
    for name in ('LD_LIBRARY_PATH', 'AMENT_PREFIX_PATH'):
        entries = _entries(given, name)
        _keep(found, name, [entry for entry in entries if not _is_foreign_ros(entry, prefix)])
    if found != dict(given):
        found.pop('_ROS_WHEELS_BOOTSTRAP_COMPLETE', None)
    return found


def _entries(environment: Mapping[str, str], name: str) -> list[str]:
    return [entry for entry in environment.get(name, '').split(os.pathsep) if entry]


def _keep(environment: dict[str, str], name: str, entries: list[str]) -> None:
    """Set a search path, if that drops any of its entries."""
    if entries != _entries(environment, name):
        environment[name] = os.pathsep.join(entries)
        if not entries:
            del environment[name]


def _is_own(entry: str) -> bool:
    return (Path(entry).resolve() / _PACKAGE.name) == _PACKAGE


def _is_foreign_ros(entry: str, prefix: Path) -> bool:
    folder = Path(entry)
    if folder.is_relative_to(prefix):
        return False
    return (folder / 'librcl.so').exists() or (folder / 'share' / 'ament_index').exists()
