"""Whether a sweep's contacts agree with the setup: the entry points."""

import warnings
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from vibrissa.contacts import RecordingWarning, Status
from vibrissa.inverse.checks.findings import SetupCheck
from vibrissa.inverse.checks.judgement import judged
from vibrissa.inverse.checks.passes import carried, contradicting_delay
from vibrissa.inverse.checks.wording import delay_told
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.work import work_warnings

_OUTSIDE = 0.05
"""Probability of lying outside the ellipsoids."""


def check_setup(found: Reconstruction) -> SetupCheck:
    """What the contacts of a recording say about rod, clamp and sensor, with the object unknown.

    Parameters
    ----------
    found
        Contacts of one sweep (n, …) or several (m, n, …), sample by sample or smoothed; the check
        uses the reactions, not the smoothed contacts.

    Returns
    -------
    SetupCheck
        Empty if noise or time are unknown or too little of the sweep is in contact; with a `note`
        alone for a rod with loads or a very thin tip.

    Notes
    -----
    Each contact obeys more conditions than it has unknowns (`vibrissa.inverse.checks.constraints`).
    One cause at a time is fitted to their residuals, by generalised least squares under the noise,
    the zero error, a model error of 2e-4 L and the tolerated setup errors (mechanics.md,
    "What the data say about the setup").
    """
    if found.kind.ndim == 1:
        return judged(found)
    parts = [judged(trail) for trail in found.trails]
    worst = max(parts, key=lambda part: part.causes[0].significance if part.causes else 0.0)
    return replace(
        worst,
        warnings=tuple(
            f"trail {j}: {line}" for j, part in enumerate(parts) for line in part.warnings
        ),
        shift=np.stack([part.shift for part in parts]),
        apart=np.stack([part.apart for part in parts]),
    )


def checked(found: Reconstruction) -> Reconstruction:
    """The same contacts with what contradicts the setup: `setup_check`, `warnings` (each also a
    `RecordingWarning`), and statuses as from `with_contradictions`.
    """
    said, (lines, misread, gross) = check_setup(found), work_warnings(found)
    if gross or found.reactions.misread:
        # Sizes of small errors that would explain a gross one are wrong: what is gross is named.
        said = replace(said, named=(), warnings=())
    misread = misread or said.misread or bool(found.reactions.misread)
    told = _told(found, replace(said, misread=misread), *said.warnings, *lines)
    return with_contradictions(with_delay(told))


def with_delay(found: Reconstruction) -> Reconstruction:
    """The contacts of one trail, with a pose delay added to the causes if back-and-forth passes
    show one that is not named yet.
    """
    said = found.setup_check
    if said is None or said.misread or any("pose_delay" in names for names in said.named):
        return found
    delay = contradicting_delay(found)
    if delay is None:
        return found
    line = delay_told(found.rod, delay)
    own = np.nan_to_num(delay.estimate[0] * carried(found))
    sizes = (np.linalg.norm(shift, axis=1, keepdims=True) for shift in (own, said.shift))
    said = replace(
        said,
        causes=(delay, *said.causes),
        named=(*said.named, (delay.name,)),
        warnings=(*said.warnings, line),
        shift=np.where(np.greater(*sizes), own, said.shift),
    )
    return _told(found, said, line)


def _told(found: Reconstruction, said: SetupCheck, *lines: str) -> Reconstruction:
    for line in lines:
        warnings.warn(line, RecordingWarning, stacklevel=4)
    return replace(found, setup_check=said, warnings=[*found.warnings, *lines])


def with_contradictions(found: Reconstruction) -> Reconstruction:
    """`SETUP_CONTRADICTED` on rows that the likeliest causes move out of their 95 % ellipsoid,
    where no other finding applies.
    """
    said, status = found.setup_check, found.status
    if said is None or not (said.warnings or said.misread) or found.covariance is None:
        return found
    twice = said.apart & found.in_contact & (status == Status.OK)
    status = np.where(twice, Status.TOUCHES_TWICE, status)
    open_to = np.isin(status, (Status.OK, Status.SETUP_CONTRADICTED))
    known = open_to & found.in_contact & np.isfinite(found.covariance).all(axis=(-1, -2))
    covariance = np.where(known[..., None, None], found.covariance, np.eye(3))
    away = np.linalg.solve(covariance, said.shift[..., None])[..., 0]
    wrong = known & (said.misread | (np.sum(said.shift * away, axis=-1) > chdtri(3, _OUTSIDE)))
    told = np.where(wrong, Status.SETUP_CONTRADICTED, Status.OK)
    return replace(found, status=np.where(open_to, told, status).astype(np.int8))
