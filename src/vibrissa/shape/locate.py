"""Where a known object is: its pose from a few contacts.

From a cold start (`starts`), Levenberg and Marquardt's method (`poses`) finds the minima of the
misfit; each is followed as far as the contacts allow (`valleys`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp
from scipy.stats import chi2

from vibrissa.contacts import Contacts
from vibrissa.shape.poses import Equations, Poses, errors, fitted, likeness
from vibrissa.shape.sites import Gathered, gathered, outside, spread_out
from vibrissa.shape.starts import samples, starts
from vibrissa.shape.valleys import apart, bounds
from vibrissa.surfaces import Placed, Surface

_LIKELY = 12.0
"""Squared residual above that of the best pose, in stated errors, up to which a pose fits too."""
_SAME, _NEAR = 1e-2, 4.0
"""Difference of poses, as an angle or relative to the extent, and in deviations, that is none."""
_MOST, _FEW, _KEPT = 120, 40, 12
"""Contacts that count at most, those that first guesses are tried with, and guesses that are then
improved with all: a dozen contacts mostly determine a pose.
"""
_TURNED = 0.5
"""Distance, relative to the extent, that contacts with perpendicular normals are apart as if by."""
_WORSE = 1e-6
"""Probability of a misfit as large as the best pose's, below which a word is due."""


class Pose(NamedTuple):
    """Where an object is: its points x lie at `rotation` x + `translation`."""

    rotation: Rotation
    translation: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "6 6"]
    """Of a small rotation vector about the contacts' middle [rad] and a shift there, world axes;
    nothing along directions that are free.
    """
    free: Float[np.ndarray, "k 6"]
    """Directions of such a motion that the contacts leave open, as of a symmetric object."""
    misfit: float
    """Sum of squared residuals in stated errors."""


@dataclass(frozen=True, eq=False)
class Location:
    """Poses of a known object that contacts allow, the best first.

    Attributes
    ----------
    surface
        The object as it was given.
    poses
        All poses found that fit; those that differ by a free motion only are one.
    middle
        (3,) about which covariances are: the middle of the contacts, within their errors.
    freedom
        Degrees of freedom of the misfit.
    log_evidence
        Logarithm of the probability of the contacts if they are of this object in any pose, up to
        what is the same for all objects: what `identify` compares.
    warnings
        One line if even the best pose does not fit.
    """

    surface: Surface
    poses: list[Pose]
    middle: Float[np.ndarray, "3"]
    freedom: int
    log_evidence: float
    warnings: list[str]

    def __repr__(self) -> str:
        """Return one line for each pose."""
        lines = [f"Location with {len(self.poses)} poses, {self.freedom} degrees of freedom"]
        for pose in self.poses:
            turn = np.degrees(pose.rotation.magnitude())
            lines.append(
                f"  misfit {pose.misfit:.3g}, {len(pose.free)} directions free, turned by "
                f"{turn:.1f}°, moved by {np.array2string(pose.translation, precision=4)}"
            )
        return "\n".join(lines)

    @property
    def rotation(self) -> Rotation:
        """Of the best pose."""
        return self.poses[0].rotation

    @property
    def translation(self) -> Float[np.ndarray, "3"]:
        """Of the best pose."""
        return self.poses[0].translation

    @property
    def covariance(self) -> Float[np.ndarray, "6 6"]:
        """Of the best pose."""
        return self.poses[0].covariance

    @property
    def placed(self) -> Placed:
        """The object at the best pose."""
        return self.surface.placed(self.rotation, self.translation)


def locate(surface: Surface, contacts: Contacts | Sequence[Contacts]) -> Location:
    """Pose of a known object from a few contacts with normals, without a first guess.

    Parameters
    ----------
    surface
        The object in its own axes, about their origin: a mesh or any other surface.
    contacts
        With covariances, best `vibrissa.smooth(found).contacts`. Errors that are alike along a
        sweep widen covariances, as far as residuals show it.

    Returns
    -------
    Location
        All poses that fit: several where the object is symmetric or the contacts leave more than
        one; directions that they leave free are named.

    Raises
    ------
    ValueError
        If fewer than three contacts can be used, or nothing is found of the object about its
        origin.
    ImportError
        If the libraries of `vibrissa[mesh]` are not installed.

    Notes
    -----
    The misfit is followed as far as it stays low: covariances hold where contacts bound a motion
    only far off, or through the ripple of a mesh, and a motion that they do not bound within 0.5
    rad or half the extent is free (mechanics.md, "Where a known object is"). Of more than 120
    contacts, the 120 farthest from one another count.
    """
    return located(surface, gathered(contacts))


def located(surface: Surface, everything: Gathered) -> Location:
    """`locate` for contacts that were gathered."""
    given = _spread(outside(everything), _MOST)
    few = _spread(given, _FEW)
    sampled = samples(surface, given.extent, np.random.default_rng(0))
    poses, found = fitted(surface, few, starts(few, sampled))
    if len(few.point) < len(given.point):
        near = np.argsort(found.misfit)[:_KEPT]
        poses, found = fitted(surface, given, poses.part(near))
    first = int(np.argmin(found.misfit))
    alike, least = likeness(given, found.part(slice(first, first + 1))), found.misfit[first]
    freedom = 3 * len(given.point) - 6
    fits = freedom <= 0 or bool(chi2.sf(alike.share * least, alike.share * freedom) > _WORSE)
    listed, evidence = _listed(surface, given, poses, found, alike.factor, follow=fits)
    freedom += len(listed[0].free)
    warnings = []
    if not fits:
        warnings.append(
            f"the best pose misses the contacts by {np.sqrt(least / freedom):.2g} times their "
            "stated errors: it may be another object, or deformed"
        )
    return Location(surface, listed, given.point.mean(axis=0), freedom, evidence, warnings)


def _spread(given: Gathered, most: int) -> Gathered:
    """At most so many contacts, far from one another by place and normal."""
    places = np.column_stack([given.point / given.extent, _TURNED * given.normal])
    return given.part(spread_out(places, most))


def _listed(
    surface: Surface,
    given: Gathered,
    poses: Poses,
    found: Equations,
    factor: float,
    *,
    follow: bool,
) -> tuple[list[Pose], float]:
    """Poses that fit, the best first, and each only once; and the evidence of all together."""
    middle, units = given.point.mean(axis=0), np.repeat([1.0, given.extent], 3)
    misfit = found.misfit
    order = np.argsort(misfit)
    order = order[misfit[order] < misfit.min() + _LIKELY * factor]
    listed, evidence = list[Pose](), list[float]()
    while len(order):
        first = slice(order[0], order[0] + 1)
        pose, least = poses.part(first), float(misfit[order[0]])
        alike = likeness(given, found.part(first))
        known = bounds(surface, given, pose, least, alike, follow=follow)
        rotation, spread = Rotation.from_matrix(pose.turn[0]), known.covariance * units
        free = known.free * units
        listed.append(Pose(rotation, pose.shift[0], spread * units[:, None], free, least))
        alone = np.linalg.slogdet(errors(given, found.curvature[first.start]))[1].sum()
        evidence.append(known.log_volume - 0.5 * (least + alone) / factor)
        size, away = apart(poses.part(order), pose, known, middle, given.extent)
        order = order[(size > _SAME) & (away > _NEAR)]
    return listed, float(logsumexp(evidence))
