"""Import MuJoCo with off-screen rendering through EGL; explain what is missing where it fails."""

import os
import sys
from typing import Any

from explore_slam.errors import SimulationError

GL_PACKAGES = 'libegl1 libgl1 libgles2'

if sys.platform.startswith('linux'):
    os.environ.setdefault('MUJOCO_GL', 'egl')


def rendering_error(error: BaseException) -> SimulationError:
    """Return the SimulationError for an OpenGL failure, with the command that fixes it."""
    return SimulationError(
        f'cannot render camera images: {" ".join(str(error).split())}; MuJoCo needs '
        f'OpenGL through EGL (MUJOCO_GL={os.environ.get("MUJOCO_GL")}): on Debian and Ubuntu '
        f'run "sudo apt-get install {GL_PACKAGES}"'
    )


def _import() -> Any:
    try:
        import mujoco
    except ModuleNotFoundError as error:
        if error.name != 'mujoco':
            raise rendering_error(error) from error
        raise SimulationError(
            'the simulator needs the Python package mujoco: run "pip install mujoco"'
        ) from error
    except (ImportError, AttributeError, OSError, RuntimeError) as error:
        raise rendering_error(error) from error
    return mujoco


mujoco: Any = _import()
