"""Several contacts that explain the same reactions.

Wherever the line of action of the contact force crosses a rod of known base wrench, no moment is
left in it, and the contact may be there. A straight rod is crossed once, unless it is bent to and
fro; a curved one more often.
"""

from typing import Any, NamedTuple

import jax
import numpy as np

from vibrissa.contacts import ContactKind, Contacts, Status
from vibrissa.inverse.arrays import Codes
from vibrissa.inverse.kernels import TIP, Setting, candidates_of
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.shared import samples_of, setting_of, under_friction


class Candidates(NamedTuple):
    """The contacts that explain one row."""

    row: tuple[int, ...]
    """Index of the row: (i,), or (trail, i) of several trails."""
    contacts: Contacts
    """(k,) in order along the rod; normals are the direction of the force."""


def open_rows(found: Reconstruction) -> tuple[Setting, Codes, Any]:
    """Rows that are `NOT_UNIQUE` because the rod is curved, as samples, with what they share."""
    setting = under_friction(setting_of(found.rod, found.reactions), found.friction)
    rows = np.flatnonzero(found.status == Status.NOT_UNIQUE)
    rows = rows if setting.rod.candidates > 1 else rows[:0]
    samples = samples_of(found.rod, found.reactions)
    return setting, rows, jax.tree.map(lambda part: part[rows], samples)


def candidates(found: Reconstruction) -> list[Candidates]:
    """All contacts of the rows that are `NOT_UNIQUE` because the rod is curved."""
    rod, reactions = found.rod, found.reactions
    setting, rows, samples = open_rows(found)
    if not rows.size:
        return []
    seen: Any = candidates_of(setting, samples)
    contact, fits = seen
    base = reactions.trail.position.reshape(-1, 3)[rows]
    listed = []
    for place, row in enumerate(rows):
        own = jax.tree.map(lambda part, place=place: part[place][fits[place]], contact)
        kind = np.where(own.arc_length > 1 - TIP, ContactKind.TIP, ContactKind.TANGENTIAL)
        contacts = Contacts(
            base[place] + own.reach * rod.length,
            own.direction,
            kind=kind,
            force_direction=own.direction,
            arc_length=own.arc_length * rod.length,
        )
        index = tuple(int(i) for i in np.unravel_index(row, found.kind.shape))
        listed.append(Candidates(index, contacts))
    return listed
