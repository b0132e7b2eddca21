"""A primitive through contacts: its pose and its sizes, with their intervals.

The equations are those of a known object (`poses`), with the logarithms of sizes as further
unknowns. First guesses are in `guesses`; contacts count less the farther they are off (Student's t)
until outliers are known, and are left out or count fully then.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import chi2, norm

from vibrissa.contacts import Contacts
from vibrissa.shape.guesses import guesses
from vibrissa.shape.kinds import Kind, Shaped, kind_of, told_of
from vibrissa.shape.poses import Equations, Poses, crossed, equations_of, improved, likeness
from vibrissa.shape.sites import Gathered, assumptions, gathered, outside, spread_out
from vibrissa.surfaces import Surface

_MOST = 300
"""Contacts that count at most, the farthest from one another."""
_FREE, _NULL = 1.0, 1e-3
"""Information along a direction below which nothing determines it, a deviation of one: a radian,
the extent, or a factor of e; and share of such a direction in a parameter from which that is not
determined either.
"""
_WORSE = 1e-6
"""Probability of the misfit below which a word is due."""
_MANY = 0.2
"""Share of outliers above which a word is due: a few are expected where contacts begin and end."""
_CONFIDENCE = 0.95


class Parameter(NamedTuple):
    """A number of a fitted primitive."""

    value: float
    """Estimate, in the units of `PrimitiveFit.parameters`."""
    deviation: float
    """Standard deviation; infinite if the contacts do not determine it."""
    low: float
    """Lower end of the 95 % interval."""
    high: float
    """Upper end of it."""


@dataclass(frozen=True, eq=False)
class PrimitiveFit:
    """A primitive through contacts.

    Attributes
    ----------
    surface
        The fitted object, to scan or to locate again.
    parameters
        Sizes, centre and axis by name, lengths in the contacts' unit, angles in radians.
    covariance
        (p, p) of the parameters in their order; infinite variance where nothing determines one.
    misfit, freedom
        Sum of squared residuals in stated errors, without outliers, and its degrees of freedom.
    outlier
        (n,) which of the given rows are contacts that the fit contradicts, and leaves out.
    undetermined
        Names of parameters that these contacts leave open.
    warnings
        One line each if a covariance is assumed, the primitive does not fit, or too many contacts
        are outliers.
    """

    surface: Surface
    parameters: dict[str, Parameter]
    covariance: Float[np.ndarray, "p p"]
    misfit: float
    freedom: int
    outlier: Bool[np.ndarray, "given"]
    undetermined: list[str]
    warnings: list[str]

    def __repr__(self) -> str:
        """Return one line for each parameter."""
        lines = [f"{self.misfit:.3g} of {self.freedom} degrees of freedom"]
        for name, (value, deviation, *_) in self.parameters.items():
            known = f"± {deviation:.2g}" if np.isfinite(deviation) else "not determined"
            lines.append(f"  {name} = {value:.6g} {known}")
        return "\n".join(lines)


def fit_primitive(kind: type[Surface], contacts: Contacts | Sequence[Contacts]) -> PrimitiveFit:
    """Sizes and pose of a primitive from contacts with normals, without a first guess.

    Parameters
    ----------
    kind
        One of the classes `Plane`, `Sphere`, `Cylinder`, `Cone`, `Torus`, `Ellipsoid` and `Box` of
        `vibrissa.surfaces`.
    contacts
        As for `locate`.

    Returns
    -------
    PrimitiveFit
        With standard deviations and 95 % intervals; infinite where no contact tells, as of a
        cylinder's length when only its side was touched.

    Raises
    ------
    ValueError
        If the kind is none of these, none fits, or fewer contacts can be used than it has unknowns
        for (three equations each, and at least three contacts).

    Notes
    -----
    Intervals are linear: those of the equations about the fit. Errors that are alike along a sweep
    widen them, as far as residuals show it. `vibrissa.locate` tells all poses of an object whose
    sizes are known.
    """
    shape = kind_of(kind)
    whole = outside(gathered(contacts))
    rows = spread_out(np.column_stack([whole.point / whole.extent, 0.5 * whole.normal]), _MOST)
    given = whole.part(rows)
    if 3 * len(rows) < shape.known + 1:
        raise ValueError(
            f"contacts: {len(rows)} for the {shape.known} unknowns of a {kind.__name__}; allowed "
            f"are at least {shape.known // 3 + 1}"
        )
    fit, gross = _settled(shape, kind, given)
    sound = given.part(~gross)
    fit, found = _improved(shape, sound, _ordered(shape, fit), robust=False)
    fit, found = _open_ended(shape, sound, fit, found)
    share, inverse, free = _spread(found, sound)
    misfit = float(found.misfit[0])
    freedom = 3 * len(sound.point) - (len(inverse) - len(free))
    parameters, covariance = _parameters(*_numbers(shape, fit, sound), inverse, free)
    warnings = assumptions(whole)
    if freedom > 0 and chi2.sf(share * misfit, share * freedom) < _WORSE:
        warnings.append(
            f"the fit misses the contacts by {np.sqrt(misfit / freedom):.2g} times their stated "
            f"errors: the object may be no {kind.__name__}, or deformed"
        )
    if gross.mean() > _MANY:
        warnings.append(
            f"{gross.sum()} of {len(gross)} contacts contradict the {kind.__name__} through the "
            "others"
        )
    outlier = np.zeros(len(whole.point), dtype=bool)
    outlier[rows] = gross
    try:
        solid = shape.surface(fit.turn[0], fit.shift[0], fit.sizes[0])
    except ValueError as error:
        raise ValueError(f"contacts: no {kind.__name__} fits them; the best has {error}") from error
    return PrimitiveFit(
        solid,
        parameters,
        covariance,
        misfit,
        freedom,
        whole.outliers(outlier),
        [name for name, each in parameters.items() if np.isinf(each.deviation)],
        warnings,
    )


def _equations(shape: Kind, given: Gathered, fits: Shaped) -> Equations:
    """As for a known object."""
    return equations_of(told_of(shape, given, fits), given, Poses(fits.turn, fits.shift))


def _improved(
    shape: Kind, given: Gathered, start: Shaped, *, robust: bool, steps: int = 40
) -> tuple[Shaped, Equations]:
    return improved(
        partial(_equations, shape, given),
        start,
        given.middle,
        given.extent,
        steps=steps,
        robust=robust,
    )


def _settled(
    shape: Kind, kind: type[Surface], given: Gathered
) -> tuple[Shaped, Bool[np.ndarray, "n"]]:
    """The robust fit from the best of all guesses, and its outliers."""
    start = guesses(kind, given)
    score = _equations(shape, given, start).robust.misfit
    fits, found = _improved(shape, given, start.part(np.argsort(score)[:_TRIED]), robust=True)
    best = fits.part(slice(*(int(np.argmin(found.misfit)) + np.arange(2))))
    gross = _equations(shape, given, best).gross[0]
    # If most are, it is the wrong kind, and all count.
    return best, gross & (gross.mean() < 0.5)


_TRIED = 30
"""Guesses that are improved."""


def _ordered(shape: Kind, fit: Shaped) -> Shaped:
    """Three sizes from the largest to the smallest."""
    if shape.axis or len(shape.names) < 3:
        return fit
    order = np.argsort(-fit.sizes[0])
    turn = fit.turn[:, :, order]
    turn = turn * np.array([1.0, 1.0, np.linalg.det(turn[0])])
    return Shaped(turn, fit.shift, fit.sizes[:, order])


def _open_ended(
    shape: Kind, given: Gathered, fit: Shaped, found: Equations
) -> tuple[Shaped, Equations]:
    """The fit without the ends that hardly any contact speaks for: one that comes to lie at an
    outermost contact, by whose error alone it would be determined, goes far beyond all of them.
    """
    for size, moves in shape.ends:
        for way in (1.0, -1.0) if np.any(moves) else (1.0,):
            far = fit.part(slice(None))
            long = np.exp(fit.sizes[0, size]) + _FAR * given.extent
            far.shift[0] += way * (long - np.exp(fit.sizes[0, size])) * fit.turn[0] @ moves
            far.sizes[0, size] = np.log(long)
            other, told = _improved(shape, given, far, robust=False, steps=_NEARLY)
            if told.misfit[0] < found.misfit[0] + _SPOKEN:
                fit, found = other, told
    return fit, found


_FAR = 4.0
"""Growth, relative to the extent, after which an end is beyond all contacts."""
_NEARLY = 5
"""Steps to the fit without an end: more might drift along what nothing determines, to an edge."""
_SPOKEN = float(chi2.isf(1e-4, 2))
"""Rise of the misfit without an end that contacts determine: one end adds an unknown, and there are
many contacts at which it might lie.
"""


def _spread(
    found: Equations, given: Gathered
) -> tuple[float, Float[np.ndarray, "u u"], Float[np.ndarray, "k u"]]:
    """Share of the degrees of freedom that errors alike leave, covariance of the unknowns, and
    directions that nothing determines; shifts in the extent.
    """
    alike = likeness(given, found)
    values, axes = np.linalg.eigh(alike.information)
    known = values > _FREE
    inverse = (axes[:, known] / values[known]) @ axes[:, known].T
    return alike.share, inverse, axes[:, ~known].T


def _parameters(
    names: list[str],
    numbers: Float[np.ndarray, "p"],
    slope: Float[np.ndarray, "p u"],
    inverse: Float[np.ndarray, "u u"],
    free: Float[np.ndarray, "k u"],
) -> tuple[dict[str, Parameter], Float[np.ndarray, "p p"]]:
    """With intervals, and covariances."""
    covariance = slope @ inverse @ slope.T
    size = np.linalg.norm(slope, axis=1)
    unknown = np.linalg.norm(slope @ free.T, axis=1) > _NULL * size
    covariance[unknown] = covariance[:, unknown] = 0.0
    covariance[unknown, unknown] = np.inf
    deviation = np.sqrt(np.diag(covariance))
    half = norm.ppf(0.5 + _CONFIDENCE / 2) * deviation
    rows = np.stack([numbers, deviation, numbers - half, numbers + half], axis=1).tolist()
    return {name: Parameter(*row) for name, row in zip(names, rows, strict=True)}, covariance


def _numbers(
    shape: Kind, fit: Shaped, given: Gathered
) -> tuple[list[str], Float[np.ndarray, "p"], Float[np.ndarray, "p u"]]:
    """Names and values of parameters, and their slopes by the unknowns."""
    turn, shift, sizes = fit.turn[0], fit.shift[0], np.exp(fit.sizes[0])
    middle, count = given.middle, len(shape.names)
    move, spin = np.zeros((3, 6 + count)), np.zeros((3, 6 + count))
    move[:, :3] = -crossed((shift - middle)[None])[0]
    move[:, 3:6] = given.extent * np.eye(3)
    axis = turn[:, 2]
    spin[:, :3] = -crossed(axis[None])[0]
    own = np.zeros((count, 6 + count))
    own[:, 6:] = np.diag(sizes)
    center = "apex" if "half_angle" in shape.names else "center"
    names, values, slopes = list(shape.names), [sizes], [own]
    if count:
        names += [f"{center}_{letter}" for letter in "xyz"]
        values.append(shift)
        slopes.append(move)
    if shape.axis:
        names += [f"{shape.axis}_{letter}" for letter in "xyz"]
        values.append(axis)
        slopes.append(spin)
    if not count:
        names.append("offset")
        values.append(np.array([axis @ shift]))
        slopes.append((axis @ move + shift @ spin)[None])
    return names, np.concatenate(values), np.concatenate(slopes)
