"""Render the image of a simulated camera: one pass gives colour and depth."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import SimulationError
from explore_slam.simulation.rendered.model import FLOOR, HIDDEN, Z_FAR, Z_NEAR, RenderedWorld
from explore_slam.simulation.rendered.mujoco_import import mujoco, rendering_error

VIEW = 12.0  # m; tiles farther away are not drawn: beyond 3.5 m depth is invalid


class Renderer:
    """Off-screen OpenGL context for one model; use it from one thread only."""

    def __init__(self, world: RenderedWorld) -> None:
        """Create the OpenGL context; raises SimulationError where OpenGL is unavailable."""
        self._model = model = world.model
        self._world = world
        self.width = int(model.vis.global_.offwidth)
        self.height = int(model.vis.global_.offheight)
        self._context: Any = None
        self._gl: Any = None
        try:
            self._gl = mujoco.GLContext(self.width, self.height)
            self._gl.make_current()
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
        except (ImportError, RuntimeError, AttributeError, OSError, mujoco.FatalError) as error:
            self.close()
            raise rendering_error(error) from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._scene = mujoco.MjvScene(model, maxgeom=64 + 16 * int(model.nbody))
        for name in ('SHADOW', 'REFLECTION', 'SKYBOX', 'HAZE', 'FOG'):
            self._scene.flags[getattr(mujoco.mjtRndFlag, f'mjRND_{name}')] = 0
        self._options = mujoco.MjvOption()
        self._options.geomgroup[FLOOR], self._options.geomgroup[HIDDEN] = 1, 0
        self._camera = mujoco.MjvCamera()
        self._viewport = mujoco.MjrRect(0, 0, self.width, self.height)

    def render(self, data: Any, camera: int) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Return colour (H, W, 3) and depth along the optical axis (H, W) m of a camera.

        Row 0 is the bottom row, as in OpenGL.
        """
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._camera.fixedcamid = camera
        x, y, _ = data.cam_xpos[camera]
        self._world.show_near(float(x), float(y), VIEW)
        return self._draw(data)

    def _draw(self, data: Any) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        if self._gl is None:
            raise SimulationError('the renderer is closed: no image can be rendered')
        self._gl.make_current()
        category = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self._model, data, self._options, None, self._camera, category, self._scene
        )
        mujoco.mjr_render(self._viewport, self._scene, self._context)
        color = np.empty((self.height, self.width, 3), np.uint8)
        depth = np.empty((self.height, self.width), np.float32)
        mujoco.mjr_readPixels(color, depth, self._viewport, self._context)
        near, far = np.float32(Z_NEAR), np.float32(Z_FAR)
        return color, near * far / (near + depth * (far - near))

    def close(self) -> None:
        """Free the OpenGL context; further calls have no effect."""
        if self._context is not None:
            self._context.free()
        if self._gl is not None:
            self._gl.free()
        self._context = self._gl = None
