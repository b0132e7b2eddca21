"""Whether what was fitted on one part of the data holds for the rest."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from vibrissa.calibration.arrays import Numbers
from vibrissa.calibration.equilibrium import free_readings
from vibrissa.calibration.parameters import Parameter
from vibrissa.calibration.problem import Linear
from vibrissa.calibration.statistics import UNDETERMINED
from vibrissa.surfaces import Surface

_STRETCHES = 8
"""Stretches of a single recording: short enough that every other one samples the whole sweep."""
_NODES = 33
"""Points on the rod: 1.5 mm apart on 50 mm, between which objects are nearly flat."""
_TOLD = 1e-6
"""Share of a variance that a part of the data must remove to count."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """One part of the data, predicted from the rest.

    Attributes
    ----------
    part
        "recordings[i]" for one of several sweeps; for a single one, "even stretches" or "odd
        stretches" of eight.
    rows
        How many rows in contact were held out.
    reduced_chi_square
        Mean square of their residuals over that expected from their noise and the prediction's: 1
        where what the rest shows holds for them.
    parameter, move
        The parameter that would move most if this part were left out, and by how much, in standard
        deviations of such a move.
    """

    part: str
    rows: int
    reduced_chi_square: float
    parameter: str
    move: float


def held_out(linear: Linear, weight: Numbers, inflation: float) -> tuple[HeldOut, ...]:
    """Leave out each recording, or alternate stretches of a single one, and predict it from the
    others, where these determine all that is free.

    The prediction is a Gauss–Newton step from the solution, in which each row's contact follows by
    its derivatives; tare and drift stay those of the rows at rest.
    """
    problem, contacts = linear.problem, linear.problem.rows.contacts
    named = {f"recordings[{index}]": own for index, own in enumerate(contacts)}
    if len(contacts) == 1:
        (own,) = contacts
        odd = np.arange(1, len(own) + 1) * _STRETCHES // (len(own) + 1) % 2 == 1
        named = {"even stretches": own[~odd], "odd stretches": own[odd]}
    total, parts = linear.information(weight), []
    for name, own in named.items():
        out = own[weight[own] > 0]
        root = np.sqrt(weight[out, None])
        design = (root[..., None] * linear.jacobian[out]).reshape(-1, len(total))
        left = (root * linear.residual[out]).ravel()
        parts.append(Part(name, len(out), len(out) * problem.freedom, design, left))
    return predicted_by_others(parts, total, problem.free, inflation)


class Part(NamedTuple):
    """A part's whitened residuals at the solution for all data, k of them."""

    name: str
    rows: int
    conditions: int
    """How many conditions they add."""
    design: Float[np.ndarray, "k u"]
    """Derivatives, signed so that a step of the unknowns leaves `left - design @ step`."""
    left: Float[np.ndarray, "k"]


def predicted_by_others(
    parts: list[Part],
    total: Float[np.ndarray, "u u"],
    free: Sequence[Parameter],
    inflation: float,
) -> tuple[HeldOut, ...]:
    """Predict each part by a Gauss–Newton step from the solution for all, where the others
    determine all parameters.

    Parameters
    ----------
    parts
        What to leave out in turn.
    total
        Information on the unknowns from all parts and priors; the first unknowns are `free`.
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
        expected = part.conditions + float(np.sum(own * others))
        # What a prior holds does not move: the difference of the two variances is rounding.
        variance = np.diag(others - whole)[:count]
        told = variance > _TOLD * own_variances
        deviations = np.sqrt(inflation * np.where(told, variance, np.inf))
        moves = np.abs(step[:count]) / deviations
        most = int(np.argmax(moves))
        square = float(predicted @ predicted) / expected
        found.append(HeldOut(part.name, part.rows, square, free[most].name, float(moves[most])))
    return tuple(found)


def first_contacts(surface: Surface, linear: Linear) -> Float[np.ndarray, "recordings"]:
    """By how much the free rod contradicts the loads: how far it is from the object where they
    begin, or how deep inside just before.
    """
    rows, bench = linear.problem.rows, linear.bench
    share = np.linspace(0.0, 1.0, _NODES)[1:]
    along = share[:, None] * bench.length * bench.axes[:, 2]
    missed = np.zeros(rows.recordings)
    for recording, own in enumerate(rows.contacts):
        before = np.flatnonzero(
            (rows.recording == recording) & (rows.seconds < rows.seconds[own[0]])
        )
        if before.size:
            pair = [before[-1], own[0]]
            turned = np.einsum("nij,mj->nmi", rows.pose.axes[pair], along + bench.clamp)
            points = rows.pose.position[pair, None] + turned
            if bench.form is not None:
                pose = jax.tree.map(lambda part: part[pair], rows.pose)  # noqa: B023
                points = free_readings((bench, share), pose).line
            free, touching = np.min(surface.distances(points), axis=1) - bench.standoff
            missed[recording] = max(0.0, touching, -free)
    return missed
