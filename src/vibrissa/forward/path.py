"""The clamp's path in model units: between two positions it moves straight and turns about a fixed
axis.
"""

from dataclasses import dataclass
from functools import cached_property

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from vibrissa.forward.equations import Clamp
from vibrissa.geometry.rotation import lengths, third_axis
from vibrissa.numerics.rotation import third_axis as traced_third_axis
from vibrissa.trail import Trail

# A step moves the rod's ends by at most this many rod lengths; longer ones are divided, so that a
# coarse trail stays on its branch.
LONGEST_STEP = 0.05


@dataclass(frozen=True)
class Path:
    """Poses (m, n) on a grid at least as fine as the trail's: every `stride`-th is one of the
    trail's.
    """

    point: Float[np.ndarray, "m n 3"]
    orientation: Float[np.ndarray, "m n 4"]
    stride: int

    @cached_property
    def tangent(self) -> Float[np.ndarray, "m n 3"]:
        """Unit tangents of the rod at the clamp."""
        return third_axis(self.orientation)


def path_of(trail: Trail, length: float) -> Path:
    """Poses of the trail in rod lengths, divided where a step is longer than `LONGEST_STEP`."""
    n = trail.count
    point = trail.position.reshape(-1, n, 3) / length
    orientation = _continuous(trail.orientation.reshape(-1, n, 4))
    if n == 1:
        return Path(point, orientation, 1)
    moved, turned = lengths(np.diff(point, axis=1)), 2 * lengths(np.diff(orientation, axis=1))
    stride = max(1, int(np.ceil((moved + turned).max() / LONGEST_STEP - 1e-9)))
    if stride == 1:
        return Path(point, orientation, 1)
    share = np.arange((n - 1) * stride + 1) / stride
    start = np.minimum(share.astype(int), n - 2)
    fraction = (share - start)[:, None]
    finer = point[:, start] * (1 - fraction) + point[:, start + 1] * fraction
    return Path(finer, slerp(orientation[:, start], orientation[:, start + 1], fraction), stride)


def extended_back(path: Path, lanes: Int[np.ndarray, "k"], count: int) -> Path:
    """The way on which the first step of each lane would have come: `count` positions
    `LONGEST_STEP` apart, and the lane's first position as the last.
    """
    first, second = (path.point[lanes, index] for index in (0, 1))
    turn, next_turn = (path.orientation[lanes, index] for index in (0, 1))
    motion = np.linalg.norm(second - first, axis=-1) + 2 * np.linalg.norm(next_turn - turn, axis=-1)
    share = (
        -LONGEST_STEP
        * np.arange(count, -1, -1)[:, None]
        / np.where(motion > 0, motion, np.inf)[:, None, None]
    )
    point = first[:, None] + share * (second - first)[:, None]
    return Path(point, slerp(turn[:, None], next_turn[:, None], share), 1)


def slerp(
    first: Float[np.ndarray, "*#batch 4"],
    last: Float[np.ndarray, "*#batch 4"],
    fraction: Float[np.ndarray, "*#batch 1"],
) -> Float[np.ndarray, "... 4"]:
    """Rotation at constant rate from `first` to `last` (…, 4), whose signs agree, at a fraction
    that broadcasts with their rows.
    """
    angle = 2 * np.arcsin(np.minimum(np.linalg.norm(last - first, axis=-1, keepdims=True) / 2, 1))
    sine = np.sin(angle)
    turning = sine > 1e-9
    safe = np.where(turning, sine, 1)
    weight = np.where(turning, np.sin(fraction * angle) / safe, fraction)
    other = np.where(turning, np.sin((1 - fraction) * angle) / safe, 1 - fraction)
    return np.asarray(other * first + weight * last)


def pose_between(
    stretches: Float[np.ndarray, "*#batch 14"], fraction: Float[np.ndarray, "*#batch 1"]
) -> tuple[Float[np.ndarray, "... 3"], Float[np.ndarray, "... 3"]]:
    """Clamp points and tangents at fractions of stretches."""
    point = stretches[..., :3] + fraction * (stretches[..., 7:10] - stretches[..., :3])
    return point, third_axis(slerp(stretches[..., 3:7], stretches[..., 10:], fraction))


def shortened(
    stretches: Float[np.ndarray, "*batch 14"],
    start: Float[np.ndarray, "*batch"],
    stop: Float[np.ndarray, "*batch"],
) -> Float[np.ndarray, "*batch 14"]:
    """The part of each stretch between two fractions."""
    ends = []
    for fraction in (start[..., None], stop[..., None]):
        ends.append(stretches[..., :3] + fraction * (stretches[..., 7:10] - stretches[..., :3]))
        ends.append(slerp(stretches[..., 3:7], stretches[..., 10:], fraction))
    return np.concatenate(ends, axis=-1)


def clamp_between(ends: Float[Array, "14"], fraction: Float[Array, ""]) -> Clamp:
    """Pose on a stretch, given as (point, quaternion) at its start and its end, 14 numbers."""
    first, last = ends[3:7], ends[10:14]
    gap = last - first
    angle = 2 * jnp.arcsin(jnp.minimum(jnp.sqrt(jnp.sum(gap * gap) + 1e-300) / 2, 1.0))
    turning = jnp.sin(angle) > 1e-9
    sine = jnp.where(turning, jnp.sin(angle), 1.0)
    weight = jnp.where(turning, jnp.sin(fraction * angle) / sine, fraction)
    other = jnp.where(turning, jnp.sin((1 - fraction) * angle) / sine, 1 - fraction)
    tangent = traced_third_axis(other * first + weight * last)
    return Clamp(ends[:3] + fraction * (ends[7:10] - ends[:3]), tangent)


def stretch(
    path: Path, lane: int | Array | np.ndarray, index: int | Array | np.ndarray
) -> Float[np.ndarray, "..."]:
    """The 14 numbers of the stretch that ends at position `index` (0 gives a stretch of no length)."""
    before = np.maximum(np.asarray(index) - 1, 0)
    return np.concatenate(
        [
            path.point[lane, before],
            path.orientation[lane, before],
            path.point[lane, index],
            path.orientation[lane, index],
        ],
        axis=-1,
    )


def _continuous(orientation: Float[np.ndarray, "m n 4"]) -> Float[np.ndarray, "m n 4"]:
    # q and −q are the same rotation: choose signs so that neighbours are close.
    flips = np.sum(orientation[:, 1:] * orientation[:, :-1], axis=-1) < 0
    signs = np.concatenate(
        [np.ones((len(orientation), 1)), np.where(np.cumsum(flips, axis=1) % 2, -1.0, 1.0)], axis=1
    )
    return orientation * signs[..., None]
