"""Contacts on objects without a rod: places and normals with known errors, in sweeps whose errors
are alike.
"""

import numpy as np

import vibrissa as vb

POINT, NORMAL = 4e-5, 0.006
"""Deviations of points [m] and normals [rad], much as smoothing leaves them."""
_ALIKE = 5.0
"""Contacts over which errors are alike."""


def on_surface(surface: vb.surfaces.Surface, points: np.ndarray) -> np.ndarray:
    """Points moved onto a surface along its normals."""
    for _ in range(30):
        points = points - surface.distances(points)[:, None] * surface.normal(points)
    return points


def rings(
    surface: vb.surfaces.Surface,
    rng: np.random.Generator,
    *,
    sweeps: int = 16,
    contacts: int = 40,
    reach: float = 0.02,
) -> vb.Contacts:
    """Sweeps round an object about the origin, each in its own plane through the x, y or z axis."""
    parts = []
    for number in range(sweeps):
        axis = np.roll(np.eye(3), number, axis=0)
        lean = np.pi * number / sweeps
        across = np.cos(lean) * axis[1] + np.sin(lean) * axis[2]
        angle = 2 * np.pi * np.arange(contacts) / contacts
        start = reach * (np.outer(np.cos(angle), axis[0]) + np.outer(np.sin(angle), across))
        point = on_surface(surface, start)
        normal = surface.normal(point)
        errors = _alike(rng, contacts) * np.repeat([POINT, NORMAL], 3)
        turned = normal + errors[:, 3:]
        turned /= np.linalg.norm(turned, axis=1)[:, None]
        across_normal = np.eye(3) - normal[:, :, None] * normal[:, None]
        parts.append(
            vb.Contacts(
                point + errors[:, :3],
                turned,
                np.tile(POINT**2 * np.eye(3), (contacts, 1, 1)),
                NORMAL**2 * across_normal,
            )
        )
    return joined(parts)


def joined(parts: list[vb.Contacts]) -> vb.Contacts:
    """Contacts of several sweeps as one."""
    return vb.Contacts(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("point", "normal", "covariance", "normal_covariance")
        ),
        sweep=np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
    )


def _alike(rng: np.random.Generator, count: int) -> np.ndarray:
    """Six columns of unit variance whose rows are correlated."""
    rows = np.arange(count)
    root = np.linalg.cholesky(np.exp(-np.abs(rows[:, None] - rows[None]) / _ALIKE))
    return root @ rng.normal(size=(count, 6))
