"""Depth images: conversion to metres, validity, edges, back-projection, covariance."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from explore_slam.data import Intrinsics
from explore_slam.geometry import Array
from explore_slam.vision.sections import DepthConfig

_METRES_PER_MILLIMETRE = np.float32(0.001)
_MEDIAN_WINDOW = 3  # pixels; removes single wild values
_WHOLE_WINDOW = np.ones((_MEDIAN_WINDOW, _MEDIAN_WINDOW), np.uint8)
_EDGE_WINDOW = np.ones((5, 5), np.uint8)  # reaches an edge before the centre of a feature does
_FAR = np.float32(1e6)  # m; in place of missing values where the smallest depth is searched


class DepthLayers(NamedTuple):
    """Depth (H, W) m, 0 if invalid; spread (H, W) m, the range of depths around each pixel."""

    depth: NDArray[np.float32]
    spread: NDArray[np.float32]


def depth_in_metres(depth: NDArray[np.uint16] | NDArray[np.float32]) -> NDArray[np.float32]:
    """Return depth (H, W) in m from uint16 mm or float32 m; 0 if missing."""
    if depth.dtype == np.uint16:
        return depth.astype(np.float32) * _METRES_PER_MILLIMETRE
    metres = np.asarray(depth, dtype=np.float32)
    return np.where(np.isfinite(metres) & (metres > 0.0), metres, np.float32(0.0))


def analyse_depth(
    depth: NDArray[np.uint16] | NDArray[np.float32], config: DepthConfig
) -> DepthLayers:
    """Return depth without speckle and values out of range, and its local spread.

    Speckle is removed by a median of 3 x 3, edges are detected by the range over 5 x 5 pixels.
    Depths out of range count for the spread: a feature in front of a far wall is on an edge,
    though the wall itself is not a valid measurement.

    A pixel is valid only if all nine readings of its median are there. The median would take those
    that are missing as 0. Near the end of the camera's range the far half of the noise is missing,
    so that the rest of it is measured too near: there hardly any pixel remains.
    """
    metres = depth_in_metres(depth)
    smooth = cv2.medianBlur(metres, _MEDIAN_WINDOW)
    highest = cv2.dilate(metres, _EDGE_WINDOW)
    lowest = cv2.erode(np.where(metres > 0.0, metres, _FAR), _EDGE_WINDOW)
    complete = cv2.erode(metres, _WHOLE_WINDOW) > 0.0
    valid = complete & (smooth >= config.min_depth) & (smooth <= config.max_depth)
    zero = np.float32(0.0)
    return DepthLayers(np.where(valid, smooth, zero), np.where(valid, highest - lowest, zero))


def back_project(pixels: Array, depths: Array, camera: Intrinsics) -> Array:
    """Return points (N, 3) m in the optical frame, from pixels (N, 2) (u, v) and depths (N,) m."""
    rays = camera_rays(pixels, camera)
    return np.stack([rays[:, 0] * depths, rays[:, 1] * depths, depths], axis=1)


def camera_rays(pixels: Array, camera: Intrinsics) -> Array:
    """Return x/z and y/z (N, 2) of pixels (N, 2) (u, v), with lens distortion removed."""
    if any(camera.distortion) and len(pixels):
        if camera.distortion_model == 'inverse_brown_conrady':
            return _inverse_brown_conrady(pixels, camera)
        matrix = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0, 0, 1.0]])
        points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        fisheye = camera.distortion_model == 'equidistant'
        undistort = cv2.fisheye.undistortPoints if fisheye else cv2.undistortPoints
        rays = undistort(points, matrix, np.array(camera.distortion))
        return np.asarray(rays, dtype=np.float64).reshape(-1, 2)
    center = np.array([camera.cx, camera.cy])
    undistorted: Array = (pixels - center) / np.array([camera.fx, camera.fy])
    return undistorted


def _inverse_brown_conrady(pixels: Array, camera: Intrinsics) -> Array:
    """Return x/z and y/z (N, 2): the model of librealsense that maps distorted to ideal points."""
    k1, k2, p1, p2, k3 = camera.distortion
    x = (pixels[:, 0] - camera.cx) / camera.fx
    y = (pixels[:, 1] - camera.cy) / camera.fy
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y),
        ],
        axis=1,
    )


def point_covariances(
    points: Array, camera: Intrinsics, pixel_noise: Array, depth_noise: Array
) -> Array:
    """Return covariances (N, 3, 3) m² of back-projected points (N, 3) m, to first order.

    pixel_noise (N,) px and depth_noise (N,) m: standard deviations.
    The covariance is J diag(noise²) Jᵀ with J = ∂(x, y, z) / ∂(u, v, z) of x = (u - cx) z / fx.
    """
    depths = points[:, 2]
    jacobian = np.zeros((len(points), 3, 3))
    jacobian[:, 0, 0] = depths / camera.fx * pixel_noise
    jacobian[:, 1, 1] = depths / camera.fy * pixel_noise
    jacobian[:, 0, 2] = points[:, 0] / depths * depth_noise
    jacobian[:, 1, 2] = points[:, 1] / depths * depth_noise
    jacobian[:, 2, 2] = depth_noise
    covariances: Array = jacobian @ jacobian.transpose(0, 2, 1)
    return covariances
