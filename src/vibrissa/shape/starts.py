"""First guesses of a known object's pose.

Pairs of contacts are compared with pairs of points of the object: those with the same distance and
the same angles between normals and chord give a pose (point pair features: Drost et al., CVPR
2010).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from vibrissa.shape.area import points_over
from vibrissa.shape.poses import Poses
from vibrissa.shape.sites import Gathered, spread_out
from vibrissa.surfaces import Surface

_SAMPLES = 700
"""Points of the object that pairs are taken from."""
_PAIRS, _MATCHES = 12, 2500
"""Pairs of contacts, the widest first, and pairs of the object that each is compared with."""
_STARTS = 60
"""First guesses at most."""
_APART = 0.15
"""Difference of two, as angle plus relative shift: Newton's method bridges less."""


_NOTHING = (
    "surface: nothing of it is near its origin, or it is too thin for its width to be found, as a "
    "mesh of it is"
)


class Sampled(NamedTuple):
    """Points of the object, and its outward normals there."""

    point: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]


def samples(surface: Surface, extent: float, rng: np.random.Generator) -> Sampled:
    """Points spread evenly over the object."""
    origin, nothing = np.zeros((1, 3)), _NOTHING
    reach, beyond, count = 20 * extent, 2 * extent, 8 * _SAMPLES
    points = points_over(surface, origin, reach, beyond, count, rng, said=nothing)
    points = points[spread_out(points, _SAMPLES)]
    return Sampled(points, surface.normal(points))


def starts(given: Gathered, sampled: Sampled) -> Poses:
    """Poses that bring pairs of contacts onto pairs of the object, the best by all contacts."""
    first, second = np.nonzero(~np.eye(len(sampled.point), dtype=bool))
    features = _features(sampled.point, sampled.normal, first, second, given.extent)
    tree = KDTree(features)
    rotations, translations = [], []
    for i, j in _pairs(given):
        ends = np.array([i]), np.array([j])
        own = _features(given.point, given.normal, *ends, given.extent)[0]
        _, near = tree.query(own, min(_MATCHES, len(features)))
        there = _frames(sampled.point, sampled.normal, first[near], second[near])
        here = _frames(given.point, given.normal, *ends)
        turn = here @ np.swapaxes(there, 1, 2)
        middle = 0.5 * (sampled.point[first[near]] + sampled.point[second[near]])
        rotations.append(turn)
        translations.append(
            0.5 * (given.point[i] + given.point[j]) - np.einsum("nij,nj->ni", turn, middle)
        )
    turn, shift = np.concatenate(rotations), np.concatenate(translations)
    score = _scores(given, sampled, turn, shift)
    left, chosen = np.argsort(score), list[int]()
    while len(left) and len(chosen) < _STARTS:
        best, left = left[0], left[1:]
        chosen.append(int(best))
        cosine = 0.5 * (np.einsum("nij,ij->n", turn[left], turn[best]) - 1)
        moved = np.linalg.norm(shift[left] - shift[best], axis=1) / given.extent
        left = left[np.arccos(np.clip(cosine, -1, 1)) + moved > _APART]
    return Poses(turn[chosen], shift[chosen])


def turned(pose: Poses, sampled: Sampled) -> Poses:
    """One with the object turned by quarter and half turns about its principal axes: what most of
    its contacts may hardly tell apart, as a mug from one upside down.
    """
    middle = sampled.point.mean(axis=0)
    axes = np.linalg.eigh(np.cov(sampled.point.T))[1]
    angle = np.pi / 2 * np.array([1, 2, 3])
    spin = Rotation.from_rotvec((angle[:, None, None] * axes.T).reshape(-1, 3)).as_matrix()
    turn = pose.turn @ spin
    return Poses(turn, pose.shift + (pose.turn - turn) @ middle)


def _pairs(given: Gathered) -> list[tuple[int, int]]:
    """Pairs of contacts with the widest chords and normals that differ most."""
    first, second = np.triu_indices(len(given.point), 1)
    chord = np.linalg.norm(given.point[first] - given.point[second], axis=1) / given.extent
    across = np.linalg.norm(np.cross(given.normal[first], given.normal[second]), axis=1)
    best = np.argsort(-(chord * (0.2 + across)))[:_PAIRS]
    return list(zip(first[best].tolist(), second[best].tolist(), strict=True))


def _features(
    point: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 3"],
    first: Int[np.ndarray, "k"],
    second: Int[np.ndarray, "k"],
    extent: float,
) -> Float[np.ndarray, "k 4"]:
    """Length of the chord, relative to the extent, and cosines that do not change with the pose."""
    chord = point[second] - point[first]
    length = np.linalg.norm(chord, axis=1)
    along = chord / length[:, None]
    one, other = normal[first], normal[second]
    cosines = [
        np.einsum("ni,ni->n", *pair) for pair in ((one, along), (other, along), (one, other))
    ]
    return np.column_stack([2 * length / extent, *cosines])


def _frames(
    point: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 3"],
    first: Int[np.ndarray, "k"],
    second: Int[np.ndarray, "k"],
) -> Float[np.ndarray, "k 3 3"]:
    """Axes of pairs: along the chord, and towards the sum or difference of the normals."""
    along = point[second] - point[first]
    along /= np.linalg.norm(along, axis=1)[:, None]
    total = normal[first] + normal[second]
    # Opposite normals have no sum.
    total = np.where(
        np.linalg.norm(total, axis=1)[:, None] > 0.3, total, normal[first] - normal[second]
    )
    aside = total - np.einsum("ni,ni->n", total, along)[:, None] * along
    aside /= np.maximum(np.linalg.norm(aside, axis=1), 1e-12)[:, None]
    return np.stack([along, aside, np.cross(along, aside)], axis=-1)


def _scores(
    given: Gathered,
    sampled: Sampled,
    turn: Float[np.ndarray, "k 3 3"],
    shift: Float[np.ndarray, "k 3"],
) -> Float[np.ndarray, "k"]:
    """How far poses miss the contacts: robust mean over contacts of distance and normal."""
    score = np.zeros(len(turn))
    tree = KDTree(sampled.point)
    for point, normal in zip(given.point, given.normal, strict=True):
        place = np.einsum("nji,nj->ni", turn, point - shift)
        direction = np.einsum("nji,j->ni", turn, normal)
        _, near = tree.query(place)
        apart, there = place - sampled.point[near], sampled.normal[near]
        off = np.einsum("ni,ni->n", apart, there) / given.extent
        far = np.linalg.norm(apart, axis=1) / given.extent
        tilt = np.linalg.norm(direction - there, axis=1)
        score += np.minimum((off / 0.02) ** 2 + (far / 0.1) ** 2 + (tilt / 0.3) ** 2, 9.0)
    return score
