"""Agreement of closure candidates: each waits until enough others, of other scans, agree."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from explore_slam.geometry import Array, between, compose
from explore_slam.slam.closures.anchors import Anchor, Anchors
from explore_slam.slam.closures.closure import Closure

# What two correct candidates may differ by: their own errors, and drift over the distance between
# them on both sides (Intel, ACES, Belgioioso).
_POSITION = (0.15, 0.03)  # m, m per m
_HEADING = (0.03, 0.004)  # rad, rad per m
_DISTANCE_BETWEEN_VEHICLES = 3.0  # m, assumed between anchors of two vehicles


@dataclass(frozen=True)
class Candidate:
    """A closure that has passed the individual tests, with the anchors at both ends."""

    a: Anchor
    b: Anchor
    closure: Closure


def agree(one: Candidate, other: Candidate, poses: Array) -> bool:
    """Return whether two candidates between the same two vehicles are consistent.

    The motion from one's a to the other's b is the same through either closure.
    """
    along_b = between(poses[one.b.keyframe], poses[other.b.keyframe])
    along_a = between(poses[one.a.keyframe], poses[other.a.keyframe])
    off = between(
        compose(np.asarray(one.closure.pose), along_b),
        compose(along_a, np.asarray(other.closure.pose)),
    )
    distance_driven = abs(one.b.distance_driven - other.b.distance_driven)
    distance_driven += (
        abs(one.a.distance_driven - other.a.distance_driven)
        if one.a.vehicle == other.a.vehicle
        else _DISTANCE_BETWEEN_VEHICLES
    )
    return (
        math.hypot(off[0], off[1]) < _POSITION[0] + _POSITION[1] * distance_driven
        and abs(off[2]) < _HEADING[0] + _HEADING[1] * distance_driven
    )


def largest_agreement(
    newest: Candidate, pending: Sequence[Candidate], poses: Array, tied: bool = True
) -> list[Candidate]:
    """Return the newest candidate and those pending ones of other scans that agree pairwise.

    tied: whether poses of the two vehicles are in one frame. If not, only candidates that lead
    to the same vehicle can be compared.
    """
    group = [newest]
    for candidate in reversed(pending):
        if candidate.b.vehicle != newest.b.vehicle or candidate.b.keyframe == newest.b.keyframe:
            continue
        if not tied and candidate.a.vehicle != newest.a.vehicle:
            continue
        if all(
            candidate.b.keyframe != member.b.keyframe and agree(candidate, member, poses)
            for member in group
        ):
            group.append(candidate)
    return group


def unexpired(
    candidates: Sequence[Candidate], newest: Candidate, within: float
) -> list[Candidate]:
    """Return candidates without those that the newest one's vehicle passed too long ago.

    within: distance (m) that it has driven since.
    """
    b = newest.b
    return [
        c
        for c in candidates
        if c.b.vehicle != b.vehicle or b.distance_driven - c.b.distance_driven < within
    ]


def span(group: Sequence[Candidate]) -> float:
    """Return the distance driven (m) over which the queries of candidates lie."""
    distances_driven = [candidate.b.distance_driven for candidate in group]
    return max(distances_driven) - min(distances_driven)


def candidate_rows(candidates: Sequence[Candidate]) -> Array:
    """Return candidates as rows (n, 19): the closure, and the keyframes of both anchors."""
    rows = [np.r_[c.closure.row(), c.a.keyframe, c.b.keyframe] for c in candidates]
    return np.array(rows).reshape(-1, 19)


def candidates_of_rows(rows: Array, anchors: Anchors) -> list[Candidate]:
    """Return the candidates that `candidate_rows` was given."""
    found = []
    for row in rows:
        a, b = (anchors.of_keyframe(int(keyframe)) for keyframe in row[17:])
        found.append(Candidate(a, b, Closure.from_row(row)))
    return found
