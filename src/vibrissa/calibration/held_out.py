"""Whether what was fitted on one part of the data holds for the rest."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrissa.calibration.arrays import Chosen, Numbers
from vibrissa.calibration.parameters import Parameter
from vibrissa.calibration.problem import Linear, Problem, information
from vibrissa.calibration.statistics import UNDETERMINED
from vibrissa.surfaces import Surface

_STRETCHES = 8
"""Of a single recording: short enough that every other one sees the whole sweep."""
_NODES = 33
"""Of the rod: 1.5 mm apart on 50 mm, between which objects are nearly flat."""
_TOLD = 1e-6
"""Share of a variance that a part of the data has to take away to have a say."""


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
    problem: Problem, linear: Linear, weight: Numbers, inflation: float
) -> tuple[HeldOut, ...]:
    """Leave each recording out, or of one recording alternate stretches, and predict it from the
    others, where these determine all that is free.

    Prediction is by a Gauss–Newton step from the solution, each row's contact following by its
    derivatives; tare and drift stay those of the rest rows.
    """
    total, root = information(problem, linear, weight), np.sqrt(weight)
    parts = []
    for name, own in _parts(problem):
        out = own & (weight > 0)
        design = (root[out, None, None] * linear.jacobian[out]).reshape(-1, len(total))
        left = (root[out, None] * linear.residual[out]).ravel()
        parts.append(Part(name, int(np.count_nonzero(out)), problem.freedom, design, left))
    return predicted_by_others(parts, total, problem.free, inflation)


def _parts(problem: Problem) -> list[tuple[str, Chosen]]:
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


class Part(NamedTuple):
    """Whitened residuals at the solution of all data, k of them."""

    name: str
    rows: int
    freedom: int
    """Conditions that each row adds."""
    design: Float[np.ndarray, "k u"]
    """Derivatives, with the sign that unknowns larger by a step leave `left - design @ step`."""
    left: Float[np.ndarray, "k"]


def predicted_by_others(
    parts: list[Part],
    total: Float[np.ndarray, "u u"],
    free: Sequence[Parameter],
    inflation: float,
) -> tuple[HeldOut, ...]:
    """Each part predicted by a Gauss-Newton step from the solution of all, where the others
    determine all parameters.

    Parameters
    ----------
    parts
        What is left out in turn.
    total
        Information of all parts and priors on the unknowns, of which `free` are the first.
    free, inflation
        The parameters, and the factor by which the variance of all residuals is larger than stated.
    """
    scales, count, found = np.array([one.scale for one in free]), len(free), []
    whole = np.linalg.inv(total)
    for part in parts:
        own = part.design.T @ part.design
        try:
            others = np.linalg.inv(total - own)
        except np.linalg.LinAlgError:
            continue
        own_variances = np.diag(others)[:count]
        determined = (own_variances > 0) & (own_variances < (UNDETERMINED * scales) ** 2)
        if not part.rows or not determined.all():
            continue
        # At the solution the gradient of all is zero: that of the others opposes this part's.
        step = -others @ part.design.T @ part.left
        predicted = part.left - part.design @ step
        expected = part.rows * part.freedom + float(np.sum(own * others))
        # What a prior holds does not move, and the difference of both variances is rounding.
        variance = np.diag(others - whole)[:count]
        told = variance > _TOLD * own_variances
        deviations = np.sqrt(inflation * np.where(told, variance, np.inf))
        moves = np.abs(step[:count]) / deviations
        most = int(np.argmax(moves))
        square = float(predicted @ predicted) / expected
        found.append(HeldOut(part.name, part.rows, square, free[most].name, float(moves[most])))
    return tuple(found)


def first_contacts(
    surface: Surface, problem: Problem, linear: Linear
) -> Float[np.ndarray, "recordings"]:
    """By how much the straight rod contradicts the loads: how far it stays off the object where
    they begin, or how deep it is inside just before.
    """
    rows, bench = problem.rows, linear.bench
    missed = np.zeros(rows.recordings)
    for recording in range(rows.recordings):
        own = np.flatnonzero(rows.recording == recording)
        own = own[np.argsort(rows.seconds[own], kind="stable")]
        begin = int(np.argmax(rows.contact[own]))
        if begin == 0:
            continue
        pair = own[[begin - 1, begin]]
        along = np.linspace(0.0, 1.0, _NODES)[1:, None] * bench.length * bench.axes[:, 2]
        turned = np.einsum("nij,mj->nmi", rows.pose.axes[pair], along + bench.clamp)
        points = rows.pose.position[pair, None] + turned
        before, after = np.min(surface.distances(points), axis=1) - bench.standoff
        missed[recording] = max(0.0, after, -before)
    return missed
