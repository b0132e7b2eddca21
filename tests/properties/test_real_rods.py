"""What must hold for tapered rods that are curved at rest and loaded along their length: motions of
everything, units, roll, mirrors, and how finely a table describes the same rod.

Trails and loads have the same shapes throughout, so that few kernels are compiled.
"""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scenes import UNSHRUNK, Scene, model_units, motions, numbers, scenes
from scipy.spatial.transform import Rotation

import vibrissa as vb

FEW = settings(max_examples=3, phases=UNSHRUNK)
CLOSE, COARSE = 1e-8, 0.05
LENGTH, RADIUS = 0.05, 2e-4
KNOTS = np.array([0.0, 0.4, 1.0])
"""Of the table that describes a rod."""


class Real:
    """A tapered rod with a rest curve and a force per length, in units of its length and EI."""

    def __init__(
        self, taper: float, bend: float, twist: float, roll: float, load: tuple[float, ...] | None
    ) -> None:
        self.radius = 1 - taper * KNOTS**1.5
        u = bend * np.array([-np.sin(roll), np.cos(roll), 0.0])
        self.curvature = np.outer(1 + KNOTS, u) + [0, 0, twist]
        self.load = None if load is None else np.array(load)

    def __repr__(self) -> str:
        """All numbers."""
        return f"Real({self.radius}, {self.curvature}, {self.load})"

    def rod(
        self,
        length: float = 1.0,
        stiffness: float = 1.0,
        knots: np.ndarray = KNOTS,
        load: np.ndarray | None = None,
    ) -> vb.Rod:
        """With the load from gravity, in world axes."""
        radius = RADIUS / LENGTH * length
        outer = radius * np.interp(knots, KNOTS, self.radius)
        u = np.stack([np.interp(knots, KNOTS, part) for part in self.curvature.T], axis=1)
        rod = vb.Rod.from_table(
            arc_length=knots * length,
            radius=outer,
            youngs_modulus=stiffness / (np.pi / 4 * radius**4),
            density=1 / (np.pi * radius**2),
        ).curved(vb.RestShape.from_components(knots * length, u / length))
        force = self.load if load is None else load
        if force is None:
            return rod
        # The load at the clamp; farther out it is less, as the section is.
        return rod.loaded(vb.Loads(gravity=force * stiffness / length**3))

    def mirrored(self) -> "Real":
        """Seen in a mirror in the plane y = 0: curvature is a pseudovector."""
        other = object.__new__(Real)
        other.radius = self.radius
        other.curvature = self.curvature * [-1, 1, -1]
        other.load = None if self.load is None else self.load * [1, -1, 1]
        return other


def rods(loads: st.SearchStrategy) -> st.SearchStrategy[Real]:
    return st.builds(
        Real,
        numbers(0.1, 0.6),
        numbers(-0.4, 0.4),
        numbers(-0.5, 0.5),
        numbers(-3.0, 3.0),
        loads,
    )


reals = rods(st.none())
loaded = rods(st.tuples(*[numbers(-0.2, 0.2)] * 3))


def scan(
    rod: vb.Rod,
    scene: Scene,
    orientation: Rotation | None = None,
    position: np.ndarray | None = None,
) -> vb.Scan:
    """A scene scanned by a rod in its units."""
    place = scene.position if position is None else position
    turns = scene.orientation if orientation is None else orientation
    trail = vb.Trail(place * rod.length, turns)
    return vb.scan(rod, scene.solid.surface(rod.length), trail)


def same(found: vb.Scan, expected: vb.Scan, change: Callable) -> None:
    """As `scenes.same`, but for the largest curvature, which is taken at nodes: whether one at the
    tip counts is up to rounding. So is whether a contact counts that ends right at a position.
    """
    for one in (found, expected):
        force = np.linalg.norm(one.contact_force, axis=1) / one.rod.force_scale
        assume(not np.any(one.in_contact & (force < CLOSE)))
    np.testing.assert_array_equal(found.kind, expected.kind)
    np.testing.assert_array_equal(found.status, expected.status)
    ours, theirs = model_units(found), model_units(expected)
    for name, values in ours.items():
        np.testing.assert_allclose(
            values,
            change(name, theirs[name]),
            rtol=0,
            atol=COARSE if name == "curvature" else CLOSE,
            err_msg=name,
        )
    kinds = ([event.kind for event in one.events] for one in (found, expected))
    assert next(kinds) == next(kinds)


def unchanged(_: str, values: np.ndarray) -> np.ndarray:
    return values


def move(real: Real, scene: Scene, motion: tuple[Rotation, np.ndarray]) -> None:
    rotation, shift = motion
    still = scan(real.rod(), scene)
    moved = scan(
        real.rod(load=None if real.load is None else rotation.apply(real.load)),
        scene._replace(solid=scene.solid.moved(rotation, shift)),
        rotation * scene.orientation,
        rotation.apply(scene.position) + shift,
    )

    def change(name: str, values: np.ndarray) -> np.ndarray:
        turned = values @ rotation.as_matrix().T if values.ndim == 2 else values
        return turned + shift if name == "point" else turned

    same(moved, still, change)


@FEW
@given(reals, scenes(("ellipsoid",)), motions)
def test_moving_clamp_and_object_moves_the_result(
    real: Real, scene: Scene, motion: tuple[Rotation, np.ndarray]
) -> None:
    move(real, scene, motion)


@pytest.mark.slow
@FEW
@given(loaded, scenes(("ellipsoid",)), motions)
def test_moving_clamp_object_and_loads_moves_the_result(
    real: Real, scene: Scene, motion: tuple[Rotation, np.ndarray]
) -> None:
    move(real, scene, motion)


@pytest.mark.slow
@FEW
@given(loaded, scenes(("ellipsoid",)))
def test_loads_scale_with_ei_over_l_cubed(real: Real, scene: Scene) -> None:
    same(scan(real.rod(LENGTH, 3e-4), scene), scan(real.rod(), scene), unchanged)


@FEW
@given(reals, scenes(("ellipsoid",)))
def test_forces_scale_with_ei_and_lengths_with_l(real: Real, scene: Scene) -> None:
    same(scan(real.rod(LENGTH, 3e-4), scene), scan(real.rod(), scene), unchanged)


@FEW
@given(reals, scenes(("ellipsoid",)), numbers(-3.0, 3.0))
def test_rolling_the_rest_curve_is_turning_the_clamp_about_its_axis(
    real: Real, scene: Scene, roll: float
) -> None:
    turned = object.__new__(Real)
    turned.radius, turned.load = real.radius, real.load
    about = Rotation.from_rotvec([0.0, 0.0, roll])
    turned.curvature = about.apply(real.curvature)
    rolled = scan(turned.rod(), scene)
    same(scan(real.rod(), scene, scene.orientation * about), rolled, unchanged)


@FEW
@given(reals, scenes(("ellipsoid",)))
def test_a_mirror_image_has_the_mirrored_result(real: Real, scene: Scene) -> None:
    mirror = np.array([1, -1, 1])
    x, y, z, w = scene.orientation.as_quat().T
    image = scan(
        real.mirrored().rod(),
        scene._replace(solid=scene.solid.mirrored()),
        Rotation.from_quat(np.stack([-x, y, -z, w], axis=1)),
        scene.position * mirror,
    )

    def change(name: str, values: np.ndarray) -> np.ndarray:
        if values.ndim == 1:
            return values
        return values * (-mirror if name == "moment" else mirror)

    same(image, scan(real.rod(), scene), change)


@FEW
@given(reals, scenes(("ellipsoid",)), st.lists(numbers(0.05, 0.95), min_size=4, max_size=4))
def test_a_table_split_finer_describes_the_same_rod(
    real: Real, scene: Scene, extra: list[float]
) -> None:
    knots = np.unique([*KNOTS, *extra])
    fine = real.rod(knots=knots)
    assert fine.section.knots == (0.0, 0.4, 1.0)
    same(scan(fine, scene), scan(real.rod(), scene), unchanged)
