"""The inverse problem's entry point. It sees the rod and the reactions, nothing else."""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache, partial

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from scipy.special import chdtri

from vibrissa.contacts import ContactKind, Status
from vibrissa.geometry.checks import not_negative
from vibrissa.inverse.channels import reconstruct_from_channels
from vibrissa.inverse.checks.check import checked
from vibrissa.inverse.kernels import (
    NOISY_WIDTH,
    TIP_DEVIATIONS,
    WIDTH,
    invert_blocks,
    invert_noisy_blocks,
    invert_shared_blocks,
)
from vibrissa.inverse.parameters import covariance_of, rig_of, velocities_of
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.ringing import without_ringing
from vibrissa.inverse.shared import noisy_rows
from vibrissa.numerics.blocks import in_blocks, single
from vibrissa.reactions import Reactions, turned_covariance
from vibrissa.rod import Rod

# Without known noise: how exactly reactions must fit one contact, and reach the tip.
_SINGLE_CONTACT = 1e-3
_TIP = 1e-6
_LEAST_FORCE = 1e-14
# Without friction k² ≤ ½, with it k² ≤ (1 + sin atan μ)/2: this is μ = 0.75.
_STEEPEST = 0.8
_MODULUS_MARGIN = 1e-6
# With known noise, in standard deviations.
_SINGLE_CONTACT_DEVIATIONS = 6.0
_STEEP_DEVIATIONS = 3.0
_KIND_DEVIATIONS = 2.0
# As plain numbers: looking up a member of an enumeration costs as much as the arithmetic of a
# sample.
_NONE, _TIP_KIND, _TANGENTIAL = (int(kind) for kind in ContactKind)
_NOT_SINGLE_CONTACT, _BEYOND_TIP, _NO_CURVATURE_ZERO = (
    int(Status.NOT_SINGLE_CONTACT),
    int(Status.BEYOND_TIP),
    int(Status.NO_CURVATURE_ZERO),
)
_NOISE_WIDTH = NOISY_WIDTH - WIDTH
_STEEP_TANGENT, _BAD_DATA = int(Status.STEEP_TANGENT), int(Status.BAD_DATA)


def reconstruct(
    rod: Rod,
    reactions: Reactions,
    *,
    friction: float | None = None,
    false_alarm: float = 1e-3,
    channels: Sequence[str] | None = None,
    check: bool = True,
) -> Reconstruction:
    """Contact points, normals and arc lengths from support reactions (paper, section II;
    mechanics.md).

    Parameters
    ----------
    rod
        Uniform straight rod, in the units of the reactions.
    reactions
        Support reactions and clamp poses (n, …) or (m, n, …). With a covariance, the most probable
        wrench of a single contact within the rod's length is taken for each sample, and its errors
        are carried to point and normal.
    friction
        Coulomb's coefficient, if known: it bounds the object's normal by a cone around the force
        (`Reconstruction.normal_half_angle`). Whether a rod meets the object too steeply is judged
        for a coefficient of 0.75, or for this one where it is larger. `estimate_friction` finds it
        from the contacts of a sweep.
    false_alarm
        Share of samples without contact that may be taken for one; used where the noise is known.
    channels
        Names of the reactions to use, at least three of `fx`, `fy`, `fz`, `mx`, `my`, `mz` in
        **clamp** axes; default: all six. The rod is then taken as ideal, and without `friction`
        greater than 0 the contact as frictionless. Rows that the channels leave open are
        `NOT_UNIQUE` (mechanics.md, "Fewer channels").
    check
        Whether to judge rod, clamp and sensor by what over-determines the contacts of a recording
        with known noise and time (`check_setup`): what contradicts them is in
        `Reconstruction.warnings`, each also a `RecordingWarning`, and rows that it moves out of
        their ellipsoid are `SETUP_CONTRADICTED`.

    Returns
    -------
    Reconstruction
        One row a sample; rows that cannot be solved carry a status, the others their results.

    Raises
    ------
    ValueError
        If `false_alarm` is not between 0 and 1, the coefficient is negative or not finite, or
        channels are unknown, given twice, or fewer than three.

    Notes
    -----
    The contact is the first zero of the curvature, in closed form. With friction, point and arc
    length stay exact, and only `normal` is the direction of the force instead of the object's
    normal, which lies within atan μ of it. `estimate_friction` finds normals and μ from the
    contacts of a sweep.
    """
    if not 0 < false_alarm < 1:
        raise ValueError(f"false_alarm = {false_alarm!r}; allowed is a number between 0 and 1")
    if friction is not None:
        friction = not_negative(friction, "friction")
    if channels is not None:
        return reconstruct_from_channels(
            rod, reactions, channels, friction=friction, false_alarm=false_alarm
        )
    trail, scales = reactions.trail, np.array([rod.force_scale, rod.moment_scale])
    orientation = trail.orientation.reshape(-1, 4)
    force, moment = reactions.force.reshape(-1, 3), reactions.moment.reshape(-1, 3)
    if reactions.covariance is None:
        rows = (force, moment, orientation)
        kernel = partial(invert_blocks, scales)
        fields = single(kernel, *rows) if len(force) == 1 else in_blocks(kernel, *rows)
        exact = _exact(rod, reactions, friction, fields)
        return _swinging_aside(exact) if check else exact
    known = noisy_rows(rod, reactions)
    chi_square = np.einsum("ni,nij,nj->n", known[0], known[3], known[0])
    noisy: Callable[..., Array] = invert_noisy_blocks
    if reactions.setup_errors is not None:
        noisy = partial(
            invert_shared_blocks, rig_of(rod, reactions), jnp.asarray(covariance_of(rod, reactions))
        )
        known = (*known, velocities_of(rod, reactions).reshape(-1, 6))
    fields = single(noisy, *known) if len(force) == 1 else in_blocks(noisy, *known)
    found = _noisy(rod, reactions, friction, fields, chi_square, _threshold(false_alarm))
    return checked(_swinging_aside(found)) if check else found


def _swinging_aside(found: Reconstruction) -> Reconstruction:
    """Ringing is a matter of time: of recordings of one trail."""
    return (
        without_ringing(found)
        if found.reactions.time is not None and found.kind.ndim == 1 and found.kind.size > 1
        else found
    )


@lru_cache(maxsize=32)
def _threshold(false_alarm: float) -> float:
    return float(chdtri(6, false_alarm))


def _steepest(friction: float | None) -> float:
    """Largest k² that friction explains: the rod's tangent makes at most 90° with −n, the normal's,
    which leans by atan μ from the force.

    For small μ no less than without it: tangential contacts lie on the limit, and their noise on
    both sides of it.
    """
    return (
        _STEEPEST
        if friction is None
        else max(_STEEPEST, (1 + friction / math.hypot(1, friction)) / 2 + _MODULUS_MARGIN)
    )


def _exact(
    rod: Rod, reactions: Reactions, friction: float | None, fields: Float[np.ndarray, "k 11"]
) -> Reconstruction:
    arc_length, modulus, magnitude, single = fields[:, 6], fields[:, 7], fields[:, 9], fields[:, 10]
    status = np.zeros(len(fields), dtype=np.int8)
    status[np.abs(single) > _SINGLE_CONTACT] = _NOT_SINGLE_CONTACT
    status[arc_length > 1 + _TIP] = _BEYOND_TIP
    status[modulus > _steepest(friction)] = _STEEP_TANGENT
    status[modulus >= 1] = _NO_CURVATURE_ZERO
    return _result(
        rod,
        reactions,
        friction,
        fields,
        magnitude > _LEAST_FORCE,
        arc_length > 1 - _TIP,
        status,
        single,
    )


def _noisy(
    rod: Rod,
    reactions: Reactions,
    friction: float | None,
    fields: Float[np.ndarray, "k width"],
    chi_square: Float[np.ndarray, "k"],
    threshold: float,
) -> Reconstruction:
    deviation, steep_deviation, single = (fields[:, NOISY_WIDTH - back] for back in (3, 2, 1))
    arc_length = fields[:, 6]
    status = np.zeros(len(fields), dtype=np.int8)
    status[np.abs(single) > _SINGLE_CONTACT_DEVIATIONS] = _NOT_SINGLE_CONTACT
    status[arc_length > 1 + _TIP + TIP_DEVIATIONS * deviation] = _BEYOND_TIP
    status[fields[:, 7] - _STEEP_DEVIATIONS * steep_deviation > _steepest(friction)] = (
        _STEEP_TANGENT
    )
    status[fields[:, 7] >= 1] = _NO_CURVATURE_ZERO
    tip = arc_length > 1 - _TIP - _KIND_DEVIATIONS * deviation
    return _result(
        rod,
        reactions,
        friction,
        fields,
        chi_square > threshold,
        tip,
        status,
        single,
        fields[:, WIDTH:],
        chi_square,
    )


def _result(
    rod: Rod,
    reactions: Reactions,
    friction: float | None,
    fields: Float[np.ndarray, "k width"],
    contact: np.ndarray,
    tip: np.ndarray,
    status: np.ndarray,
    single: Float[np.ndarray, "k"],
    errors: Float[np.ndarray, "k more"] | None = None,
    chi_square: Float[np.ndarray, "k"] | None = None,
) -> Reconstruction:
    shape, length = reactions.trail.shape, rod.length
    # The residual of the single-contact condition holds every number of the row; without a force it
    # is not a number either.
    bad = np.isnan(fields[:, 10])
    if bad.any():
        bad &= ~(
            np.isfinite(reactions.force).all(axis=-1) & np.isfinite(reactions.moment).all(axis=-1)
        ).reshape(-1)
    unsolved = contact & ~np.isfinite(fields[:, 6])
    none = ~contact | bad | unsolved
    values, energy = fields[:, :WIDTH], fields[:, 8] * rod.moment_scale
    if none.any():
        couple = (
            ~np.any(reactions.force, axis=-1).reshape(-1)
            & np.any(reactions.moment, axis=-1).reshape(-1)
            & (contact | (errors is None))
        )
        status[none], status[unsolved] = 0, _NO_CURVATURE_ZERO
        status[couple], status[bad] = _NOT_SINGLE_CONTACT, _BAD_DATA
        bad |= unsolved | couple
        values = np.where(none[:, None], np.nan, values)
        energy = np.where(none, np.where(bad, np.nan, 0.0), energy)
    kind = np.where(none, _NONE, np.where(tip, _TIP_KIND, _TANGENTIAL)).astype(np.int8)
    point = reactions.trail.position + (values[:, :3] * length).reshape(*shape, 3)
    normal = values[:, 3:6].reshape(*shape, 3)
    covariance = normal_covariance = noise = normal_noise = deviation = None
    if errors is not None:
        errors = np.where(none[:, None], np.nan, errors) if none.any() else errors
        covariance = (errors[:, :9] * length**2).reshape(*shape, 3, 3)
        normal_covariance = errors[:, 9:18].reshape(*shape, 3, 3)
        if reactions.rotation_covariance is not None:
            normal_covariance = normal_covariance + turned_covariance(
                reactions.rotation_covariance, normal
            )
        by_pose = reactions.pose_covariance(point)
        covariance = covariance if by_pose is None else covariance + by_pose
        deviation = (errors[:, 18] * length).reshape(shape)
        noise, normal_noise = covariance, normal_covariance
        if errors.shape[1] > _NOISE_WIDTH:
            covariance = noise + (errors[:, _NOISE_WIDTH : _NOISE_WIDTH + 9] * length**2).reshape(
                *shape, 3, 3
            )
            normal_covariance = normal_noise + errors[:, _NOISE_WIDTH + 9 :].reshape(*shape, 3, 3)
    return Reconstruction(
        rod,
        reactions,
        kind=kind.reshape(shape),
        point=point,
        normal=normal,
        arc_length=(values[:, 6] * length).reshape(shape),
        energy=energy.reshape(shape),
        modulus=values[:, 7].reshape(shape),
        covariance=covariance,
        normal_covariance=normal_covariance,
        covariance_noise=noise,
        normal_covariance_noise=normal_noise,
        arc_length_deviation=deviation,
        chi_square=None if chi_square is None else chi_square.reshape(shape),
        single_contact_residual=single.reshape(shape),
        friction=friction,
        status=status.reshape(shape),
    )
