"""Kinds of descriptors that the filter can match: one entry of KINDS each.

The filter compares descriptors by the squared Euclidean distance E of unit vectors, 0 to 4 (the
paper's E, step 2.2.1). A kind says how the descriptors of observations become such vectors, and
which distances are small for it. To add a kind, write a DescriptorKind and list it in KINDS; the
setting `descriptor_kind` then accepts its name.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import ConfigError, SlamError

Vectors = NDArray[np.float32]

# Descriptors are compared in steps of this many numbers, see kd_forest.squared_distance.
STEP = 32
# Tolerance of the length of a unit vector: above the rounding of descriptors stored as bytes.
NORM_TOLERANCE = 0.01


@dataclass(frozen=True)
class DescriptorKind:
    """How descriptors of one kind are stored and compared.

    length: numbers (euclidean) or bytes (hamming) per descriptor.
    metric: 'euclidean' for float32 vectors of unit length; 'hamming' for bits packed in uint8.
    same: distance E up to which two descriptors count as those of the same landmark, without a
    comparison to the next nearest.
    ratio: largest quotient of the distance E to the nearest and to the next nearest landmark
    elsewhere at which a match is distinctive (Lowe's ratio test; E is squared, so 0.8² = 0.64).

    Bits become numbers ± 1/√B, B their count; E is then 4 h / B for a Hamming distance of h bits,
    so that one index and one scale of thresholds serve both metrics. A landmark takes 4 B bytes.
    """

    name: str
    length: int
    metric: Literal['euclidean', 'hamming']
    same: float
    ratio: float

    def __post_init__(self) -> None:
        if self.length <= 0 or self.dimensions % STEP:
            raise ConfigError(
                f'descriptor kind {self.name}: {self.dimensions} dimensions, '
                f'expected a multiple of {STEP}'
            )
        if not (0.0 <= self.same <= 4.0 and 0.0 < self.ratio <= 1.0):
            raise ConfigError(
                f'descriptor kind {self.name}: same {self.same} and ratio {self.ratio}, '
                'expected 0 to 4, and above 0 up to 1'
            )

    @property
    def dimensions(self) -> int:
        """The length of the vectors that are compared."""
        return self.length if self.metric == 'euclidean' else 8 * self.length

    def check(self, descriptors: NDArray[Any]) -> None:
        """Raise SlamError for descriptors (K, length) of another type, length or norm."""
        floating = self.metric == 'euclidean'
        fits = descriptors.dtype.kind == 'f' if floating else descriptors.dtype == np.uint8
        if not fits or descriptors.shape[1] != self.length:
            raise SlamError(
                f'observations: descriptors are {descriptors.dtype} (K, {descriptors.shape[1]}), '
                f'expected {"float32" if floating else "uint8"} (K, {self.length}) '
                f'of kind {self.name}'
            )
        if self.metric == 'hamming':
            return
        norms = np.linalg.norm(descriptors, axis=1)
        bad = np.flatnonzero(np.abs(norms - 1.0) > NORM_TOLERANCE)
        if len(bad):
            raise SlamError(
                f'observations: descriptor {bad[0]} has length {norms[bad[0]]:.4g}, expected 1'
            )

    def vectors(self, descriptors: NDArray[Any]) -> Vectors:
        """Return the unit vectors (K, dimensions) of descriptors (K, length)."""
        if self.metric == 'euclidean':
            return np.ascontiguousarray(descriptors, np.float32)
        size = np.float32(1.0 / np.sqrt(self.dimensions))
        signs = 2.0 * np.unpackbits(descriptors, axis=1).astype(np.float32) - 1.0
        return np.ascontiguousarray(size * signs, np.float32)

    def descriptors(self, vectors: Vectors) -> NDArray[Any]:
        """Return the descriptors (K, length) of vectors (K, dimensions)."""
        return vectors if self.metric == 'euclidean' else np.packbits(vectors > 0.0, axis=1)


# Lowe, "Distinctive image features from scale-invariant keypoints", 2004: ratio 0.8. `same` is a
# twentieth of the paper's E0, so that repeated views pass even among similar textures.
SIFT = DescriptorKind('sift', 128, 'euclidean', same=0.02, ratio=0.64)

# Rublee et al., "ORB: an efficient alternative to SIFT or SURF", 2011: 256 bits. ORB-SLAM
# (Mur-Artal et al., 2015) takes up to 50 bits as a match (E = 0.78) and ratios of 0.6 to 0.9 of h.
ORB = DescriptorKind('orb', 32, 'hamming', same=0.1, ratio=0.75)

# DeTone et al., "SuperPoint: self-supervised interest point detection and description", 2018: 256
# numbers; its authors match up to a distance of 0.7 (E = 0.49).
SUPERPOINT = DescriptorKind('superpoint', 256, 'euclidean', same=0.02, ratio=0.64)

KINDS = {kind.name: kind for kind in (SIFT, ORB, SUPERPOINT)}


def kind_named(name: str) -> DescriptorKind:
    """Return the kind of a name; ConfigError if there is none."""
    if name not in KINDS:
        raise ConfigError(f'descriptor_kind is {name!r}, expected one of {list(KINDS)}')
    return KINDS[name]
