"""From a scan to a surface by the whole chain: scan, sensor, reconstruction, smoothing, fit."""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from sweeps import SENSOR
from sweeps import WIRE as ROD

import vibrissa as vb

RATE, SPEED, SPAN = 50.0, 0.02, 0.04
OBJECT = vb.surfaces.Superquadric(
    center=(0, 0, 0), semi_axes=(0.024, 0.017, 0.019), exponents=(0.8, 0.7)
)


class Touched(NamedTuple):
    """Smoothed contacts, one object for each sweep, and rods that missed."""

    contacts: list[vb.Contacts]
    missed: np.ndarray


def sweep(turn: Rotation, offset: float, seed: int) -> tuple[vb.Contacts, np.ndarray]:
    """A sweep across the object from one side, after a second of rest."""
    count, rest = round(2 * SPAN / SPEED * RATE), round(RATE)
    along = SPAN - np.arange(count) * SPEED / RATE
    position = turn.apply(np.column_stack([along, np.full(count, offset), np.full(count, -0.050)]))
    scan = vb.scan(ROD, OBJECT, vb.Trail(position, np.tile(turn.as_quat(), (count, 1))))
    still = np.zeros((rest, 3))
    force, moment = (
        np.nan_to_num(np.concatenate([still, part]))
        for part in (scan.reactions.force, scan.reactions.moment)
    )
    trail = vb.Trail(
        np.concatenate([np.tile(position[0], (rest, 1)), position]),
        np.tile(turn.as_quat(), (rest + count, 1)),
    )
    exact = vb.Reactions(trail, force, moment, time=np.arange(rest + count) / RATE)
    raw = SENSOR.measure(exact, np.random.default_rng(seed), force_tare=(0.4, -0.1, 1.9))
    found = vb.smooth(vb.reconstruct(ROD, SENSOR.reactions(raw), friction=0.0, check=False))
    free = np.flatnonzero(found.kind == vb.ContactKind.NONE)[rest::10]
    return found.contacts, found.elastic_lines(free, 30)


@pytest.fixture(scope="module")
def touched() -> Touched:
    sides = [Rotation.from_euler("x", 90 * i, degrees=True) for i in range(4)]
    sides += [Rotation.from_euler("y", angle, degrees=True) for angle in (90, -90)]
    parts = [
        sweep(side, offset, 10 * i + j)
        for i, side in enumerate(sides)
        for j, offset in enumerate(np.linspace(-0.014, 0.014, 5) + 1e-3 * i - 2e-3)
    ]
    return Touched([part[0] for part in parts], np.concatenate([part[1] for part in parts]))


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    """Points spread over the object."""
    points = 0.03 * np.random.default_rng(0).uniform(-1, 1, (6000, 3))
    points = points[np.abs(OBJECT.distances(points)) < 2e-3]
    for _ in range(20):
        points = OBJECT.nearest(points)
    return points[:800]


def near(contacts: list[vb.Contacts], points: np.ndarray, distance: float = 3e-3) -> np.ndarray:
    places = np.concatenate([part.point for part in contacts])
    return KDTree(places[np.isfinite(places).all(axis=1)]).query(points)[0] < distance


def test_surface_where_it_was_touched(touched, truth):
    shape = vb.fit_shape(touched.contacts)
    there = near(touched.contacts, truth)
    away, deviation = np.abs(shape.distance(truth)), shape.deviation(truth)
    assert there.mean() > 0.5
    assert away[there].mean() < 0.02e-3
    assert np.quantile(away[there], 0.95) < 0.06e-3
    assert np.mean(away[there] < 1.96 * deviation[there]) > 0.93
    assert np.mean(away[~there] < 1.96 * deviation[~there]) > 0.93
    assert np.median(deviation[there]) < 0.03e-3
    cosine = np.sum(shape.normal(truth) * OBJECT.normal(truth), axis=1)[there]
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    assert np.median(angle) < 0.5
    assert np.quantile(angle, 0.95) < 3.0


def test_outliers_among_measured_contacts_are_named(touched, truth):
    rng = np.random.default_rng(3)
    spoilt, wrong = [], []
    for part in touched.contacts:
        bad = rng.random(len(part)) < 0.04
        moved = part.point + np.where(bad[:, None], rng.normal(0, 2.5e-3, part.point.shape), 0)
        fields = vars(part) | {"point": moved}
        spoilt.append(vb.Contacts(**fields))
        wrong.append(bad)
    shape, bad = vb.fit_shape(spoilt), np.concatenate(wrong)
    used = np.isfinite(np.concatenate([part.point for part in spoilt])).all(axis=1)
    used &= np.concatenate([part.status for part in spoilt]) == 0
    used &= np.concatenate([part.kind for part in spoilt]) > 0
    assert shape.outlier[used & bad].mean() > 0.9
    assert shape.outlier[used & ~bad].mean() < 0.01
    there = near(touched.contacts, truth)
    assert np.abs(shape.distance(truth))[there].mean() < 0.02e-3


def test_rods_that_missed_tell_where_the_other_side_is_not(touched, truth):
    one_side = touched.contacts[:5]
    known = vb.fit_shape(one_side, swept=touched.missed)
    away = np.abs(known.distance(truth))
    assert np.mean(away < 1.96 * known.deviation(truth)) > 0.93
    mesh = known.mesh()
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    first, second, third = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(second - first, third - first), axis=1)
    spurious = np.abs(OBJECT.distances(middle)) > 2e-3
    assert area[spurious].sum() < 0.05 * area.sum()
