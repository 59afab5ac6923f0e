"""The one place that imports MuJoCo: off-screen EGL is chosen before, its absence is explained."""

import os
import sys
from typing import Any

from explore_slam.errors import SimulationError

GL_PACKAGES = 'libegl1 libgl1 libgles2'

if sys.platform.startswith('linux'):
    os.environ.setdefault('MUJOCO_GL', 'egl')


def rendering_error(error: BaseException) -> SimulationError:
    """Return the error to raise where OpenGL cannot be used."""
    return SimulationError(
        f'the camera images cannot be rendered: {" ".join(str(error).split())}; MuJoCo needs '
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
