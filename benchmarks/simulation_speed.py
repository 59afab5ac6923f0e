"""Rendered simulator: time of a frame relative to `mujoco.Renderer`, cost of a team.

python benchmarks/simulation_speed.py [--world office] [--views 100]
Times are CPU time of this process and, in parentheses, wall time; software OpenGL uses all cores.
`mujoco.Renderer` needs one pass for colour and another one for depth.
"""

import argparse
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from explore_slam.data import RgbdFrame
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.simulation import SimulationConfig, Simulator, World, load_world, world_path
from explore_slam.simulation.rendered.model import FLOOR, RenderedWorld, build_model
from explore_slam.simulation.rendered.mujoco_import import mujoco
from explore_slam.simulation.rendered.renderer import Renderer
from explore_slam.simulation.worlds.obstacles import Obstacles
from explore_slam.vision import FeatureExtractor, VisionConfig


def timed(work: Callable[[], Any], times: int) -> tuple[float, float]:
    """Return CPU and wall time (ms) of one call."""
    work()
    cpu, wall = time.process_time(), time.perf_counter()
    for _ in range(times):
        work()
    return (
        1e3 * (time.process_time() - cpu) / times,
        1e3 * (time.perf_counter() - wall) / times,
    )


def place(rendered: RenderedWorld, data: Any, pose: Pose2) -> None:
    """Move the first vehicle to a pose."""
    data.mocap_pos[0] = (pose.x, pose.y, 0.0)
    data.mocap_quat[0] = (math.cos(pose.theta / 2), 0.0, 0.0, math.sin(pose.theta / 2))
    mujoco.mj_kinematics(rendered.model, data)
    mujoco.mj_camlight(rendered.model, data)


def compare_passes(world: World) -> None:
    """Print the time of one pass beside that of two passes of mujoco.Renderer."""
    config = SimulationConfig()
    rendered = build_model(world, ['a'], config)
    data = mujoco.MjData(rendered.model)
    place(rendered, data, next(iter(world.starts.values())))
    ours = Renderer(rendered)
    one = timed(lambda: ours.render(data, 0), 40)
    ours.close()
    theirs = mujoco.Renderer(rendered.model, 480, 640)
    options = mujoco.MjvOption()
    options.geomgroup[FLOOR] = 1

    def two_passes() -> None:
        theirs.update_scene(data, camera=0, scene_option=options)
        theirs.render()
        theirs.enable_depth_rendering()
        theirs.render()
        theirs.disable_depth_rendering()

    two = timed(two_passes, 40)
    theirs.close()
    print(f'color and depth, one pass        {one[0]:7.2f} ms ({one[1]:.2f})')
    print(f'mujoco.Renderer, two passes      {two[0]:7.2f} ms ({two[1]:.2f})')
    print(f'ratio                            {one[0] / two[0]:7.2f}')


def measure_team(world: World) -> None:
    """Print the cost of a simulated second by number of vehicles."""
    for count in range(1, 1 + min(4, len(world.starts))):
        starts = dict(list(world.starts.items())[:count])
        for rate, what in ((4.0, 'laser and camera'), (0.0, 'laser only      ')):
            config = with_values(SimulationConfig(), {'simulated_camera_rate': rate})
            with Simulator(world, starts, config) as simulator:
                for name in starts:
                    simulator.set_velocity(name, 0.0, 0.5)

                def second(simulator: Simulator = simulator) -> None:
                    for _ in range(50):
                        simulator.step()

                cpu, wall = timed(second, 5)
            print(
                f'{count} vehicles, {what} {cpu:7.1f} ms ({wall:.1f}) per simulated second: '
                f'{1e3 / wall:.0f} times real time'
            )


def count_features(world: World, views: int) -> None:
    """Print the number of SIFT features with valid depth in random views."""
    clearance, rng = Obstacles(world).clearance, np.random.default_rng(0)
    extractor = FeatureExtractor(with_values(VisionConfig(), {'feature_budget': 5000}))
    x0, y0, x1, y1 = world.bounds
    counts = []
    while len(counts) < views:
        pose = Pose2(rng.uniform(x0, x1), rng.uniform(y0, y1), rng.uniform(-math.pi, math.pi))
        if not 0.4 < clearance(pose.x, pose.y) < 5.0:
            continue
        counts.append((pose, 0))
    kept = []
    config = with_values(SimulationConfig(), {'simulated_scan_rate': 0.0})
    with Simulator(world, {'a': counts[0][0]}, config) as simulator:
        for pose, _ in counts:
            simulator.place('a', pose)
            frame: RgbdFrame | None = None
            while frame is None:
                records = [event.record for event in simulator.step()]
                frame = next((r for r in records if isinstance(r, RgbdFrame)), None)
            if np.mean(frame.depth > 0) > 0.25:
                kept.append(len(extractor.extract(frame)))
    shares = [100.0 * np.mean(np.array(kept) >= least) for least in (50, 100, 200)]
    print(
        f'{len(kept)} of {views} random views have valid depth on more than a quarter: '
        f'median {np.median(kept):.0f} features; at least 50, 100, 200 in '
        + ', '.join(f'{share:.0f} %' for share in shares)
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--world', default='office')
    parser.add_argument('--views', type=int, default=100)
    arguments = parser.parse_args()
    begun = time.perf_counter()
    world = load_world(world_path(arguments.world))
    Simulator(world).close()
    print(f'{world.name}: loaded and built in {time.perf_counter() - begun:.1f} s')
    compare_passes(world)
    measure_team(world)
    count_features(world, arguments.views)


if __name__ == '__main__':
    main()
