"""Contacts from fewer than six reactions, where they are unique (mechanics.md, "Fewer channels").

A single contact has four unknowns: m_x, m_y, F_z and s₁ in clamp axes (`smoothing.manifold`,
without tilt). The contact law gives one equation: s₁ = L at the tip, or incidence ½ in tangential
contact without friction. So three independent reactions are needed, or four where friction makes
the incidence unknown.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float
from scipy.special import chdtri

from vibrissa.contacts import ContactKind, Status
from vibrissa.inverse.arrays import Flag, Scalar, Wrench
from vibrissa.inverse.kernels import Errors, Found, Sample, Setting
from vibrissa.inverse.shared import samples_of, setting_of
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH, AT_REST, TILT, Linear, chosen, linear_at
from vibrissa.numerics.lanes import FEW, lanes
from vibrissa.numerics.linear import cholesky, solve_lower
from vibrissa.numerics.rotation import rotation_matrix
from vibrissa.numerics.vectors import joined
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod

CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")
_TIP_LAW, _TANGENTIAL_LAW, _NO_LAW = np.eye(3, 2)
"""Which of the two laws holds: s₁ = L, or incidence `_SQUARE`."""
_STEPS, _DAMPING = 40, 1e-2
"""Levenberg–Marquardt: steps, and initial damping, which falls tenfold with each successful step.
"""
_SQUARE = 0.5
"""Incidence in tangential contact without friction."""
_SINGULAR = 1e-5
"""Ratio of smallest to largest singular value below which the channels leave a direction open: a
hundred times what rounding makes of an open one.
"""
_LEAST_LOAD = 1e-12
_FITS, _SLACK = 1e-7, 1e-6
"""Without known noise: largest residual of the equations, and slack on s₁ ≤ L and incidence ≤ ½."""
_DEVIATIONS, _KNOWN_SLACK = 4.0, 2e-2
"""The same with known noise: in standard deviations, and by the size of the noise."""
_SAME = 1e-4
"""Difference of coordinates below which both laws have found the same contact."""


class Problem(NamedTuple):
    """What all samples share."""

    setting: Setting
    selected: Bool[np.ndarray, "6"]
    law: Float[np.ndarray, "2"]


class Branch(NamedTuple):
    """A solution under one law of contact."""

    x: Float[Array, "5"]
    residual: Scalar
    """Norm of what remains of the equations, in model units or in standard deviations."""
    independence: Scalar
    """Ratio of smallest to largest singular value of the Jacobian: 0 if the channels leave a
    direction open.
    """
    bad: Flag
    found: Found
    """As if unique and in contact; without χ² of the loads and errors if the noise is unknown."""


def found_by_channels(
    rod: Rod,
    reactions: Reactions,
    channels: Sequence[str],
    *,
    friction: float | None,
    false_alarm: float,
) -> Found:
    """Contacts from some of the reactions alone (`channels` of `reconstruct`).

    Both contact laws are tried; a row is unique if only one of them has a solution, with no
    direction left open.

    With friction the incidence of a tangential contact is unknown, so the channels must do without
    that law.
    """
    selected = np.isin(CHANNELS, channels)
    if isinstance(channels, str) or not 3 <= len(channels) == selected.sum():
        raise ValueError(
            f"channels = {channels!r}; allowed are at least 3 different ones of "
            f"{', '.join(CHANNELS)}, forces and moments in clamp axes"
        )
    known, rough = reactions.covariance is not None, bool(friction)
    tolerance, slack = (_DEVIATIONS, _KNOWN_SLACK) if known else (_FITS, _SLACK)
    setting, samples = setting_of(rod, reactions), samples_of(rod, reactions)
    tip, other = (
        _solved(Problem(setting, selected, law), samples)
        for law in (_TIP_LAW, _NO_LAW if rough else _TANGENTIAL_LAW)
    )
    tip_fits = (tip.residual < tolerance) & (rough | (tip.found.modulus < _SQUARE + slack))
    other_fits = (other.residual < tolerance) & (other.x[:, ARC_LENGTH] < 1 + slack)
    tip_unique = tip_fits & (tip.independence > _SINGULAR)
    other_unique = other_fits & (other.independence > _SINGULAR)
    near = np.abs(tip.x - other.x).max(axis=1) < _SAME
    both = tip_unique & other_unique & (near | known)
    use_other = other_unique & (~tip_fits | (both & (other.residual < tip.residual)))
    use_tip = tip_unique & ~use_other & (~other_fits | both)
    open_ended = rough & (other.independence <= _SINGULAR)

    load = tip.found.chi_square
    touching = load > (chdtri(selected.sum(), false_alarm) if known else _LEAST_LOAD**2)  # type: ignore[operator]
    findings = {
        Status.BAD_DATA: tip.bad,
        Status.OK: ~touching | ((use_tip | use_other) & ~open_ended),
        Status.NOT_UNIQUE: tip_fits | other_fits | open_ended,
    }
    status = np.select([*findings.values()], [*findings], Status.NO_CURVATURE_ZERO)
    good, best = touching & (status == Status.OK), chosen(use_other, other, tip)
    found: Found = chosen(good, best.found, np.nan)
    at_tip = use_tip | (best.x[:, ARC_LENGTH] > 1 - slack)
    kind = np.where(at_tip, ContactKind.TIP, ContactKind.TANGENTIAL)
    return found._replace(
        kind=np.where(good, kind, ContactKind.NONE).astype(np.int8),
        status=status.astype(np.int8),
        energy=np.where(~touching & (status == Status.OK), 0.0, found.energy),
        chi_square=load if known else None,
    )


@lanes(alone=FEW)
def _solved(problem: Problem, sample: Sample) -> Branch:
    """Levenberg–Marquardt on the selected channels and one law, without tilt."""
    setting, selected = problem.setting, jnp.asarray(problem.selected)
    turn = rotation_matrix(sample.orientation)
    wrench = joined(sample.force @ turn / setting.force, sample.moment @ turn / setting.moment)
    root = jnp.diag(selected.astype(float))
    if sample.covariance is not None:
        both = jnp.kron(jnp.eye(2), turn)
        mask = jnp.outer(selected, selected)
        inside = jnp.where(mask, both.T @ sample.covariance @ both, jnp.eye(6))
        lower = cholesky(inside)
        root = jnp.stack([solve_lower(lower, unit) for unit in root], axis=1)
    scale = jnp.max(jnp.abs(root))
    measured = jnp.where(selected, wrench, 0.0)

    def seen(wrench: Array, incidence: Array, x: Array) -> Array:
        """What channels and law observe of a rod, or of its derivatives."""
        law = problem.law @ jnp.stack([x[ARC_LENGTH], incidence])
        return jnp.concatenate([root @ wrench, jnp.stack([law, x[TILT]]) * scale])

    due = seen(measured, jnp.asarray(_SQUARE), jnp.asarray(AT_REST))

    def equations(at: Linear) -> tuple[Array, Array]:
        """Residuals and their Jacobian."""
        left = seen(*at.value[:2], at.x) - due
        return left, seen(*at.slope[:2], jnp.eye(len(at.x)))

    at = _least_squares(equations, _start(measured, selected), scale)
    x, value, slope = at
    left, jacobian = equations(at)
    # Relative to the loads, so that a light touch is no less unique than a firm one.
    load = jnp.maximum(jnp.sqrt(jnp.sum(x[:3] ** 2)), 1e-9)
    size = jnp.where(jnp.arange(len(x)) < ARC_LENGTH, load, 1.0)
    values = jnp.linalg.svd((jacobian / scale * size).at[:6].divide(load), compute_uv=False)
    errors = jnp.linalg.pinv(jacobian.T @ jacobian)
    length = setting.length
    of_errors = (turn @ part for part in (length * slope.reach, slope.direction))
    found = Found(
        jnp.zeros(()),
        jnp.zeros(()),
        sample.position + length * turn @ value.reach,
        turn @ value.direction,
        length * x[ARC_LENGTH],
        setting.moment * value.energy,
        value.incidence,
        jnp.asarray(jnp.nan),
        chi_square=jnp.sum((root @ measured) ** 2),
    )
    if sample.covariance is not None:
        found = found._replace(
            noise=Errors(*(part @ errors @ part.T for part in of_errors)),
            arc_length_deviation=length * jnp.sqrt(jnp.maximum(errors[ARC_LENGTH, ARC_LENGTH], 0)),
        )
    bad = jnp.any(selected & ~jnp.isfinite(wrench))
    return Branch(x, jnp.sqrt(jnp.sum(left**2)), values[-1] / values[0], bad, found)


def _least_squares(
    equations: Callable[[Linear], tuple[Array, Array]], start: Float[Array, "5"], scale: Scalar
) -> Linear:
    """The manifold where Levenberg–Marquardt ends; the equations should be of similar size."""

    def step(_: Array | int, state: tuple[Array, Linear, Array, Array]) -> tuple[Any, ...]:
        tried, last, damping, best = state
        new = linear_at(tried)
        error = jnp.sum(equations(new)[0] ** 2)
        better = jnp.isfinite(error) & (error <= best)
        at = jax.tree.map(lambda new, last: jnp.where(better, new, last), new, last)
        damping = jnp.clip(jnp.where(better, damping / 10, damping * 10), 1e-15, 1e6)
        left, jacobian = equations(at)
        normal = jacobian.T @ jacobian
        damped = normal + damping * jnp.diag(jnp.diag(normal) + 1e-12 * scale**2)
        change = -jnp.linalg.solve(damped, jacobian.T @ left)
        arc_length = jnp.clip((at.x + change)[ARC_LENGTH], 0.05, 1.5)
        tried = (at.x + jnp.clip(change, -0.5, 0.5)).at[ARC_LENGTH].set(arc_length)
        return tried, at, damping, jnp.where(better, error, best)

    shapes = jax.eval_shape(linear_at, start)
    nowhere = jax.tree.map(lambda part: jnp.full(part.shape, jnp.nan), shapes)
    first = (start, nowhere, jnp.asarray(_DAMPING), jnp.asarray(jnp.inf))
    found: Linear = lax.fori_loop(0, 1 + _STEPS, step, first)[1]
    return found


def _start(measured: Wrench, selected: Bool[Array, "6"]) -> Float[Array, "5"]:
    """A tip contact close to the selected channels: F_⊥ = t0 × m0 / L, and −F_z = ‖m0‖²/2."""
    fx, fy, fz, mx, my, _ = measured
    mx, my = jnp.where(selected[3], mx, -fy), jnp.where(selected[4], my, fx)
    square = mx**2 + my**2
    # A channel that is not selected must not start at a stationary point.
    size = 1e-3 * jnp.maximum(jnp.sqrt(square), 1e-4)
    axial = jnp.where(selected[2], -fz, -square / 2)
    return jnp.stack([mx + size, my + size, axial, jnp.asarray(0.95), jnp.zeros(())])
