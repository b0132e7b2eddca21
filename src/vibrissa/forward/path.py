"""The clamp's path in model units: between two positions it moves in a straight line and turns
about a fixed axis.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from vibrissa.geometry.rotation import lengths
from vibrissa.mechanics.model import Clamp, clamp_of
from vibrissa.numerics.lanes import AnyArray
from vibrissa.numerics.rotation import first_axis as traced_first_axis
from vibrissa.numerics.rotation import third_axis as traced_third_axis
from vibrissa.trail import Trail

LONGEST_STEP = 0.05
"""Most [L] that a step moves the rod's ends; longer steps are divided, so that a coarse trail stays
on its branch.
"""
_TINY = 1e-300
_TURNING = 1e-9
"""Sine of an angle below which a rotation is treated as linear."""


class Pose(NamedTuple):
    """Clamp point [L] and quaternion x, y, z, w."""

    point: Float[Any, "*n 3"]
    orientation: Float[Any, "*n 4"]


class Stretch(NamedTuple):
    """The clamp's motion from one position to the next; a single one, or one per row."""

    first: Pose
    last: Pose

    @property
    def motion(self) -> float:
        """About how far it moves the rod's ends [L]."""
        moved, turned = (b - a for a, b in zip(self.first, self.last, strict=True))
        return float(np.linalg.norm(moved) + 2 * np.linalg.norm(turned))

    def at(self, fraction: Float[AnyArray, "*n 1"], xp: Any = np) -> Pose:
        """Poses at fractions (…, 1); `xp` is NumPy or JAX's."""
        point = self.first.point + fraction * (self.last.point - self.first.point)
        return Pose(point, slerp(self.first.orientation, self.last.orientation, fraction, xp))

    def clamp(self, fraction: Float[Array, ""]) -> Clamp:
        """Clamp at a fraction, in compiled code."""
        pose = self.at(fraction[None], jnp)
        turn = pose.orientation
        return Clamp(pose.point, traced_third_axis(turn), traced_first_axis(turn))

    def clamps(self, fraction: Float[np.ndarray, "*n 1"]) -> Clamp:
        """Clamps at fractions (…, 1), as arrays."""
        pose = self.at(fraction)
        return clamp_of(pose.point, pose.orientation)

    def part(self, start: Float[np.ndarray, "*n 1"], stop: Float[np.ndarray, "*n 1"]) -> "Stretch":
        """The part between fractions (…, 1)."""
        return Stretch(self.at(start), self.at(stop))


@dataclass(frozen=True)
class Path:
    """Poses (m, n) on a grid at least as fine as the trail's: every `stride`-th pose is one of the
    trail's.
    """

    point: Float[np.ndarray, "m n 3"]
    orientation: Float[np.ndarray, "m n 4"]
    stride: int

    @property
    def tangent(self) -> Float[np.ndarray, "m n 3"]:
        """Unit tangents of the rod at the clamp."""
        return self.clamps.tangent

    @cached_property
    def clamps(self) -> Clamp:
        """Clamps at all positions (m, n, 3)."""
        return clamp_of(self.point, self.orientation)

    def stretch(self, lane: Any, index: Any) -> Stretch:
        """The stretch that ends at position `index`; 0 gives one of zero length."""
        ends = (np.maximum(np.asarray(index) - 1, 0), index)
        return Stretch(*(Pose(self.point[lane, at], self.orientation[lane, at]) for at in ends))


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
    ends = (Pose(point[:, at], orientation[:, at]) for at in (start, start + 1))
    finer = Stretch(*ends).at((share - start)[:, None])
    return Path(finer.point, finer.orientation, stride)


def extended_back(path: Path, lanes: Int[np.ndarray, "k"], count: int) -> Path:
    """Each lane's first step, extended backwards: `count` positions `LONGEST_STEP` apart, then the
    lane's first position.
    """
    ends = (
        Pose(path.point[lanes, at][:, None], path.orientation[lanes, at][:, None]) for at in (0, 1)
    )
    step = Stretch(*ends)
    moved, turned = (lengths(b - a) for a, b in zip(step.first, step.last, strict=True))
    motion = (moved + 2 * turned)[..., None]
    back = np.arange(count, -1, -1)[:, None]
    way = step.at(-LONGEST_STEP * back / np.where(motion > 0, motion, np.inf))
    return Path(way.point, way.orientation, 1)


def divided(stretches: Stretch, count: int, more: int) -> Path:
    """Stretches (k, …) divided into `count` parts each, and some more, as lanes of a path."""
    ways = jax.tree.map(lambda part: part[:, None], stretches)
    poses = ways.at(np.arange(count + more + 1)[:, None] / count)
    return Path(poses.point, poses.orientation, 1)


def slerp(first: AnyArray, last: AnyArray, fraction: AnyArray, xp: Any = np) -> Any:
    """Rotation at constant rate from `first` to `last` (…, 4), whose signs agree, at a fraction
    that broadcasts with their rows.
    """
    gap = last - first
    half = xp.sqrt(xp.sum(gap * gap, axis=-1, keepdims=True) + _TINY) / 2
    angle = 2 * xp.arcsin(xp.minimum(half, 1.0))
    sine = xp.sin(angle)
    turning = sine > _TURNING
    safe = xp.where(turning, sine, 1.0)
    weight = xp.where(turning, xp.sin(fraction * angle) / safe, fraction)
    other = xp.where(turning, xp.sin((1 - fraction) * angle) / safe, 1 - fraction)
    return other * first + weight * last


def chosen(rows: Any, which: Any) -> Any:
    """The chosen rows of every array in a tree."""
    return jax.tree.map(lambda array: array[which], rows)


def either(which: Bool[np.ndarray, "k"], rows: Any, others: Any) -> Any:
    """Rows of two trees of arrays (k, …): of the first where `which` holds, else of the second."""

    def of(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        return np.where(which.reshape(-1, *(1,) * (one.ndim - 1)), one, other)

    return jax.tree.map(of, rows, others)


def _continuous(orientation: Float[np.ndarray, "m n 4"]) -> Float[np.ndarray, "m n 4"]:
    # q and −q are the same rotation: choose signs so that neighbours are close.
    flips = np.sum(orientation[:, 1:] * orientation[:, :-1], axis=-1) < 0
    odd = np.cumsum(np.pad(flips, ((0, 0), (1, 0))), axis=1) % 2
    return orientation * np.where(odd, -1.0, 1.0)[..., None]
