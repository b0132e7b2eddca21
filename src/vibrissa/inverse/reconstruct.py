"""The inverse problem's entry point. It sees the rod and the reactions, nothing else."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from scipy.special import chdtri

from vibrissa.contacts import ContactKind, Status
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
from vibrissa.inverse.shared import pose_errors, samples_of, setting_of, under_friction
from vibrissa.mechanics.free import check_loads
from vibrissa.mechanics.kirchhoff import ACCURACY, steps_for
from vibrissa.mechanics.models import model_of
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod

_MANY, _MANY_LOADED = 50_000, 12_000
"""Numbers of force components above which the larger calls pay off (measured): of rods with loads,
each row is a call of its own otherwise, fifteen times as long, but compiled in half the time.
"""


def reconstruct(
    rod: Rod,
    reactions: Reactions,
    *,
    friction: float | None = None,
    false_alarm: float = 1e-3,
    channels: Sequence[str] | None = None,
    check: bool = True,
    accuracy: float = ACCURACY,
) -> Reconstruction:
    """Contact points, normals and arc lengths from support reactions (paper, section II;
    mechanics.md).

    Parameters
    ----------
    rod
        Any rod, in the units of the reactions.
    reactions
        Support reactions and clamp poses (n, …) or (m, n, …). With a covariance, each sample is
        solved for the most probable wrench of a single contact within the rod's length, and its
        errors are propagated to point and normal.
    friction
        Coulomb friction coefficient between rod and object: 0 for none, None if unknown. Points do
        not depend on it. It confines the object's normal to a cone around the force
        (`Reconstruction.normal_half_angle`), and `smooth` and `check_setup` use it: without
        friction, a tangential contact is perpendicular to its force. Whether the rod meets the
        object too steeply is judged for a coefficient of 0.75, or for this one if it is larger.
        `estimate_friction` finds it from the contacts of a sweep.
    false_alarm
        Fraction of samples without contact that may be reported as contacts; used if the noise is
        known.
    channels
        Names of the reactions to use, at least three of `fx`, `fy`, `fz`, `mx`, `my`, `mz` in
        **clamp** axes; default: all six. The rod is then assumed ideal. Three channels need the
        contact law, so an unknown `friction` counts as none. Rows that the channels do not
        determine are `NOT_UNIQUE` (mechanics.md, "Fewer channels").
    check
        Whether to check rod, clamp and sensor against the redundancy of a recording with known
        noise and time (`check_setup`): contradictions are listed in `Reconstruction.warnings`, each
        also issued as a `RecordingWarning`, and rows that they move out of their ellipsoid are
        `SETUP_CONTRADICTED`.
    accuracy
        Error of contacts [L] that decides into how many steps a rod is divided that has no closed
        form, as in `scan`. Each row's error is estimated; if the estimate, which is tens to
        hundreds of times the error, exceeds 1e-6, the row is `NOT_CONVERGED`.

    Returns
    -------
    Reconstruction
        One row per sample; rows that cannot be solved carry a status, the others their results.

    Raises
    ------
    ValueError
        If `false_alarm` is not between 0 and 1, the coefficient is negative or not finite, or
        channels are unknown, given twice, or fewer than three, the accuracy is not positive, or a
        function of the rod's loads does not return finite numbers.

    Notes
    -----
    The contact is where the rod, known from its clamp on, first carries no moment; for a uniform
    straight rod in closed form. With friction, point and arc length stay exact, and `normal` is the
    direction of the force instead of the object's normal, which lies within atan μ of it.
    `estimate_friction` finds normals and μ from the contacts of a sweep.
    """
    share(false_alarm, "false_alarm")
    if friction is not None:
        friction = not_negative(friction, "friction")
    if channels is not None and not rod.plain:
        raise ValueError(
            f"channels = {tuple(channels)}: allowed with a rod that is not uniform, straight, "
            "unloaded and rigidly held are all six"
        )
    if channels is not None:
        some = found_by_channels(
            rod, reactions, channels, friction=friction, false_alarm=false_alarm
        )
        return _reconstruction(rod, reactions, friction, some)
    setting = under_friction(setting_of(rod, reactions), friction)._replace(
        threshold=float(chdtri(6, false_alarm)), rod=model_of(rod, steps_for(accuracy))
    )
    samples = samples_of(rod, reactions, model=setting.rod)
    found: Any
    if reactions.covariance is None:
        many = reactions.force.size > (_MANY_LOADED if setting.rod.loaded else _MANY)
        found = (many_exact_contacts if many else exact_contacts)(setting, samples)
    else:
        found = noisy_contacts(setting, samples)
        weak = np.flatnonzero(found.weak & (found.kind != ContactKind.NONE))
        if weak.size:
            rows = jax.tree.map(lambda part: part[weak], (samples, found.likely))
            moments: Any = weak_contacts(setting, *rows)
            for whole, part in zip(found.noise, moments, strict=True):
                whole[weak] = part
    result = _reconstruction(rod, reactions, friction, found)
    check_loads(rod, reactions.trail, result.status == Status.FALLS_OVER)
    if not check:
        return result
    # Ringing needs time stamps, and a single trail.
    if reactions.time is not None and result.kind.ndim == 1 and result.kind.size > 1:
        result = without_ringing(result)
    return result if reactions.covariance is None else checked(result)


def compile_for(rod: Rod, reactions: Reactions) -> None:
    """Compile whatever `reconstruct` may need for such reactions of all six channels: rows of weak
    force, which may come late in a stream, take a kernel of their own, the same for any few.
    """
    reconstruct(rod, reactions, check=False)
    if reactions.covariance is not None:
        setting, samples = setting_of(rod, reactions), samples_of(rod, reactions)
        found: Any = noisy_contacts(setting, samples)
        weak_contacts(setting, *jax.tree.map(lambda part: part[:1], (samples, found.likely)))


def _reconstruction(
    rod: Rod, reactions: Reactions, friction: float | None, found: Found
) -> Reconstruction:
    shape = reactions.trail.shape
    rows: Any = jax.tree.map(lambda part: part.reshape(*shape, *part.shape[1:]), found)
    given = rows._asdict()
    noise, setup, *_ = (given.pop(name) for name in ("noise", "setup", "weak", "likely"))
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
