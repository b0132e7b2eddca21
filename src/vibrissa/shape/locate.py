"""Where a known object is: its pose from a few contacts.

From a cold start (`starts`), Levenberg and Marquardt's method (`poses`) finds the minima of the
misfit; contacts count less the farther they are off (Student's t) until outliers are known, and are
left out or count fully then. Each minimum is followed as far as the contacts allow (`valleys`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp
from scipy.stats import chi2

from vibrissa.contacts import Contacts
from vibrissa.shape.poses import Equations, Poses, equations, errors, fitted, likeness, students
from vibrissa.shape.sites import Gathered, assumptions, gathered, outside, spread_out
from vibrissa.shape.starts import samples, starts, turned
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
_LEAST = 4
"""Contacts without which none is an outlier: three determine a pose, and whatever the fourth says
may be due to any of them.
"""
_MANY = 0.1
"""Share of outliers above which a word is due: of a dozen contacts, two."""


class Pose(NamedTuple):
    """Where an object is: its points x lie at `rotation` x + `translation`."""

    rotation: Rotation
    """`scipy.spatial.transform.Rotation` from the object's axes to the contacts'."""
    translation: Float[np.ndarray, "3"]
    """Of the object's origin, in the contacts' unit of length."""
    covariance: Float[np.ndarray, "6 6"]
    """Of a small rotation vector about the contacts' middle [rad] and a shift there, world axes;
    nothing along directions that are free.
    """
    free: Float[np.ndarray, "k 6"]
    """Directions of such a motion that the contacts leave open, as of a symmetric object."""
    misfit: float
    """Sum of squared residuals in stated errors, without outliers."""


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
    outlier
        (n,) which of the given rows are contacts that the best pose contradicts, and leaves out.
    log_evidence
        Logarithm of the probability of the contacts if they are of this object in any pose, up to
        what is the same for all objects: what `identify` compares.
    warnings
        One line each if even the best pose does not fit, or many contacts are outliers.
    """

    surface: Surface
    poses: list[Pose]
    middle: Float[np.ndarray, "3"]
    freedom: int
    outlier: Bool[np.ndarray, "given"]
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
        With covariances, best `vibrissa.smooth(found).contacts`; a warning says what is assumed of
        those that are not given. Errors that are alike along a sweep widen covariances, as far as
        residuals show it.

    Returns
    -------
    Location
        All poses that fit: several where the object is symmetric or the contacts leave more than
        one; directions that they leave free are named.

    Raises
    ------
    ValueError
        If the surface is something else, fewer than three contacts can be used, a covariance has a
        negative eigenvalue, nothing is found of the object about its origin, or its level is not
        finite at the contacts.
    ImportError
        If the libraries of `vibrissa[mesh]` are not installed.

    Notes
    -----
    The misfit is followed as far as it stays low: covariances hold where contacts bound a motion
    only far off, or through the ripple of a mesh, and a motion that they do not bound within 0.5
    rad or half the extent is free (mechanics.md, "Where a known object is"). Of more than 120
    contacts, the 120 farthest from one another count.
    """
    given = gathered(contacts)
    found = located(surface, given)
    return replace(found, warnings=assumptions(given) + found.warnings)


def located(surface: Surface, everything: Gathered) -> Location:
    """`locate` for contacts that were gathered; warnings say only how the object fits."""
    if not isinstance(surface, Surface):
        raise ValueError(f"surface is a {type(surface).__name__}; allowed is a surface")
    whole = outside(everything)
    rows = _spread(whole, _MOST)
    given = whole.part(rows)
    fits = _fits(surface, given)
    best = fits[0]
    sound = given.part(~best.gross)
    alike, freedom = likeness(sound, best.found), 3 * len(sound.point) - 6
    misfit, share = best.found.misfit[0], alike.share
    explained = freedom <= 0 or bool(chi2.sf(share * misfit, share * freedom) > _WORSE)
    listed, evidence = _listed(surface, given, fits, alike.factor, follow=explained)
    freedom += len(listed[0].free)
    warnings = []
    if not explained:
        warnings.append(
            f"the best pose misses the contacts by {np.sqrt(misfit / freedom):.2g} times their "
            "stated errors: it may be another object, or deformed"
        )
    if best.gross.mean() > _MANY:
        warnings.append(
            f"{best.gross.sum()} of {len(best.gross)} contacts contradict the object where the "
            "others put it"
        )
    outlier = np.zeros(len(whole.point), dtype=bool)
    outlier[rows] = best.gross
    return Location(
        surface, listed, given.middle, freedom, whole.outliers(outlier), evidence, warnings
    )


class _Fit(NamedTuple):
    """A pose through the contacts that it does not contradict."""

    pose: Poses
    found: Equations
    gross: Bool[np.ndarray, "n"]
    """Outliers, which it leaves out."""
    told: float
    """Minus twice the logarithm of the probability of all contacts, up to their errors; that of
    outliers by Student's distribution.
    """


def _fits(surface: Surface, given: Gathered) -> list[_Fit]:
    """Robust fits that are likely enough, each with its own outliers, the best first."""
    few = given.part(_spread(given, _FEW))
    sampled = samples(surface, given.extent, np.random.default_rng(0))
    poses, found = fitted(surface, few, starts(few, sampled), robust=True)
    best = poses.part(np.array([np.argmin(np.nan_to_num(found.misfit, nan=np.inf))]))
    others, told = fitted(surface, few, turned(best, sampled), robust=True)
    poses = Poses(*map(np.concatenate, zip(poses, others, strict=True)))
    misfit = np.concatenate([found.misfit, told.misfit])
    if len(few.point) < len(given.point):
        near = np.argsort(misfit)[:_KEPT]
        poses, found = fitted(surface, given, poses.part(near), robust=True)
        misfit = found.misfit
    if not np.isfinite(misfit).any():
        raise ValueError("surface: its level is not finite at the contacts")
    fits = list[_Fit]()
    for row in np.flatnonzero(misfit < np.nanmin(misfit) + 2 * _LIKELY):
        pose = poses.part(np.array([row]))
        gross = equations(surface, given, pose).gross[0]
        # If most are, it is the wrong object, and all count.
        gross &= len(gross) - gross.sum() >= max(_LEAST, len(gross) / 2)
        pose, plain = fitted(surface, given.part(~gross), pose)
        others = equations(surface, given, pose).squares[0, gross]
        fits.append(_Fit(pose, plain, gross, float(plain.misfit[0] + students(others).sum())))
    return sorted(fits, key=lambda fit: fit.told)


def _spread(given: Gathered, most: int) -> Int[np.ndarray, "rows"]:
    """At most so many contacts, far from one another by place and normal."""
    places = np.column_stack([given.point / given.extent, _TURNED * given.normal])
    return spread_out(places, most)


def _listed(
    surface: Surface, given: Gathered, fits: list[_Fit], factor: float, *, follow: bool
) -> tuple[list[Pose], float]:
    """Poses that fit, the best first, and each only once; and the evidence of all together."""
    units = np.repeat([1.0, given.extent], 3)
    left = [fit for fit in fits if fit.told < fits[0].told + _LIKELY * factor]
    listed, evidence = list[Pose](), list[float]()
    while left:
        pose, found, gross, told = left[0]
        sound, misfit = given.part(~gross), float(found.misfit[0])
        alike = likeness(sound, found)
        known = bounds(surface, sound, pose, misfit, alike, follow=follow)
        rotation, spread = Rotation.from_matrix(pose.turn[0]), known.covariance * units
        listed.append(
            Pose(rotation, pose.shift[0], spread * units[:, None], known.free * units, misfit)
        )
        every = equations(surface, given, pose).curvature[0]
        alone = np.linalg.slogdet(errors(given, every))[1].sum()
        evidence.append(known.log_volume - 0.5 * (told + alone) / factor)
        others = Poses(*map(np.concatenate, zip(*(fit.pose for fit in left), strict=True)))
        size, away = apart(others, pose, known, given.middle, given.extent)
        new = (size > _SAME) & (away > _NEAR)
        left = [fit for fit, use in zip(left, new, strict=True) if use]
    return listed, float(logsumexp(evidence))
