"""What the data determine, how well, and whether the model explains them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from vibrissa.calibration.arrays import Columns, Information, Numbers, Square
from vibrissa.calibration.parameters import Parameter
from vibrissa.calibration.problem import WRENCH, Linear

UNDETERMINED = 0.3
"""Standard deviation, in the parameters' scales, from which a direction counts as open: 30 % of a
stiffness, 0.3 L, 0.3 rad.
"""
_ROUNDING = 1e-12
"""Information, relative to the total, that rounding leaves where there is none."""
_ALIKE = 0.05
"""Difference of loadings (at most 1) too small to tell parameters apart."""
_LAGS = 20
"""Lags of the autocorrelation, as Ljung and Box suggest for some hundred samples."""
_BLOCKS = 12
"""Blocks of a recording for means: longer than the correlation, and enough of them to average."""
_SIGNIFICANT = 1e-3
"""Probability below which residuals are taken for more than noise."""
_CONFUSED = 0.9


@dataclass(frozen=True, eq=False)
class Identifiability:
    """What the data can tell apart.

    Attributes
    ----------
    names
        (k,) names of the parameters that were determined.
    correlation
        (k, k) of their errors.
    directions, deviations
        Eigenvectors (k, k) of the information in the parameters' scales, one per row, weakest
        first, and the standard deviation (k,) along each, in those scales.
    alone
        (k,) standard deviation of each parameter if all others were known.
    held
        Parameters that the data leave open, by name, with those they cannot be told apart from;
        each is kept at its given value.
    """

    names: tuple[str, ...]
    correlation: Square
    directions: Square
    deviations: Float[np.ndarray, "k"]
    alone: Float[np.ndarray, "k"]
    held: dict[str, tuple[str, ...]]

    @property
    def confused(self) -> list[tuple[str, str, float]]:
        """Pairs of parameters whose errors are correlated by more than 0.9, strongest first: the
        data hardly tell them apart.
        """
        rows, columns = np.triu_indices(len(self.names), 1)
        pairs = [
            (self.names[i], self.names[j], float(self.correlation[i, j]))
            for i, j in zip(rows, columns, strict=True)
        ]
        return sorted(
            (pair for pair in pairs if abs(pair[2]) > _CONFUSED), key=lambda pair: -abs(pair[2])
        )

    @property
    def text(self) -> list[str]:
        """One sentence per finding."""
        lines = [
            f"{name}: not determined, kept as given; "
            + (
                f"it cannot be told apart from {', '.join(others)}, "
                "whose estimates assume this value"
                if others
                else "the readings do not depend on it"
            )
            for name, others in self.held.items()
        ]
        return lines + [
            f"{first} and {second}: hardly told apart, errors correlated by {value:+.3f}"
            for first, second, value in self.confused
        ]


@dataclass(frozen=True, eq=False)
class Fitness:
    """How well the model explains the data.

    Attributes
    ----------
    reduced_chi_square
        Mean square of the residuals in contact over that of noise alone: 1 where the model is
        right.
    whiteness
        Probability (Ljung and Box 1978) that white residuals would be as correlated in time as
        these.
    inflation
        (k,) factors by which the variances of the residuals' channels are inflated; 1 where the
        noise explains the residuals.
    outliers
        Share of the rows in contact that fit badly and were given less weight, or none.
    disturbed
        Share of them in stretches that no equilibrium explains, such as where the rod swings, or
        sticks and slips; these were left out.
    """

    reduced_chi_square: float
    whiteness: float
    inflation: Float[np.ndarray, "k"]
    outliers: float
    disturbed: float


def opened(free: list[Parameter], information: Square, limit: float) -> dict[str, tuple[str, ...]]:
    """Parameters to hold, one by one, until no direction's standard deviation, in the parameters'
    scales, exceeds a limit; each with those it cannot be told apart from.
    """
    held, scales = dict[str, tuple[str, ...]](), np.array([one.scale for one in free])
    left, names = information * np.outer(scales, scales), [one.name for one in free]
    while names:
        values, vectors = np.linalg.eigh(left)
        if values[0] > max(1 / limit**2, _ROUNDING * np.trace(left)):
            break
        loading = np.abs(vectors[:, 0])
        # Of several with similar loadings the last is held: what is listed first has priority.
        place = int(np.flatnonzero(loading > loading.max() - _ALIKE)[-1])
        name = names[place]
        held[name] = tuple(
            other
            for other, share in zip(names, loading, strict=True)
            if share > _ALIKE and other != name
        )
        left = np.delete(np.delete(left, place, 0), place, 1)
        names.remove(name)
    return held


def undetermined(linear: Linear) -> dict[str, tuple[str, ...]]:
    """The same for a fit, where the other unknowns are unknown too (Schur complement)."""
    matrix, count = linear.information(linear.sound.astype(float)), len(linear.problem.free)
    mixed = matrix[:count, count:]
    left = matrix[:count, :count] - mixed @ np.linalg.solve(matrix[count:, count:], mixed.T)
    return opened(linear.problem.free, left, UNDETERMINED)


def fitness(linear: Linear, weight: Numbers) -> Fitness:
    """Judge the residuals in contact, in time order within each recording."""
    problem, rows = linear.problem, linear.problem.rows
    left = np.sqrt(weight)[:, None] * linear.whitened
    series = [left[own[weight[own] > 0]] for own in rows.contacts]
    series = [part for part in series if len(part) > 2 * _LAGS]
    used = linear.chi_square[rows.contact & (weight == 1.0)]
    total = max(len(used) * problem.freedom - len(problem.free), 1)
    square = float(np.sum(used))
    reduced, whiteness = square / total, _ljung_box(series) if series else 1.0
    inflation = np.ones(WRENCH)
    if chi2.sf(square, total) < _SIGNIFICANT:
        inflation *= max(1.0, reduced)
    if whiteness < _SIGNIFICANT:
        inflation = np.maximum(inflation, _long_run(series))
    outliers, disturbed = (
        float(np.mean(rare[rows.contact]))
        for rare in ((weight < 1) & ~problem.disturbed, problem.disturbed)
    )
    return Fitness(reduced, whiteness, inflation, outliers, disturbed)


def _ljung_box(series: list[Float[np.ndarray, "_ 6"]]) -> float:
    statistic = 0.0
    for part in series:
        n, centred = len(part), part - part.mean(axis=0)
        power = np.sum(centred**2, axis=0)
        for lag in range(1, _LAGS + 1):
            correlation = np.sum(centred[lag:] * centred[:-lag], axis=0) / power
            statistic += float(np.sum(correlation**2) * n * (n + 2) / (n - lag))
    return float(chi2.sf(statistic, _LAGS * WRENCH * len(series)))


def _long_run(series: list[Float[np.ndarray, "_ 6"]]) -> Float[np.ndarray, "6"]:
    """Variance of means over a twelfth of a recording, times the number of samples in each: the
    noise level at the time scale of the sweep.
    """
    squares = [
        len(block) * np.mean(block, axis=0) ** 2
        for part in series
        for block in np.array_split(part, _BLOCKS)
    ]
    return np.mean(squares, axis=0)


def covariance(
    linear: Linear, weight: Numbers, inflation: Float[np.ndarray, "6"], columns: Columns
) -> Information:
    """Covariance of all unknowns: the inverse information or, where the residuals are more than
    noise, a sandwich estimate with their long-run variance; plus what held numbers add, whose
    standard deviations change the readings by `columns`.

    An error h of a held number moves the estimates by −(JᵀWJ)⁻¹ JᵀW ∂r/∂h ("consider parameters":
    S. F. Schmidt, Advances in Control Systems 3 (1966) 293-340).
    """
    matrix, contact = linear.information(weight), linear.problem.rows.contact
    inverse = np.linalg.inv(matrix)
    size = np.sqrt(weight)[:, None, None] * np.sqrt(inflation - 1)[:, None]
    excess = (size * (linear.channels @ linear.design))[contact].reshape(-1, len(inverse))
    crossed = np.tensordot(
        weight[:, None, None] * linear.jacobian, linear.weighing @ columns, axes=((0, 1), (0, 1))
    )
    shift = np.linalg.solve(matrix, crossed)
    return inverse + inverse @ (excess.T @ excess) @ inverse + shift @ shift.T
