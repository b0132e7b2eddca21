"""How the contact moves over the object and along the rod, step by step (mechanics.md, "Slip")."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vibrissa.brief import brief


@dataclass(frozen=True, eq=False)
class Slip:
    """Slip between each position and the one before it (…), in units of the rod; NaN on the first
    and where either has no contact.

    Attributes
    ----------
    axial
        Motion of the contact along the rod, ds₁.
    longitudinal
        Motion of the contact point over the object within the bending plane, along the rod's
        tangent.
    lateral
        Motion of the contact point normal to the bending plane, along t0 × n.
    sliding
        (…, 3) displacement of the rod's material point over the object, dP₁ − t ds₁, which friction
        would oppose.
    """

    axial: Float[np.ndarray, "*trail n"]
    longitudinal: Float[np.ndarray, "*trail n"]
    lateral: Float[np.ndarray, "*trail n"]
    sliding: Float[np.ndarray, "*trail n 3"]

    __repr__ = brief


def slip_along(
    point: Float[np.ndarray, "*trail n 3"],
    arc_length: Float[np.ndarray, "*trail n"],
    tangent: Float[np.ndarray, "*trail n 3"],
    plane_normal: Float[np.ndarray, "*trail n 3"],
) -> Slip:
    """Slip along trails; bending plane and tangent of a step are the means of its two ends."""
    moved = np.diff(point, axis=-2)
    axial = np.diff(arc_length, axis=-1)
    across = _direction(plane_normal[..., 1:, :] + plane_normal[..., :-1, :])
    along = tangent[..., 1:, :] + tangent[..., :-1, :]
    along = _direction(along - _dot(along, across)[..., None] * across)
    lateral = _dot(moved, across)
    in_plane = moved - lateral[..., None] * across
    longitudinal = np.copysign(np.sqrt(_dot(in_plane, in_plane)), _dot(in_plane, along))
    sliding = moved - along * axial[..., None]
    return Slip(
        led(axial),
        led(longitudinal),
        led(lateral),
        np.concatenate([np.full_like(point[..., :1, :], np.nan), sliding], axis=-2),
    )


def led(steps: Float[np.ndarray, "*trail steps"]) -> Float[np.ndarray, "*trail n"]:
    """Values per step as values per position: NaN on the first."""
    return np.concatenate([np.full((*steps.shape[:-1], 1), np.nan), steps], axis=-1)


def _dot(
    first: Float[np.ndarray, "*batch 3"], second: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch"]:
    return np.asarray(np.einsum("...i,...i->...", first, second))


def _direction(vector: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.divide(vector, length, out=np.full_like(vector, np.nan), where=length > 0)
