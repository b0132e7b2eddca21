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
    true_values,
    wrong,
)
from calibration_sweeps import CENTER, EGG, PLANE
from scipy.stats import chi2

import vibrissa as vb
from vibrissa.surfaces import Mesh, Plane, Surface


def _egg() -> Surface:
    # Faces so fine that contacts on them are off by a tenth of the robot's noise.
    mesh = trimesh.creation.icosphere(subdivisions=5)
    mesh.apply_scale(EGG)
    mesh.apply_translation(CENTER)
    return Mesh(mesh.vertices, mesh.faces)


OBJECTS = {"plane": lambda: Plane(*PLANE), "egg": _egg}


@pytest.mark.parametrize("name", OBJECTS)
def test_rod_and_clamp_are_found_on_it(name: str) -> None:
    """Errors from a start that is far off are those of the stated covariance."""
    noisy, rng = sensor(), np.random.default_rng(0)
    recordings = [
        noisy.measure(
            independent(f"{name} {y}"), rng, force_tare=FORCE_TARE, torque_tare=TORQUE_TARE
        )
        for y in ("+0.005", "-0.010")
    ]
    start = wrong(replace(setup(noisy), surface=OBJECTS[name]()))
    found, truth = vb.calibrate(recordings, start), true_values(start)
    assert found.identifiability.names == NAMES
    error = np.array([found.estimates[name].value - truth[name] for name in NAMES])
    assert error @ np.linalg.solve(found.covariance, error) < chi2.isf(1e-3, len(NAMES))
    assert found.estimates["youngs_modulus"].deviation < 0.01 * 206e9
    assert found.fitness.reduced_chi_square == pytest.approx(1, abs=0.15)
    assert found.unevenness == 0
