"""Calibration on other objects than a ball."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from calibration_bench import (
    FORCE_TARE,
    NAMES,
    TORQUE_TARE,
    independent,
    sensor,
    setup,
    swept_under,
    true_values,
    wrong,
)
from scipy.stats import chi2

import vibrissa as vb
from vibrissa.surfaces import Mesh, Plane, Surface


def _egg() -> Surface:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    mesh.apply_scale([1.1, 0.9, 1.0])
    mesh.apply_translation([0, 0, 0.0575])
    return Mesh(mesh.vertices, mesh.faces)


def _ways(first: tuple, second: tuple, last: tuple) -> list[vb.Reactions]:
    """Over the egg, of which only the package knows the shape."""
    return [
        swept_under(_egg(), first, (-0.04, 0.005, 0)),
        swept_under(_egg(), second, last),
    ]


OBJECTS = {
    "plane": (
        lambda: Plane((0, 0, 0.045), (0.3, 0.2, -1)),
        lambda: [independent("plane +0.005"), independent("plane -0.010")],
    ),
    "mesh": (_egg, lambda: _ways((0.045, 0.005, 0), (0.045, -0.01, 0), (-0.04, 0, 0))),
}


@pytest.mark.parametrize(
    # A mesh's kernels, of the sweep and of the fit, take minutes to compile.
    "name",
    ["plane", pytest.param("mesh", marks=pytest.mark.slow)],
)
def test_rod_and_clamp_are_found_on_it(name: str) -> None:
    """Errors from a start that is far off are those of the stated covariance."""
    make, sweeps = OBJECTS[name]
    surface, noisy, rng = make(), sensor(), np.random.default_rng(0)
    recordings = [
        noisy.measure(one, rng, force_tare=FORCE_TARE, torque_tare=TORQUE_TARE) for one in sweeps()
    ]
    start = wrong(replace(setup(noisy), surface=surface))
    found, truth = vb.calibrate(recordings, start), true_values(start)
    assert found.identifiability.names == NAMES
    error = np.array([found.estimates[name].value - truth[name] for name in NAMES])
    assert error @ np.linalg.solve(found.covariance, error) < chi2.isf(1e-3, len(NAMES))
    assert found.estimates["youngs_modulus"].deviation < 0.01 * 206e9
    assert found.fitness.reduced_chi_square == pytest.approx(1, abs=0.15)
    assert found.unevenness == 0
