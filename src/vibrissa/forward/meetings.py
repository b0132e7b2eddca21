"""Where the straight rod of each trail meets the object: geometry, before mechanics."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.forward.approach import clearances, first_contacts
from vibrissa.forward.equations import Scene
from vibrissa.forward.landing import CLEAR, HEAD_ON_COSINE
from vibrissa.forward.locate import WIDTH as EVENT_LANES
from vibrissa.forward.path import Path, pose_between, shortened, stretch
from vibrissa.geometry.rotation import lengths

# Poses looked at between two positions near the object, lest something thin be passed through.
_LOOKS = 16


class Meetings(NamedTuple):
    """First contacts of the straight rod, one a row."""

    lane: Int[np.ndarray, "k"]
    step: Int[np.ndarray, "k"]
    fraction: Float[np.ndarray, "k"]
    point: Float[np.ndarray, "k 3"]
    phase: Float[np.ndarray, "k"]
    arc_length: Float[np.ndarray, "k"]
    """[L]."""
    tangent: Float[np.ndarray, "k 3"]
    """Of the rod, straight as it still is."""


def along_trails(
    scene: Scene, path: Path
) -> tuple[Float[np.ndarray, "m n"], Float[np.ndarray, "m n"]]:
    """Clearance of the straight rod, and level at the clamp, at all positions."""
    shape = path.point.shape[:2]
    poses = (path.point.reshape(-1, 3), path.tangent.reshape(-1, 3))
    values = scene.in_blocks(clearances, *poses)
    return values[:, 0].reshape(shape), values[:, 1].reshape(shape)


def first_meetings(
    scene: Scene, path: Path, clear: Bool[np.ndarray, "m n"], distance: Float[np.ndarray, "m n"]
) -> Meetings:
    """First contacts on steps from a clear position to one that is not, or through something thin."""
    lane, step = np.nonzero(clear[:, :-1] & ~clear[:, 1:])
    index, whole = step + 1, np.ones(len(lane))
    blocked = distance[lane, index]
    passed = _passed_through(scene, path, clear, distance)
    lane, index, whole, blocked = (
        np.concatenate(parts) for parts in zip((lane, index, whole, blocked), passed, strict=True)
    )
    if not len(lane):
        none = np.zeros(0)
        return Meetings(lane, index, none, np.zeros((0, 3)), none, none, np.zeros((0, 3)))
    distances = np.column_stack([distance[lane, index - 1], blocked])
    stretches = shortened(stretch(path, lane, index), np.zeros(len(lane)), whole)
    found = scene.in_blocks(first_contacts, stretches, distances, width=EVENT_LANES)
    found = np.column_stack([found[:, 0] * whole, found[:, 1:]])
    cosine = found[:, 5]
    bends = cosine > HEAD_ON_COSINE
    # At f = 0: k² = sin² a₀ = (1 + n·t0)/2.
    phase = (1 - found[:, 4]) + cosine / 2
    _, tangent = pose_between(stretch(path, lane, index), found[:, :1])
    return Meetings(
        *(
            part[bends]
            for part in (lane, index, found[:, 0], found[:, 1:4], phase, found[:, 4], tangent)
        )
    )


def _passed_through(
    scene: Scene, path: Path, clear: Bool[np.ndarray, "m n"], distance: Float[np.ndarray, "m n"]
) -> tuple[
    Int[np.ndarray, "k"], Int[np.ndarray, "k"], Float[np.ndarray, "k"], Float[np.ndarray, "k"]
]:
    """Steps between two clear positions on which the straight rod passes through something thin:
    lane, index of the end, fraction and clearance within.
    """
    tangent = path.tangent
    motion = lengths(np.diff(path.point, axis=1)) + lengths(np.diff(tangent, axis=1))
    near = clear[:, :-1] & clear[:, 1:] & (np.maximum(distance[:, :-1], distance[:, 1:]) < motion)
    lane, step = np.nonzero(near)
    if not len(lane):
        return lane, step, np.zeros(0), np.zeros(0)
    fractions = np.arange(1, _LOOKS) / _LOOKS
    poses = pose_between(stretch(path, lane, step + 1)[:, None], fractions[:, None])
    within = scene.in_blocks(clearances, *(part.reshape(-1, 3) for part in poses))[:, 0].reshape(
        len(lane), -1
    )
    hit = np.flatnonzero((within < CLEAR).any(axis=1))
    first = np.argmax(within[hit] < CLEAR, axis=1)
    return lane[hit], step[hit] + 1, fractions[first], within[hit, first]
