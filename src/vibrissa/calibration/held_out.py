"""Whether what was fitted on one part of the data holds for the rest."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.calibration.fit import Linear, Problem, information
from vibrissa.calibration.parameters import Parameter
from vibrissa.calibration.statistics import UNDETERMINED
from vibrissa.surfaces import Surface

_STRETCHES = 8
_NODES = 33
_TOLD = 1e-6
"""Share of a variance that a part of the data has to take away to have a say."""
_LATE = 4
"""Samples by which averaging finds a contact too early (`rows`)."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """One part of the data, predicted from the rest.

    Attributes
    ----------
    part
        "recordings[i]" for one of several sweeps; of a single one "even stretches" and "odd
        stretches" of eight.
    rows
        How many rows in contact were held out.
    reduced_chi_square
        Mean square of their residuals over that of their noise and of the prediction's: 1 where
        what the rest shows holds for them.
    parameter, move
        The one that would move most if this part were left out, and by how much, in standard
        deviations of such a move.
    """

    part: str
    rows: int
    reduced_chi_square: float
    parameter: str
    move: float


def held_out(
    problem: Problem, linear: Linear, weight: Float[np.ndarray, "n"], inflation: float
) -> tuple[HeldOut, ...]:
    """Leave each recording out, or of one recording alternate stretches, and predict it from the
    others, where these determine all that is free.

    Prediction is by a Gauss–Newton step from the solution, each row's contact following by its
    derivatives; tare and drift stay those of the rest rows.
    """
    total = information(problem, linear, weight)
    parts = [
        _one(problem, linear, weight, total, inflation, name, out & (weight > 0))
        for name, out in _parts(problem)
    ]
    return tuple(part for part in parts if part is not None)


def _parts(problem: Problem) -> list[tuple[str, Bool[np.ndarray, "n"]]]:
    rows = problem.rows
    if rows.recordings > 1:
        return [
            (f"recordings[{index}]", rows.contact & (rows.recording == index))
            for index in range(rows.recordings)
        ]
    order = np.cumsum(rows.contact) * _STRETCHES // (np.count_nonzero(rows.contact) + 1)
    return [
        ("even stretches", rows.contact & (order % 2 == 0)),
        ("odd stretches", rows.contact & (order % 2 == 1)),
    ]


def _one(
    problem: Problem,
    linear: Linear,
    weight: Float[np.ndarray, "n"],
    total: Float[np.ndarray, "u u"],
    inflation: float,
    name: str,
    out: Bool[np.ndarray, "n"],
) -> HeldOut | None:
    """None where the part is empty, or the rest alone does not determine all parameters."""
    if not np.any(out):
        return None
    root = np.sqrt(weight[out])[:, None]
    design, left = (
        (root[:, :, None] * linear.jacobian[out]).reshape(-1, len(total)),
        (root * linear.residual[out]).ravel(),
    )
    return predicted_by_others(
        name,
        int(np.count_nonzero(out)),
        design,
        left,
        problem.freedom,
        total,
        problem.free,
        inflation,
    )


def predicted_by_others(
    name: str,
    rows: int,
    design: Float[np.ndarray, "k u"],
    left: Float[np.ndarray, "k"],
    freedom: int,
    total: Float[np.ndarray, "u u"],
    free: Sequence[Parameter],
    inflation: float,
) -> HeldOut | None:
    """Predict one part of the whitened residuals by a Gauss-Newton step from the solution of all;
    None where the others alone do not determine all parameters.

    Parameters
    ----------
    name, rows, freedom
        Of the part: what it is called, its rows, and how many conditions each adds.
    design, left
        Its residuals at the solution, and their derivatives, with the sign that unknowns larger by
        a step leave `left - design @ step`.
    total
        Information of all parts and priors on the unknowns, of which `free` are the first.
    inflation
        Factor by which the variance of all residuals is larger than stated.
    """
    own, slope = design.T @ design, design.T @ left
    count = len(free)
    try:
        others = np.linalg.inv(total - own)
    except np.linalg.LinAlgError:
        return None
    variances = np.diag(others)[:count] / np.array([parameter.scale for parameter in free]) ** 2
    if not np.all((variances > 0) & (variances < UNDETERMINED**2)):
        return None
    # At the solution the gradient of all is zero: that of the others is this part's, against it.
    step = -others @ slope
    predicted = left - design @ step
    expected = rows * freedom + float(np.sum(own * others))
    variance, whole = np.diag(others - np.linalg.inv(total))[:count], np.diag(others)[:count]
    # What a prior holds does not move, and the difference of both variances is rounding.
    told = variance > _TOLD * whole
    moves = np.where(
        told, np.abs(step[:count]) / np.sqrt(inflation * np.where(told, variance, 1.0)), 0.0
    )
    most = int(np.argmax(moves))
    return HeldOut(
        name, rows, float(predicted @ predicted) / expected, free[most].name, float(moves[most])
    )


def first_contacts(
    surface: Surface, problem: Problem, linear: Linear
) -> Float[np.ndarray, "recordings"]:
    """By how much the straight rod contradicts the loads: how far it stays off the object where
    they begin, or how deep it is inside just before.
    """
    rows, bench = problem.rows, linear.point.bench
    axes = rows.pose[:, 3:12].reshape(-1, 3, 3)
    missed = np.zeros(rows.recordings)
    for recording in range(rows.recordings):
        own = np.flatnonzero(rows.recording == recording)
        own = own[np.argsort(rows.seconds[own], kind="stable")]
        begin = int(np.argmax(rows.contact[own]))
        if begin == 0:
            continue
        pair = own[[begin - 1, min(begin + _LATE, len(own) - 1)]]
        along = np.linspace(0.0, 1.0, _NODES)[1:, None] * float(bench.length) * np.asarray(
            bench.axes
        )[:, 2] + np.asarray(bench.clamp)
        points = rows.pose[pair, None, :3] + np.einsum("nij,mj->nmi", axes[pair], along)
        before, after = np.min(surface.distances(points), axis=1) - float(bench.standoff)
        missed[recording] = max(0.0, after, -before)
    return missed
