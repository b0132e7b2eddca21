"""The inverse problem's entry point. It sees the rod and the reactions, nothing else."""

import math
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from scipy.special import chdtri

from vibrissa.contacts import ContactKind
from vibrissa.geometry.checks import not_negative, share
from vibrissa.inverse.channels import found_by_channels
from vibrissa.inverse.checks.check import checked
from vibrissa.inverse.kernels import (
    Errors,
    Found,
    exact_contacts,
    many_exact_contacts,
    noisy_contacts,
    weak_contacts,
)
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.ringing import without_ringing
from vibrissa.inverse.shared import pose_errors, samples_of, setting_of
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod

_STEEPEST = 0.8
"""Incidence up to which a tangent is not too steep where friction is not known: with it the incidence
is at most (1 + sin atan μ)/2, and this is μ = 0.75.
"""
_MANY = 50_000
"""Numbers from which the large calls pay (measured)."""
_MARGIN = 1e-6
"""Of the steepest incidence under friction, for rounding."""


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
        Coulomb's coefficient between rod and object: 0 for none, None where it is not known. Points
        do not depend on it. It bounds the object's normal by a cone around the force
        (`Reconstruction.normal_half_angle`), and `smooth` and `check_setup` go by it: where there
        is none, a tangential contact is square to its force. Whether a rod meets the object too
        steeply is judged for a coefficient of 0.75, or for this one where it is larger.
        `estimate_friction` finds it from the contacts of a sweep.
    false_alarm
        Share of samples without contact that may be taken for one; used where the noise is known.
    channels
        Names of the reactions to use, at least three of `fx`, `fy`, `fz`, `mx`, `my`, `mz` in
        **clamp** axes; default: all six. The rod is then taken as ideal. Three channels need the
        law of contact, so a `friction` that is not known is taken for none. Rows that the channels
        leave open are `NOT_UNIQUE` (mechanics.md, "Fewer channels").
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
    length stay exact, and `normal` is the direction of the force instead of the object's normal,
    which lies within atan μ of it. `estimate_friction` finds normals and μ from the
    contacts of a sweep.
    """
    share(false_alarm, "false_alarm")
    if friction is not None:
        friction = not_negative(friction, "friction")
    if channels is not None:
        some = found_by_channels(
            rod, reactions, channels, friction=friction, false_alarm=false_alarm
        )
        return _reconstruction(rod, reactions, friction, some)
    setting = setting_of(rod, reactions)._replace(
        steepest=_steepest(friction), threshold=float(chdtri(6, false_alarm))
    )
    samples = samples_of(rod, reactions)
    found: Any
    if reactions.covariance is None:
        many = reactions.force.size > _MANY
        found = (many_exact_contacts if many else exact_contacts)(setting, samples)
    else:
        found = noisy_contacts(setting, samples)
        weak = np.flatnonzero(found.weak & (found.kind != ContactKind.NONE))
        if weak.size:
            moments: Any = weak_contacts(setting, jax.tree.map(lambda part: part[weak], samples))
            for whole, part in zip(found.noise, moments, strict=True):
                whole[weak] = part
    result = _reconstruction(rod, reactions, friction, found)
    if not check:
        return result
    # Ringing is a matter of time: of recordings of one trail.
    if reactions.time is not None and result.kind.ndim == 1 and result.kind.size > 1:
        result = without_ringing(result)
    return result if reactions.covariance is None else checked(result)


def _steepest(friction: float | None) -> float:
    """Largest incidence that friction explains: the rod's tangent makes at most 90° with −n, the
    normal's, which leans by atan μ from the force.

    For small μ no less than without it: tangential contacts lie on the limit, and their noise on
    both sides of it.
    """
    return max(_STEEPEST, (1 + math.sin(math.atan(friction or 0.0))) / 2 + _MARGIN)


def _reconstruction(
    rod: Rod, reactions: Reactions, friction: float | None, found: Found
) -> Reconstruction:
    shape = reactions.trail.shape
    rows: Any = jax.tree.map(lambda part: part.reshape(*shape, *part.shape[1:]), found)
    given = rows._asdict()
    noise, setup, _ = (given.pop(name) for name in ("noise", "setup", "weak"))
    own: Any = Errors(None, None)
    if noise is not None:
        by_pose = pose_errors(reactions, rows.point, rows.force_direction)
        own = jax.tree.map(np.add, noise, by_pose)
    whole = own if setup is None else jax.tree.map(np.add, own, setup)
    return Reconstruction(
        rod,
        reactions,
        **given,
        covariance=whole.point,
        normal_covariance=whole.direction,
        covariance_noise=own.point,
        normal_covariance_noise=own.direction,
        friction=friction,
    )
