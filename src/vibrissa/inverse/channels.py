"""Contacts from fewer than six reactions, where they are unique (mechanics.md, "Fewer channels").

A single contact has four unknowns: m_x, m_y, F_z and s₁ in clamp axes (`smoothing.manifold`,
without tilt). One equation is the law of contact: s₁ = L at the tip, k² = ½ where the rod touches
tangentially without friction. So three independent reactions are needed, or four where friction
makes k² unknown.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float, Int
from scipy.special import chdtri

from vibrissa.contacts import ContactKind, Status
from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH, TILT, bent, linearised
from vibrissa.numerics.compiled import compiled
from vibrissa.reactions import Reactions, turned_covariance
from vibrissa.rod import Rod

CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")
_WIDTH = 512
_STEPS = 40
_TIP_LAW, _TANGENTIAL_LAW, _NO_LAW = 0, 1, 2
_SQUARE = 0.5
_SINGULAR = 1e-5
_LEAST_LOAD = 1e-12
# Without known noise: what is left of the equations, and how exactly s₁ ≤ L and k² ≤ ½ hold; with
# it, in standard deviations and by its size.
_FITS, _SLACK = 1e-7, 1e-6
_DEVIATIONS, _KNOWN_SLACK = 4.0, 2e-2
_SAME = 1e-4


class Branch(NamedTuple):
    """A solution under one law of contact, one row a sample."""

    x: Float[np.ndarray, "n 5"]
    residual: Float[np.ndarray, "n"]
    """Norm of the equations that are left, in model units, or in standard deviations."""
    independence: Float[np.ndarray, "n"]
    """Least singular value of the equations' derivative over the largest: 0 where the channels
    leave a direction open.
    """
    errors: Float[np.ndarray, "n 5 5"]


def checked_channels(channels: Sequence[str]) -> tuple[str, ...]:
    """Return the names in the order of the reactions; raise ValueError unless they are known,
    different, and at least three.
    """
    given = tuple(channels)
    unknown = [name for name in given if name not in CHANNELS]
    if isinstance(channels, str) or unknown or len(set(given)) != len(given) or len(given) < 3:
        raise ValueError(
            f"channels = {channels!r}; allowed are at least 3 different ones of {', '.join(CHANNELS)}, forces and moments in clamp axes"
        )
    return tuple(name for name in CHANNELS if name in given)


def reconstruct_from_channels(
    rod: Rod,
    reactions: Reactions,
    channels: Sequence[str],
    *,
    friction: float | None,
    false_alarm: float,
) -> Reconstruction:
    """Contacts from some of the reactions, the others unseen (`reconstruct`'s `channels`)."""
    selected = np.isin(CHANNELS, checked_channels(channels))
    turn = rotation_matrices(reactions.trail.orientation).reshape(-1, 3, 3)
    wrench, root = _clamp_wrench(rod, reactions, turn, selected)
    known = reactions.covariance is not None
    distance = np.sum(np.einsum("nij,nj->ni", root, np.where(selected, wrench, 0.0)) ** 2, axis=1)
    bad = ~np.isfinite(wrench[:, selected]).all(axis=1)
    rows = np.flatnonzero(
        ~bad & (distance > (chdtri(selected.sum(), false_alarm) if known else _LEAST_LOAD**2))
    )
    solved = _solved(wrench[rows], root[rows], selected, rough=bool(friction), known=known)
    return _filled(rod, reactions, friction, rows, bad, turn, solved, distance if known else None)


class Solved(NamedTuple):
    """Contacts of the rows that are in contact."""

    x: Float[np.ndarray, "k 5"]
    status: Int[np.ndarray, "k"]
    kind: Int[np.ndarray, "k"]
    errors: Float[np.ndarray, "k 5 5"]


def _clamp_wrench(
    rod: Rod,
    reactions: Reactions,
    turn: Float[np.ndarray, "n 3 3"],
    selected: Bool[np.ndarray, "6"],
) -> tuple[Float[np.ndarray, "n 6"], Float[np.ndarray, "n 6 6"]]:
    """In clamp axes and model units, and the square root of the precision of the selected channels
    (zero elsewhere).
    """
    units = np.repeat([rod.force_scale, rod.moment_scale], 3)
    wrench = np.concatenate(
        [
            np.einsum("nji,nj->ni", turn, part.reshape(-1, 3))
            for part in (reactions.force, reactions.moment)
        ],
        axis=1,
    )
    root = np.zeros((len(turn), 6, 6))
    if reactions.covariance is None:
        root[:, selected, selected] = 1.0
        return wrench / units, root
    both = np.zeros((len(turn), 6, 6))
    both[:, :3, :3] = both[:, 3:, 3:] = np.swapaxes(turn, 1, 2)
    given = np.broadcast_to(
        reactions.covariance / np.outer(units, units), (*reactions.trail.shape, 6, 6)
    ).reshape(-1, 6, 6)
    inside = (both @ given @ np.swapaxes(both, 1, 2))[:, selected][:, :, selected]
    root[np.ix_(np.arange(len(turn)), np.flatnonzero(selected), np.flatnonzero(selected))] = (
        np.linalg.inv(np.linalg.cholesky(inside))
    )
    return wrench / units, root


def _solved(
    wrench: Float[np.ndarray, "k 6"],
    root: Float[np.ndarray, "k 6 6"],
    selected: Bool[np.ndarray, "6"],
    *,
    rough: bool,
    known: bool,
) -> Solved:
    """Both laws of contact tried. A row is unique where one of them alone has a solution, no
    direction left open.

    With friction k² of a tangential contact is not known, and the channels have to do without a
    law.
    """
    tolerance, slack = (_DEVIATIONS, _KNOWN_SLACK) if known else (_FITS, _SLACK)
    tip = _branch(wrench, root, selected, law=_TIP_LAW)
    other = _branch(wrench, root, selected, law=_NO_LAW if rough else _TANGENTIAL_LAW)
    tip_fits = (tip.residual < tolerance) & (rough | (_modulus(tip.x) < _SQUARE + slack))
    other_fits = (other.residual < tolerance) & (other.x[:, ARC_LENGTH] < 1 + slack)
    tip_unique, other_unique = (
        tip_fits & (tip.independence > _SINGULAR),
        other_fits & (other.independence > _SINGULAR),
    )
    near = np.abs(tip.x - other.x).max(axis=1) < _SAME
    both = tip_unique & other_unique & (near | known)
    use_other = other_unique & (~tip_fits | (both & (other.residual < tip.residual)))
    use_tip = tip_unique & ~use_other & (~other_fits | both)
    open_ended = rough & (other.independence <= _SINGULAR)
    unique = (use_tip | use_other) & ~open_ended
    status = np.where(
        unique,
        Status.OK,
        np.where(tip_fits | other_fits | open_ended, Status.NOT_UNIQUE, Status.NO_CURVATURE_ZERO),
    )
    x = np.where(use_other[:, None], other.x, tip.x)
    at_tip = use_tip | (x[:, ARC_LENGTH] > 1 - slack)
    return Solved(
        x,
        status.astype(np.int8),
        np.where(at_tip, ContactKind.TIP, ContactKind.TANGENTIAL).astype(np.int8),
        np.where(use_other[:, None, None], other.errors, tip.errors),
    )


def _branch(
    wrench: Float[np.ndarray, "n 6"],
    root: Float[np.ndarray, "n 6 6"],
    selected: Bool[np.ndarray, "6"],
    *,
    law: int,
) -> Branch:
    parts = []
    for first in range(0, len(wrench), _WIDTH):
        rows = slice(first, first + _WIDTH)
        missing = _WIDTH - len(wrench[rows])
        padded = [
            np.concatenate([part[rows], np.repeat(part[rows][:1], missing, axis=0)])
            for part in (wrench, root)
        ]
        solved = _solve(
            jnp.asarray(padded[0]),
            jnp.asarray(padded[1]),
            jnp.asarray(selected.astype(float)),
            jnp.asarray(law),
        )
        parts.append([np.asarray(part)[: _WIDTH - missing] for part in solved])
    if not parts:
        return Branch(np.zeros((0, 5)), np.zeros(0), np.zeros(0), np.zeros((0, 5, 5)))
    return Branch(*(np.concatenate(field) for field in zip(*parts, strict=True)))


@compiled
def _modulus_of(x: Float[Array, "n 5"]) -> Float[Array, "n"]:
    return jax.vmap(lambda row: bent(row).incidence)(x)


def _modulus(x: Float[np.ndarray, "n 5"]) -> Float[np.ndarray, "n"]:
    filled = np.concatenate([x, np.tile([0.1, 0.1, -0.1, 1.0, 0.0], (-len(x) % _WIDTH, 1))])
    return np.concatenate(
        [np.asarray(_modulus_of(jnp.asarray(part))) for part in filled.reshape(-1, _WIDTH, 5)]
        or [np.zeros(0)]
    )[: len(x)]


@compiled
def _solve(
    wrench: Float[Array, "n 6"],
    root: Float[Array, "n 6 6"],
    selected: Float[Array, "6"],
    law: Array,
) -> tuple[Float[Array, "n 5"], Float[Array, "n"], Float[Array, "n"], Float[Array, "n 5 5"]]:
    """Levenberg-Marquardt on the selected channels and a law: 0 for s₁ = 1, 1 for k² = ½, 2 for
    none. The tilt is zero.
    """

    def one(wrench: Array, root: Array) -> tuple[Array, Array, Array, Array]:
        scale = jnp.max(jnp.abs(root))

        def equations(x: Array) -> tuple[Array, tuple[Array, Array]]:
            value = bent(x)
            seen = root @ (selected * (value.wrench - jnp.where(selected > 0, wrench, 0.0)))
            of_law = (
                jnp.stack([x[ARC_LENGTH] - 1, value.incidence - _SQUARE, jnp.zeros(())])[law]
                * scale
            )
            full = jnp.concatenate([seen, of_law[None], x[TILT, None] * scale])
            return full, (full, value.incidence)

        def step(_: Array | int, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            x, damping, best = state
            jacobian, (left, _) = jax.jacfwd(equations, has_aux=True)(x)
            normal = jacobian.T @ jacobian
            change = -jnp.linalg.solve(
                normal + damping * jnp.diag(jnp.diag(normal) + 1e-12 * scale**2), jacobian.T @ left
            )
            tried = (
                (x + jnp.clip(change, -0.5, 0.5))
                .at[ARC_LENGTH]
                .set(jnp.clip((x + change)[ARC_LENGTH], 0.05, 1.5))
            )
            error = jnp.sum(equations(tried)[0] ** 2)
            better = jnp.isfinite(error) & (error <= best)
            return (
                jnp.where(better, tried, x),
                jnp.clip(jnp.where(better, damping / 10, damping * 10), 1e-15, 1e6),
                jnp.where(better, error, best),
            )

        start = _start(wrench, selected)
        first = jnp.sum(equations(start)[0] ** 2)
        x, _, _ = lax.fori_loop(0, _STEPS, step, (start, jnp.asarray(1e-3), first))
        jacobian, (left, _) = jax.jacfwd(equations, has_aux=True)(x)
        # Relative to the loads, so that a light touch is no less unique than a strong one.
        size = (
            jnp.array([1.0, 1.0, 1.0, 1.0, 1.0])
            .at[:3]
            .set(jnp.maximum(jnp.sqrt(jnp.sum(x[:3] ** 2)), 1e-9))
        )
        relative = (jacobian / scale) * size
        relative = relative.at[:6].divide(size[0])
        values = jnp.linalg.svd(relative, compute_uv=False)
        errors = jnp.linalg.pinv(jacobian.T @ jacobian)
        return x, jnp.sqrt(jnp.sum(left**2)), values[-1] / values[0], errors

    return jax.vmap(one)(wrench, root)


def _start(wrench: Float[Array, "6"], selected: Float[Array, "6"]) -> Float[Array, "5"]:
    """A tip contact near the channels that are seen: F_⊥ = t0 × m0 / L, and −F_z = ‖m0‖²/2."""
    measured = jnp.where(selected > 0, wrench, 0.0)
    mx = jnp.where(selected[3] > 0, measured[3], -measured[1] * selected[1])
    my = jnp.where(selected[4] > 0, measured[4], measured[0] * selected[0])
    axial = jnp.where(selected[2] > 0, -measured[2], -(mx**2 + my**2) / 2)
    # A channel that is not seen must not start at a standstill.
    size = jnp.maximum(jnp.sqrt(mx**2 + my**2), 1e-4)
    return jnp.stack([mx + 1e-3 * size, my + 1e-3 * size, axial, jnp.asarray(0.95), jnp.zeros(())])


def _filled(
    rod: Rod,
    reactions: Reactions,
    friction: float | None,
    rows: Int[np.ndarray, "k"],
    bad: Bool[np.ndarray, "n"],
    turn: Float[np.ndarray, "n 3 3"],
    solved: Solved,
    chi_square: Float[np.ndarray, "n"] | None,
) -> Reconstruction:
    shape, count, length = reactions.trail.shape, len(bad), rod.length
    x, status, kind, errors = solved
    good = status == Status.OK
    fields = {
        name: np.full((count, *extra), np.nan)
        for name, extra in (
            ("point", (3,)),
            ("normal", (3,)),
            ("arc_length", ()),
            ("modulus", ()),
            ("energy", ()),
            ("covariance", (3, 3)),
        )
    } | {
        "normal_covariance": np.full((count, 3, 3), np.nan),
        "arc_length_deviation": np.full(count, np.nan),
    }
    whole_kind, whole_status = (
        np.full(count, ContactKind.NONE, dtype=np.int8),
        np.where(bad, Status.BAD_DATA, Status.OK).astype(np.int8),
    )
    whole_kind[rows], whole_status[rows] = np.where(good, kind, ContactKind.NONE), status
    fields["energy"][:] = np.where(whole_status == Status.OK, 0.0, np.nan)
    if good.any():
        picked, turned, spread = rows[good], turn[rows[good]], errors[good]
        linear = linearised(x[good])
        values = linear.value
        fields["point"][picked] = reactions.trail.position.reshape(-1, 3)[
            picked
        ] + length * np.einsum("nij,nj->ni", turned, values.reach)
        fields["normal"][picked] = np.einsum("nij,nj->ni", turned, values.direction)
        fields["arc_length"][picked], fields["modulus"][picked] = (
            length * x[good, ARC_LENGTH],
            values.incidence,
        )
        fields["energy"][picked] = rod.moment_scale * values.energy
        of_point, of_normal = turned @ linear.slope.reach, turned @ linear.slope.direction
        by_pose = reactions.pose_covariance(fields["point"].reshape(*shape, 3))
        floor = np.zeros((3, 3)) if by_pose is None else by_pose.reshape(-1, 3, 3)[picked]
        fields["covariance"][picked] = (
            length**2 * of_point @ spread @ np.swapaxes(of_point, 1, 2) + floor
        )
        fields["normal_covariance"][picked] = of_normal @ spread @ np.swapaxes(of_normal, 1, 2)
        if reactions.rotation_covariance is not None:
            fields["normal_covariance"][picked] += turned_covariance(
                reactions.rotation_covariance, fields["normal"][picked]
            )
        fields["arc_length_deviation"][picked] = length * np.sqrt(
            np.maximum(spread[:, ARC_LENGTH, ARC_LENGTH], 0)
        )
    known = reactions.covariance is not None
    given = {name: value.reshape(*shape, *value.shape[1:]) for name, value in fields.items()}
    return Reconstruction(
        rod,
        reactions,
        kind=whole_kind.reshape(shape),
        point=given["point"],
        normal=given["normal"],
        arc_length=given["arc_length"],
        energy=given["energy"],
        modulus=given["modulus"],
        covariance=given["covariance"] if known else None,
        normal_covariance=given["normal_covariance"] if known else None,
        arc_length_deviation=given["arc_length_deviation"] if known else None,
        chi_square=None if chi_square is None else chi_square.reshape(shape),
        single_contact_residual=np.full(shape, np.nan),
        status=whole_status.reshape(shape),
        friction=friction,
    )
