"""Build the MuJoCo model of a world and its vehicles: painted meshes for camera and laser.

A world is divided into square tiles with one mesh per tile and texture, so that distant tiles can
be hidden. MuJoCo keeps a bounding volume hierarchy per mesh, which makes ray casting cheap.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import SimulationError
from explore_slam.geometry import Array, rotation_matrix
from explore_slam.mounts import CameraMountConfig
from explore_slam.simulation.config import SimulationConfig
from explore_slam.simulation.rendered.mujoco_import import mujoco
from explore_slam.simulation.worlds.atlas import PAGE_SIZE, Atlas, Patch, Surface, build_atlas
from explore_slam.simulation.worlds.paint import paint_floor
from explore_slam.simulation.worlds.posters import Image
from explore_slam.simulation.worlds.world import Board, Face, Pit, World, block_corners

PAINTED, BODY, DECORATION, FLOOR, HIDDEN = 0, 1, 2, 3, 4  # groups of MuJoCo geoms
TILE = 8.0  # m; as wide as the range of the laser
Z_NEAR, Z_FAR = 0.1, 40.0  # m; clipping planes of the camera
FLOOR_RESOLUTION = 0.01  # m per pixel, coarser where the floor would exceed FLOOR_PIXELS per side
FLOOR_PIXELS = 4096
# of the drawn vehicle, in m
BODY_INSET = 0.02  # the body is smaller than the circle of collisions
BODY_BOTTOM = 0.04  # height of the body's lower edge
LASER_MARGIN = 0.04  # the body ends above the scan plane, so that other lasers see it
COLORS = (
    (0.75, 0.10, 0.10), (0.10, 0.25, 0.75), (0.10, 0.55, 0.15),
    (0.80, 0.60, 0.05), (0.50, 0.10, 0.60), (0.05, 0.55, 0.60),
)  # fmt: skip


class RenderedWorld(NamedTuple):
    """The MjModel, and the tiles of its walls.

    tiles: (G,) geom ids. circles: (G, 3) bounding circle of each tile: x, y, radius (m).
    """

    model: Any
    tiles: NDArray[np.intp]
    circles: Array

    def show_near(self, x: float, y: float, reach: float) -> None:
        """Hide the tiles from camera and laser that lie beyond reach (m) of a point (x, y)."""
        gaps = np.hypot(self.circles[:, 0] - x, self.circles[:, 1] - y) - self.circles[:, 2]
        self.model.geom_group[self.tiles] = np.where(gaps <= reach, PAINTED, HIDDEN)


@dataclass
class _Mesh:
    """Triangles with one texture: vertices, texture coordinates (0..1), vertex indices."""

    vertices: list[Sequence[float]]
    coordinates: list[Sequence[float]]
    triangles: list[tuple[int, int, int]]

    def add(self, corners: Sequence[Sequence[float]], uv: Sequence[Sequence[float]]) -> None:
        """Add a convex polygon with corners counterclockwise as seen from its visible side."""
        first = len(self.vertices)
        self.vertices.extend(corners)
        self.coordinates.extend(uv)
        for k in range(1, len(corners) - 1):
            self.triangles.append((first, first + k, first + k + 1))


def build_model(world: World, vehicles: Sequence[str], config: SimulationConfig) -> RenderedWorld:
    """Build the model, with one mocap body and one camera per vehicle in the order given.

    Raises SimulationError where MuJoCo rejects the model.
    """
    spec = mujoco.MjSpec()
    kinect = config.kinect
    visual = spec.visual
    visual.global_.offwidth = kinect.simulated_image_width
    visual.global_.offheight = kinect.simulated_image_height
    visual.quality.offsamples = 0
    visual.quality.shadowsize = 0
    visual.headlight.active = 0  # emissive materials instead: cheap, same from all directions
    visual.map.znear, visual.map.zfar = Z_NEAR, Z_FAR
    spec.stat.extent = 1.0
    spec.stat.center = [0.0, 0.0, 0.0]
    seen = kinect.simulated_camera_rate > 0.0
    tiles = _add_walls(spec, world, painted=seen)
    if seen:
        _add_floor(spec, world)
    for index, name in enumerate(vehicles):
        _add_vehicle(spec, name, COLORS[index % len(COLORS)], config)
    try:
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise SimulationError(
            f'world {world.name!r}: MuJoCo cannot compile it: {" ".join(str(error).split())}'
        ) from error
    geoms = [int(model.geom(name).id) for name in tiles]
    circles = np.array(list(tiles.values()), dtype=np.float64).reshape(-1, 3)
    return RenderedWorld(model, np.array(geoms, dtype=np.intp), circles)


def _material(spec: Any, name: str, image: Image) -> None:
    rows, columns = image.shape[:2]
    texture = spec.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=columns,
        height=rows,
        nchannel=3,
    )
    texture.data = np.ascontiguousarray(image).tobytes()
    material = spec.add_material(name=name, emission=1.0, specular=0.0, shininess=0.0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def _add_mesh(spec: Any, name: str, mesh: _Mesh, material: str, group: int) -> None:
    made = spec.add_mesh(name=name)
    made.uservert = np.asarray(mesh.vertices, dtype=np.float64).ravel()
    made.usertexcoord = np.asarray(mesh.coordinates, dtype=np.float64).ravel()
    made.userface = np.asarray(mesh.triangles, dtype=np.int32).ravel()
    made.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    geom = spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        contype=0,
        conaffinity=0,
        group=group,
    )
    if material:
        geom.material = material


def _pieces(face: Face, longest: float) -> list[Face]:
    """Divide a face into parts of at most this length (m)."""
    count = max(1, math.ceil(face.length / longest))
    x = np.linspace(face.x0, face.x1, count + 1).tolist()
    y = np.linspace(face.y0, face.y1, count + 1).tolist()
    return [Face(x[i], y[i], x[i + 1], y[i + 1], face.height, face.style) for i in range(count)]


def _add_walls(spec: Any, world: World, painted: bool) -> dict[str, tuple[float, float, float]]:
    """Add one geom per tile and texture page; return geom name -> bounding circle (m)."""
    longest = min(TILE, 0.5 * PAGE_SIZE * world.texture_resolution)
    faces = [piece for face in world.faces for piece in _pieces(face, longest)]
    surfaces = [Surface(face.style, face.length, face.height) for face in faces]
    surfaces += [Surface('wood', 0.5, 0.5)]  # shared by all tops, which the cameras hardly see
    nowhere = Atlas([np.zeros((1, 1, 3), np.uint8)], [Patch(0, 0, 0, 1, 1)] * len(surfaces))
    atlas = nowhere
    if painted:
        atlas = build_atlas(surfaces, world.texture_resolution, world.texture_seed)
        for page, image in enumerate(atlas.pages):
            _material(spec, f'page{page}', image)
    meshes: dict[tuple[int, int, int], _Mesh] = {}
    for face, patch in zip(faces, atlas.patches, strict=False):
        middle = (0.5 * (face.x0 + face.x1), 0.5 * (face.y0 + face.y1))
        u0, v0, u1, v1 = _texture_box(patch, atlas.pages[patch.page])
        _mesh_at(meshes, patch.page, middle).add(
            [
                (face.x0, face.y0, 0.0),
                (face.x1, face.y1, 0.0),
                (face.x1, face.y1, face.height),
                (face.x0, face.y0, face.height),
            ],
            [(u0, v1), (u1, v1), (u1, v0), (u0, v0)],
        )
    _add_tops(meshes, world, atlas)
    for board in world.boards:
        _add_board(meshes, board, atlas)
    tiles = {}
    for (page, row, column), mesh in meshes.items():
        name = f'walls_{page}_{row}_{column}'
        _add_mesh(spec, name, mesh, f'page{page}' if painted else '', PAINTED)
        corners = np.asarray(mesh.vertices)[:, :2]
        low, high = corners.min(axis=0), corners.max(axis=0)
        middle = 0.5 * (low + high)
        tiles[name] = (float(middle[0]), float(middle[1]), 0.5 * math.dist(low, high))
    return tiles


def _add_tops(meshes: dict[tuple[int, int, int], _Mesh], world: World, atlas: Atlas) -> None:
    patch = atlas.patches[-1]
    u0, v0, u1, v1 = _texture_box(patch, atlas.pages[patch.page])
    for top in world.tops:
        polygon = [(float(x), float(y), top.height) for x, y in top.corners]
        low, high = top.corners.min(axis=0), top.corners.max(axis=0)
        part = (top.corners - low) / np.maximum(high - low, 1e-9)
        uv = [(u0 + float(a) * (u1 - u0), v0 + float(b) * (v1 - v0)) for a, b in part]
        middle = 0.5 * (low + high)
        _mesh_at(meshes, patch.page, (float(middle[0]), float(middle[1]))).add(polygon, uv)


def _add_board(meshes: dict[tuple[int, int, int], _Mesh], board: Board, atlas: Atlas) -> None:
    """Add the six sides of a board, all of one texture."""
    patch = atlas.patches[-1]
    u0, v0, u1, v1 = _texture_box(patch, atlas.pages[patch.page])
    uv = [(u0, v1), (u1, v1), (u1, v0), (u0, v0)]
    mesh = _mesh_at(meshes, patch.page, (board.x, board.y))
    corners = [(float(x), float(y)) for x, y in block_corners(board)]
    low, high = board.bottom, board.top
    mesh.add([(x, y, high) for x, y in corners], uv)
    mesh.add([(x, y, low) for x, y in reversed(corners)], uv)
    for (ax, ay), (bx, by) in zip(corners, [*corners[1:], corners[0]], strict=True):
        mesh.add([(ax, ay, low), (bx, by, low), (bx, by, high), (ax, ay, high)], uv)


def _mesh_at(
    meshes: dict[tuple[int, int, int], _Mesh], page: int, point: tuple[float, float]
) -> _Mesh:
    """Return the mesh for a page and the tile that contains a point."""
    key = (page, math.floor(point[1] / TILE), math.floor(point[0] / TILE))
    return meshes.setdefault(key, _Mesh([], [], []))


def _texture_box(patch: Patch, page: Image) -> tuple[float, float, float, float]:
    """Return u or v of left, top, right, bottom, half a pixel inside; v grows downwards."""
    rows, columns = page.shape[:2]
    return (
        (patch.left + 0.5) / columns,
        (patch.top + 0.5) / rows,
        (patch.right - 0.5) / columns,
        (patch.bottom - 0.5) / rows,
    )


def _add_floor(spec: Any, world: World) -> None:
    x0, y0, x1, y1 = world.bounds
    resolution = max(FLOOR_RESOLUTION, (x1 - x0) / FLOOR_PIXELS, (y1 - y0) / FLOOR_PIXELS)
    shape = (math.ceil((y1 - y0) / resolution), math.ceil((x1 - x0) / resolution))
    rng = np.random.default_rng((world.texture_seed, 2**31))
    _material(spec, 'floor', paint_floor(shape, resolution, rng))
    mesh = _Mesh([], [], [])

    def add(corners: list[tuple[float, float, float]]) -> None:
        uv = [((x - x0) / (x1 - x0), (y1 - y) / (y1 - y0)) for x, y, _ in corners]
        mesh.add(corners, uv)

    for left, below, right, above in _around(world.bounds, world.pits):
        add([(left, below, 0.0), (right, below, 0.0), (right, above, 0.0), (left, above, 0.0)])
    for pit in world.pits:
        left, right = pit.x - pit.half_x, pit.x + pit.half_x
        below, above = pit.y - pit.half_y, pit.y + pit.half_y
        ring = [(left, below), (right, below), (right, above), (left, above)]
        add([(x, y, -pit.depth) for x, y in ring])
        for (ax, ay), (bx, by) in zip(ring, [*ring[1:], ring[0]], strict=True):
            # seen from within
            add([(bx, by, -pit.depth), (ax, ay, -pit.depth), (ax, ay, 0.0), (bx, by, 0.0)])
    _add_mesh(spec, 'floor', mesh, 'floor', FLOOR)


def _around(
    bounds: tuple[float, float, float, float], pits: Sequence[Pit]
) -> list[tuple[float, float, float, float]]:
    """Divide a rectangle without the pits in it into rectangles: x and y of both corners (m)."""
    pieces = [bounds]
    for pit in pits:
        left, right = pit.x - pit.half_x, pit.x + pit.half_x
        below, above = pit.y - pit.half_y, pit.y + pit.half_y
        cut = []
        for x0, y0, x1, y1 in pieces:
            low, high = max(y0, below), min(y1, above)
            if left >= x1 or right <= x0 or low >= high:
                cut.append((x0, y0, x1, y1))
                continue
            parts = [
                (x0, y0, x1, low),
                (x0, high, x1, y1),
                (x0, low, left, high),
                (right, low, x1, high),
            ]
            cut += [part for part in parts if part[0] < part[2] and part[1] < part[3]]
        pieces = cut
    return pieces


def _add_vehicle(
    spec: Any, name: str, color: tuple[float, float, float], config: SimulationConfig
) -> None:
    """Add a cylindrical body, visible to other lasers, with a camera on a post."""
    radius, kinect = config.base.simulated_radius - BODY_INSET, config.kinect
    body = spec.worldbody.add_body(name=name, mocap=True)
    mount = config.camera_mount
    x, y, z = mount.camera_x, mount.camera_y, mount.camera_z
    high = max(0.15, config.laser.simulated_laser_z + LASER_MARGIN)
    cylinder, box = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX
    dark, pale = (0.08, 0.08, 0.09), (0.85, 0.85, 0.85)
    parts = [
        (
            cylinder,
            (radius, (high - BODY_BOTTOM) / 2, 0.0),
            (0.0, 0.0, (high + BODY_BOTTOM) / 2),
            color,
            BODY,
        ),
        (cylinder, (radius + 0.003, 0.02, 0.0), (0.0, 0.0, 0.12), pale, DECORATION),
        (cylinder, (radius - 0.01, 0.005, 0.0), (0.0, 0.0, high), dark, DECORATION),
        (box, (0.01, 0.01, 0.5 * z), (x - 0.05, y, 0.5 * z), dark, DECORATION),
        (box, (0.03, 0.14, 0.02), (x - 0.04, y, z), dark, DECORATION),
    ]
    for kind, size, position, rgb, group in parts:
        name_of = f'paint_{rgb}'
        if spec.material(name_of) is None:
            spec.add_material(name=name_of, rgba=[*rgb, 1.0], emission=1.0, specular=0.0)
        body.add_geom(
            type=kind,
            size=list(size),
            pos=list(position),
            material=name_of,
            contype=0,
            conaffinity=0,
            group=group,
        )
    tangent = math.tan(math.radians(kinect.simulated_camera_angle) / 2)
    ratio = kinect.simulated_image_height / kinect.simulated_image_width
    camera = body.add_camera(name=f'{name}/camera', pos=[x, y, z], quat=_camera_quaternion(mount))
    camera.fovy = math.degrees(2 * math.atan(tangent * ratio))


def _camera_quaternion(mount: CameraMountConfig) -> list[float]:
    """Return the quaternion w, x, y, z of a MuJoCo camera (view -z, up y) for a mount."""
    body = rotation_matrix(mount.camera_roll, mount.camera_pitch, mount.camera_yaw)
    turned: Array = body @ rotation_matrix(math.pi / 2, 0.0, -math.pi / 2)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, turned.ravel())
    return [float(value) for value in quaternion]
