"""How well each cause of error explains what the constraints leave: generalised least squares, one
cause at a time.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular

from vibrissa.inverse.checks.constraints import COUPLE, TANGENT, TIP, TORSION, Constraints, Slopes
from vibrissa.inverse.checks.stretches import Stretches

MODEL_ERROR = 2e-4
"""What statics of an ideal rod leaves out, in rod lengths: 10 µm on 50 mm, as smoothing states."""
_TANGENT_ERROR = 1e-3
"""The same of t·n: what a grid of 32 links leaves of a right angle, and a rod's tip of 10 µm."""
_CORRELATED = 1 / 6
"""Share of a contact over which the model's error stays alike."""
_FRICTION_UNEVEN = 0.2
"""Share of the coefficient of friction by which it changes on the way."""


class Misfit(NamedTuple):
    """Constraints that apply, three a stretch, whitened."""

    value: Float[np.ndarray, "rows"]
    root: Float[np.ndarray, "rows rows"]
    """Cholesky factor of the covariance."""
    pick: Float[np.ndarray, "k 3"]
    told: Bool[np.ndarray, "rows"]
    """Rows that say something."""
    alone: Float[np.ndarray, "k 3"]
    """Each constraint in its own standard deviations."""

    def whitened(self, slope: Float[np.ndarray, "k 4 p"]) -> Float[np.ndarray, "rows p"]:
        """Derivatives of the constraints in the same rows."""
        picked = np.take_along_axis(slope, self.pick[:, :, None], axis=1)
        rows = picked.reshape(picked.shape[0] * picked.shape[1], slope.shape[2])
        rows = np.where(self.told[:, None], rows, 0.0)
        return np.asarray(solve_triangular(self.root, rows, lower=True))


class Fitted(NamedTuple):
    """One cause."""

    size: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]
    explained: float
    """By how much it lessens χ²."""


def misfit_of(
    stretches: Stretches,
    here: Constraints,
    tip: Bool[np.ndarray, "k"],
    friction: float,
    tolerated: Float[np.ndarray, "k 4 p"],
    inflation: float,
    silent: Bool[np.ndarray, "k"],
) -> Misfit:
    """Of stretches in these phases, under noise, errors of the zero and of the model, friction's
    unevenness, and errors that are tolerated (columns).

    Silent stretches, and those next to a change of phase, tell nothing of s₁ and t·n̂.
    """
    count = len(tip)
    pick = np.stack(
        [np.full(count, COUPLE), np.full(count, TORSION), np.where(tip, TIP, TANGENT)], axis=1
    )
    slope = np.take_along_axis(here.by_wrench.constraints, pick[:, :, None], axis=1)
    force = np.linalg.norm(here.force, axis=1)
    floor = np.stack(
        [
            MODEL_ERROR * force,
            MODEL_ERROR * force,
            np.where(
                tip,
                MODEL_ERROR * here.steepness,
                np.hypot(_TANGENT_ERROR, _FRICTION_UNEVEN * friction),
            ),
        ]
    )
    told = np.ones((count, 3), dtype=bool)
    told[silent, 2] = False
    # A stretch next to a change of phase may hold some of both.
    change = tip[1:] != tip[:-1]
    told[:-1, 2] &= ~change
    told[1:, 2] &= ~change
    slope = np.where(told[:, :, None], slope, 0.0)
    elapsed = np.abs(stretches.time[:, None] - stretches.time)
    alike = np.exp(-elapsed / (_CORRELATED * np.ptp(stretches.time)))
    covariance = np.zeros((count, 3, count, 3))
    own = np.arange(count)
    covariance[own, :, own, :] = inflation * slope @ stretches.noise @ np.swapaxes(slope, 1, 2)
    for row in range(3):
        same = pick[:, row][:, None] == pick[:, row]
        covariance[:, row, :, row] += np.outer(floor[row], floor[row]) * alike * same
    whole = covariance.reshape(3 * count, 3 * count)
    for columns in (
        slope @ stretches.zero,
        np.take_along_axis(tolerated, pick[:, :, None], axis=1),
    ):
        flat = np.where(told[:, :, None], columns, 0.0).reshape(3 * count, -1)
        whole = whole + flat @ flat.T
    root = np.linalg.cholesky(whole)
    value = np.where(told, np.take_along_axis(here.value, pick, axis=1), 0.0).ravel()
    alone = value / np.sqrt(np.diag(whole))
    return Misfit(
        solve_triangular(root, value, lower=True), root, pick, told.ravel(), alone.reshape(count, 3)
    )


def fitted(
    misfit: Misfit, design: Float[np.ndarray, "rows p"], spread: Float[np.ndarray, "p"]
) -> Fitted:
    """A cause whose numbers have these standard deviations before the data; design as from
    `Misfit.whitened`.
    """
    information = design.T @ design + np.diag(spread**-2.0)
    right = design.T @ misfit.value
    covariance = np.linalg.inv(information)
    return Fitted(-covariance @ right, covariance, float(right @ covariance @ right))


def without(
    misfit: Misfit, design: Float[np.ndarray, "rows p"], size: Float[np.ndarray, "p"]
) -> Misfit:
    """With a cause taken off."""
    return misfit._replace(value=misfit.value + design @ size)


def shifts(
    slopes: Slopes, noise: Float[np.ndarray, "k 6 6"], here: Constraints, tip: Bool[np.ndarray, "k"]
) -> Float[np.ndarray, "k 3 p"]:
    """Derivatives of contacts that are taken to a single contact, and in tip contact to the rod's
    length, by the least change of the wrench.
    """
    rows = [COUPLE, TIP]
    given, back = here.by_wrench.constraints[:, rows], slopes.constraints[:, rows]
    spread = noise @ np.swapaxes(given, 1, 2)
    square = given @ spread
    # Where the flank touches, the second row says nothing.
    square[~tip, 1, 1] += 1e6 * square[~tip, 1, 1]
    return np.asarray(slopes.point - here.by_wrench.point @ spread @ np.linalg.solve(square, back))
