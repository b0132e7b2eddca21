"""Whether a sweep's contacts agree with the setup: the entry points."""

import warnings
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from vibrissa.contacts import RecordingWarning, Status
from vibrissa.inverse.checks.findings import SetupCheck
from vibrissa.inverse.checks.judgement import judged
from vibrissa.inverse.checks.passes import carried, contradicts, delay_of
from vibrissa.inverse.checks.wording import delay_told
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.work import still_warnings, work_warnings

_OUTSIDE = 0.05
"""Probability outside of the ellipsoids."""


def check_setup(found: Reconstruction) -> SetupCheck:
    """What the contacts of a recording say of rod, clamp and sensor, with no object known.

    Parameters
    ----------
    found
        Contacts of one sweep (n, …) or several (m, n, …), sample by sample or smoothed; the
        reactions tell, not the smoothed contacts.

    Returns
    -------
    SetupCheck
        Empty where the noise is not known, or too little of the sweep is in contact.

    Notes
    -----
    Each contact obeys more conditions than it has unknowns (`vibrissa.inverse.checks.constraints`).
    What is left of them is explained by one cause at a time, by generalised least squares under the
    noise, the error of the zero, a model error of 2e-4 L and errors that the setup tolerates
    (mechanics.md, "What the data say of the setup").
    """
    if found.reactions.covariance is None or found.reactions.time is None:
        return SetupCheck(friction=found.friction or 0.0, shift=np.zeros_like(found.point))
    if found.kind.ndim == 1:
        return judged(found)
    parts = [judged(found[j]) for j in range(len(found.kind))]
    worst = max(parts, key=lambda part: part.causes[0].significance if part.causes else 0.0)
    lines = [f"trail {j}: {line}" for j, part in enumerate(parts) for line in part.warnings]
    none = np.zeros(found.kind.shape[1], dtype=bool)
    apart = np.stack([none if part.apart is None else part.apart for part in parts])
    return replace(
        worst,
        warnings=tuple(lines),
        shift=np.stack([part.shift for part in parts]),
        apart=apart if apart.any() else None,
    )


def checked(found: Reconstruction) -> Reconstruction:
    """The same contacts with what they say against the setup: `setup_check`, `warnings` (each also
    a `RecordingWarning`), and statuses as by `with_contradictions`.
    """
    said, moves, by_work = check_setup(found), False, dict[str, None]()
    still: list[str] = []
    if found.reactions.time is not None:
        trails = [found] if found.kind.ndim == 1 else [found[j] for j in range(len(found.kind))]
        by_work = dict.fromkeys(line for trail in trails for line in work_warnings(trail))
        if len(trails) == 1:
            still, moves = still_warnings(trails[0])
    lines = [*said.warnings, *by_work, *still]
    for line in lines:
        warnings.warn(line, RecordingWarning, stacklevel=3)
    said = replace(said, misread=bool(said.misread or by_work or moves or found.reactions.misread))
    return with_contradictions(
        with_delay(replace(found, setup_check=said, warnings=[*found.warnings, *lines]))
    )


def with_delay(found: Reconstruction) -> Reconstruction:
    """The same contacts of one trail, with a delay of the poses among the causes where passes to
    and fro tell one that is not named yet.
    """
    said = found.setup_check
    if said is None or said.misread or any("pose_delay" in names for names in said.named):
        return found
    delay = delay_of(found)
    if delay is None or not contradicts(delay, found):
        return found
    line = delay_told(found.rod, delay)
    warnings.warn(line, RecordingWarning, stacklevel=4)
    own = np.nan_to_num(delay.estimate[0] * carried(found))
    sizes = (np.linalg.norm(shift, axis=1, keepdims=True) for shift in (own, said.shift))
    said = replace(
        said,
        causes=(delay, *said.causes),
        named=(*said.named, (delay.name,)),
        warnings=(*said.warnings, line),
        shift=np.where(np.greater(*sizes), own, said.shift),
    )
    return replace(found, setup_check=said, warnings=[*found.warnings, line])


def with_contradictions(found: Reconstruction) -> Reconstruction:
    """`SETUP_CONTRADICTED` on rows that the likeliest causes of the check move out of their 95 %
    ellipsoid, where nothing else is found against them.
    """
    said, status = found.setup_check, found.status
    if said is None or not (said.warnings or said.misread) or found.covariance is None:
        return found
    if said.apart is not None:
        twice = said.apart & found.in_contact & (status == Status.OK)
        status = np.where(twice, Status.TOUCHES_TWICE, status)
    open_to = np.isin(status, (Status.OK, Status.SETUP_CONTRADICTED))
    known = open_to & found.in_contact & np.isfinite(found.covariance).all(axis=(-1, -2))
    covariance = np.where(known[..., None, None], found.covariance, np.eye(3))
    distance = np.sum(
        said.shift * np.linalg.solve(covariance, said.shift[..., None])[..., 0], axis=-1
    )
    wrong = known & (said.misread | (distance > chdtri(3, _OUTSIDE)))
    told = np.where(wrong, Status.SETUP_CONTRADICTED, Status.OK)
    return replace(found, status=np.where(open_to, told, status).astype(np.int8))
