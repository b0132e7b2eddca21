"""Random objects under random straight trails, with the objects' equations written once more in
NumPy.

All trails have 61 positions and steps below 0.05 L, and every object is placed, so that few kernels
are compiled.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from hypothesis import Phase
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import vibrissa as vb

COUNT = 61
UNSHRUNK = (Phase.explicit, Phase.generate)
"""A sweep costs milliseconds and a smaller counterexample says little more: failures are shown as
they were drawn.
"""
IDENTITY = Rotation.identity()
UNIT = vb.Rod.unit()
WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)


class Solid(NamedTuple):
    """Σ ((p − c)/a)² < 1, or z > a x² + b y² + h, turned about the origin, then moved."""

    kind: str
    figures: np.ndarray
    rotation: Rotation
    translation: np.ndarray

    def surface(self, length: float = 1.0) -> vb.surfaces.Surface:
        """For the package, in units in which the rod has this length."""
        f = self.figures
        if self.kind == "paraboloid":
            own = vb.surfaces.EllipticParaboloid(
                a=float(f[0] / length), b=float(f[1] / length), h=float(f[2] * length)
            )
        else:
            own = vb.surfaces.Ellipsoid(center=f[:3] * length, semi_axes=f[3:] * length)
        return own.placed(self.rotation, self.translation * length)

    def own(self, points: np.ndarray) -> np.ndarray:
        """Points seen from the object's axes."""
        return self.rotation.inv().apply(points - self.translation)

    def level(self, points: np.ndarray) -> np.ndarray:
        """Positive outside; about the distance near the surface (k,)."""
        p, f = self.own(points), self.figures
        if self.kind == "paraboloid":
            return f[0] * p[:, 0] ** 2 + f[1] * p[:, 1] ** 2 + f[2] - p[:, 2]
        return (np.linalg.norm((p - f[:3]) / f[3:], axis=1) - 1) * f[3:].min()

    def normal(self, points: np.ndarray) -> np.ndarray:
        """Outward unit normals (k, 3)."""
        p, f = self.own(points), self.figures
        bowl = np.stack([2 * f[0] * p[:, 0], 2 * f[1] * p[:, 1], -np.ones(len(p))], axis=1)
        gradient = bowl if self.kind == "paraboloid" else (p - f[:3]) / f[3:] ** 2
        return self.rotation.apply(gradient / np.linalg.norm(gradient, axis=1, keepdims=True))

    def moved(self, rotation: Rotation, translation: np.ndarray) -> "Solid":
        """The same, turned and moved once more."""
        return self._replace(
            rotation=rotation * self.rotation,
            translation=rotation.apply(self.translation) + translation,
        )

    def mirrored(self) -> "Solid":
        """Seen in a mirror in the plane y = 0; the object's own shape is its mirror image if its
        centre is moved.
        """
        figures = self.figures.copy()
        if self.kind == "ellipsoid":
            figures[1] *= -1
        x, y, z, w = self.rotation.as_quat()
        return Solid(
            self.kind, figures, Rotation.from_quat([-x, y, -z, w]), self.translation * [1, -1, 1]
        )


class Scene(NamedTuple):
    """An object and a clamp path along −x, from 1.2 to −1.2 at y = side, in model units."""

    solid: Solid
    side: float
    axis: np.ndarray

    @property
    def position(self) -> np.ndarray:
        """Clamp points (61, 3)."""
        x = np.linspace(1.2, -1.2, COUNT)
        return np.stack([x, np.full(COUNT, self.side), np.zeros(COUNT)], axis=1)

    @property
    def orientation(self) -> Rotation:
        """Of the clamp, all along the path."""
        return Rotation.from_quat(np.tile(self.trail().orientation[0], (COUNT, 1)))

    def trail(self, length: float = 1.0) -> vb.Trail:
        """The path in units in which the rod has this length."""
        ends = self.position[[0, -1]] * length
        return vb.Trail.line(start=ends[0], stop=ends[1], count=COUNT, axis=self.axis)

    def scan(self, rod: vb.Rod = UNIT) -> vb.Scan:
        """Scanned with a rod, in its units."""
        return vb.scan(rod, self.solid.surface(rod.length), self.trail(rod.length))


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False).map(lambda value: round(value, 4))


def vectors(low: float, high: float) -> st.SearchStrategy[np.ndarray]:
    return st.tuples(*[numbers(low, high)] * 3).map(np.array)


rotations = vectors(-2.0, 2.0).map(Rotation.from_rotvec)
motions = st.tuples(rotations, vectors(-1.0, 1.0))


@st.composite
def scenes(draw: st.DrawFn, kinds: tuple[str, ...] = ("paraboloid", "ellipsoid")) -> Scene:
    """A trail of 2.4 rod lengths, offset and tilted, past a bowl or a ball that is somewhat turned."""
    turn = draw(vectors(-0.15, 0.15))
    if draw(st.sampled_from(kinds)) == "paraboloid":
        a, b = draw(numbers(0.3, 0.8)), draw(numbers(0.5, 1.2))
        solid = Solid(
            "paraboloid",
            np.array([a, b, draw(numbers(0.4, 0.6))]),
            Rotation.from_rotvec(turn),
            np.zeros(3),
        )
    else:
        axes = np.array([draw(numbers(0.3, 0.6)) for _ in range(3)])
        center = np.array(
            [0.0, draw(numbers(-0.1, 0.1)), draw(numbers(0.95, 1.05)) + 0.3 * axes[2]]
        )
        solid = Solid(
            "ellipsoid", np.concatenate([center, axes]), Rotation.from_rotvec(turn), np.zeros(3)
        )
    side = draw(numbers(0.1, 0.35)) * draw(st.sampled_from([-1, 1]))
    axis = np.array([draw(numbers(-0.15, 0.15)), draw(numbers(-0.15, 0.15)), 1.0])
    return Scene(solid, side, axis / np.linalg.norm(axis))


def sound(scan: vb.Scan) -> np.ndarray:
    """Rows in contact that passed all checks."""
    return scan.in_contact & (scan.status == vb.Status.OK)


def model_units(scan: vb.Scan) -> dict[str, np.ndarray]:
    """Fields in L, EI/L² and EI/L, whatever the rod."""
    rod = scan.rod
    return {
        "point": scan.point / rod.length,
        "normal": scan.normal,
        "arc_length": scan.arc_length / rod.length,
        "force": scan.reactions.force / rod.force_scale,
        "moment": scan.reactions.moment / rod.moment_scale,
        "energy": scan.energy / rod.moment_scale,
        "curvature": scan.largest_curvature * rod.length,
    }


def same(
    found: vb.Scan,
    expected: vb.Scan,
    change: Callable[[str, np.ndarray], np.ndarray],
    tolerance: float,
) -> None:
    """Both scans agree in every field of all rows, the second changed as a motion, a scale or a
    mirror does.
    """
    np.testing.assert_array_equal(found.kind, expected.kind)
    np.testing.assert_array_equal(found.status, expected.status)
    ours, theirs = model_units(found), model_units(expected)
    for name, values in ours.items():
        np.testing.assert_allclose(
            values, change(name, theirs[name]), rtol=0, atol=tolerance, err_msg=name
        )
    assert [event.kind for event in found.events] == [event.kind for event in expected.events]
    parameters = [[event.parameter for event in scan.events] for scan in (found, expected)]
    np.testing.assert_allclose(*parameters, rtol=0, atol=1e-8)
