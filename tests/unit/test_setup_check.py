"""What the contacts of a sweep say of rod, clamp and sensor: recordings of an independent engine
with known faults, and a line integrated independently.
"""

import gzip
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibration_bench import WIRE, recordings, sensor, setup
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.inverse import check_setup
from vibrissa.inverse.checks.constraints import Stated, constraints_of
from vibrissa.mechanics.imperfect import Imperfect

EFFECTS = Path(__file__).parents[3] / "shared" / "recordings" / "effects"


def recorded(name: str, folder: Path) -> tuple[vb.Setup, vb.Reactions]:
    if not (EFFECTS / f"{name}.csv.gz").exists():
        pytest.skip(f"no recording {name} in {EFFECTS}")
    path = folder / f"{name}.csv"
    path.write_bytes(gzip.decompress((EFFECTS / f"{name}.csv.gz").read_bytes()))
    loaded = vb.load_setup(EFFECTS / f"{name}.toml")
    return loaded, vb.read_recording(path, loaded)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> tuple[vb.Setup, vb.Reactions]:
    return recorded("revers", tmp_path_factory.mktemp("sound"))


def test_nothing_is_said_where_all_is_as_stated(sound: tuple[vb.Setup, vb.Reactions]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = vb.reconstruct(sound[0].rod, sound[1])
    assert found.warnings == []
    assert not np.any(found.status == vb.Status.SETUP_CONTRADICTED)


def test_a_stiffness_one_per_cent_off_is_named(sound: tuple[vb.Setup, vb.Reactions]) -> None:
    rod = replace(sound[0].rod, bending_stiffness=0.985 * sound[0].rod.bending_stiffness)
    said = check_setup(vb.reconstruct(rod, sound[1], check=False))
    (cause,) = (cause for cause in said.causes if cause.name == "bending_stiffness")
    assert "bending_stiffness" in said.named[0]
    assert abs(cause.estimate[0] - 0.015) < 3 * cause.deviation[0] + 0.004


def test_rest_curvature_is_named_with_its_size(tmp_path: Path) -> None:
    loaded, reactions = recorded("sagy", tmp_path)
    with pytest.warns(vb.RecordingWarning, match="sagitta 1 mm along y"):
        found = vb.reconstruct(loaded.rod, reactions)
    assert np.mean(found.status[found.in_contact] != vb.Status.OK) > 0.9


def test_a_turned_clamp_is_named_with_its_angle(tmp_path: Path) -> None:
    loaded, reactions = recorded("clamp1deg_y", tmp_path)
    said = check_setup(vb.reconstruct(loaded.rod, reactions, check=False))
    (cause,) = (cause for cause in said.causes if cause.name == "clamp_orientation")
    assert "clamp_orientation" in said.named[0]
    np.testing.assert_allclose(np.degrees(cause.estimate), [0.0, 1.0], atol=0.1)


@pytest.mark.parametrize("turn", [0.0, 4.0])
def test_a_sweep_of_few_samples_is_judged_too(turn: float) -> None:
    """Some twenty samples of a wire under a ball; its clamp turned by so many degrees, unknown to
    the setup, the moment along the rod is far from 0 in each of them.
    """
    rod = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
    x = 0.1 - 0.13 * np.maximum(np.arange(130) - 50, 0) / 50
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (len(x), 1))
    trail = vb.Trail(np.column_stack([x, np.full(len(x), 0.005), np.zeros(len(x))]), upright)
    scan = vb.scan(rod, vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03), trail)
    assert 12 < np.count_nonzero(scan.in_contact) < 30
    time = np.arange(len(x)) / 50
    mount = Rotation.from_rotvec([[0, turn, 0], [0, 0, 0]], degrees=True).as_quat()
    noise = {"force_noise": 2e-3 * rod.force_scale, "torque_noise": 8e-4 * rod.moment_scale}
    true, stated = (
        vb.Sensor(np.array([0, 0, 0.025]), at, "on_sensor", tare_seconds=0.9, **noise)
        for at in mount
    )
    given = vb.Reactions(scan.trail, scan.reactions.force, scan.reactions.moment, time=time)
    logged = true.measure(given, np.random.default_rng(1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = vb.reconstruct(rod, stated.reactions(logged))
    assert bool(found.warnings) == (turn > 0)


def test_constraints_are_those_of_an_integrated_rod() -> None:
    """Forward from a tip force to the base wrench of a tapering, curved, heavy rod: there all
    constraints hold.
    """
    taper, bend, load = 0.2, np.array([0.1, -0.2]), np.array([0.02, -0.01, 0.05])
    force = np.array([0.3, -0.5, -0.8])

    def rod(s: float, y: np.ndarray) -> np.ndarray:
        t, d, m = y[3:6], y[6:9], y[9:]
        n = force + load * (1 - s)
        turning = m / (1 - taper * s) ** 4 + np.cross(t, bend[0] * d + bend[1] * np.cross(t, d))
        return np.concatenate([t, np.cross(turning, t), np.cross(turning, d), -np.cross(t, n)])

    def at_tip(m: np.ndarray) -> np.ndarray:
        return solve_ivp(
            rod,
            (0, 1),
            np.concatenate([np.zeros(3), [0, 0, 1], [1, 0, 0], m]),
            rtol=1e-11,
            atol=1e-12,
        ).y[:, -1]

    moment = np.cross([0, 0, 1], force)
    for _ in range(12):
        left = at_tip(moment)[9:]
        slope = np.stack([(at_tip(moment + 1e-6 * e)[9:] - left) / 1e-6 for e in np.eye(3)], axis=1)
        moment = moment - np.linalg.solve(slope, left)
    wrench = -np.concatenate([force + load, moment])[None]
    bent_rod = Imperfect(wrench, np.array([taper]), bend[None], load[None])
    found = constraints_of(Stated(1.0), bent_rod)
    np.testing.assert_allclose(found.value[0, :3], 0, atol=1e-4)
    np.testing.assert_allclose(found.reach[0], at_tip(moment)[:3], atol=1e-3)


def test_calibration_without_an_object_finds_stiffness_over_length_squared() -> None:
    one = sensor()
    truth = setup(one)
    start = replace(
        truth,
        surface=None,
        rod=replace(
            WIRE, bending_stiffness=1.08 * WIRE.bending_stiffness, length=1.01 * WIRE.length
        ),
    )
    found = vb.calibrate(recordings(one), start, free=("youngs_modulus", "length"))
    stiffness, length = (found.estimates[name] for name in ("youngs_modulus", "length"))
    value = stiffness.value / length.value**2 / (206e9 / 0.05**2)
    slope = np.array([1 / stiffness.value, -2 / length.value])
    assert abs(np.log(value)) < 4 * np.sqrt(slope @ found.covariance @ slope)
    assert abs(np.log(value)) < 0.02


def test_calibration_without_an_object_from_a_start_that_mistakes_the_phases() -> None:
    """Two per cent of the length: as stated, the flank lies beyond the tip of half of the sweep."""
    one = sensor()
    truth = setup(one)
    for seed, error in ((1, 0.02), (2, -0.02)):
        start = replace(truth, surface=None, rod=replace(WIRE, length=(1 + error) * WIRE.length))
        found = vb.calibrate(recordings(one, seed), start, free=("youngs_modulus", "length"))
        stiffness, length = (found.estimates[name] for name in ("youngs_modulus", "length"))
        slope = np.array([1 / stiffness.value, -2 / length.value])
        off = np.log(stiffness.value / length.value**2 / (206e9 / 0.05**2))
        assert abs(off) < 3 * np.sqrt(slope @ found.covariance @ slope)
        assert abs(off) < 0.01


@pytest.mark.filterwarnings("ignore::vibrissa.contacts.RecordingWarning")
def test_clamp_work_that_a_stated_gain_explains_is_no_contradiction() -> None:
    one = sensor()
    (raw,) = recordings(replace(one, gain=(1, 1, 1, 1.04, 1.04, 1.04)), heights=(0.005,))
    told, allowed = (
        vb.reconstruct(WIRE, one.reactions(raw, tolerances=given))
        for given in (None, vb.Tolerances(gain=0.04))
    )
    assert any("clamp's work" in line for line in told.warnings)
    assert not np.any(told.status[told.in_contact] == vb.Status.OK)
    assert not any("clamp's work" in line for line in allowed.warnings)
    assert np.mean(allowed.status[allowed.in_contact] == vb.Status.OK) > 0.9


def test_numbers_that_no_single_cause_explains_are_said_to_be_so() -> None:
    one = sensor()
    (raw,) = recordings(replace(one, gain=(1, 1, 1, 5, 0.3, 5)), heights=(0.005,))
    with pytest.warns(vb.RecordingWarning):
        found = vb.reconstruct(WIRE, one.reactions(raw))
    assert not np.any(found.status[found.in_contact] == vb.Status.OK)


def test_a_clamp_that_hardly_moves_while_the_rod_is_loaded_is_named() -> None:
    """Metres that were taken for millimetres, and poses that stand still: there the object may
    move, and the contacts are right.
    """
    one = sensor()
    (raw,) = recordings(one, heights=(0.005,))
    with pytest.warns(vb.RecordingWarning, match="positions in m, taken for mm"):
        small = vb.reconstruct(
            WIRE,
            replace(one, position_noise=1e-8).reactions(replace(raw, position=1e-3 * raw.position)),
        )
    assert not np.any(small.status[small.in_contact] == vb.Status.OK)
    with pytest.warns(vb.RecordingWarning, match="a pose stream that stands still"):
        still = vb.reconstruct(
            WIRE,
            one.reactions(replace(raw, position=np.tile(raw.position[:1], (len(raw.position), 1)))),
        )
    assert np.any(still.status[still.in_contact] == vb.Status.OK)


def test_tolerances_in_other_units_are_refused() -> None:
    for name, value in (
        ("length", 0.5),
        ("clamp_orientation", 3.0),
        ("pose_delay", 20.0),
        ("gain", 2.0),
    ):
        with pytest.raises(
            ValueError, match=f"{name} = {value}; allowed is a standard deviation from 0 to"
        ):
            vb.Tolerances(**{name: value})


def test_without_an_object_what_is_left_open_goes_with_its_tolerance() -> None:
    """With the clamp free along the rod only EI/L² is seen: with EI known to 3 %, L is known to 1.5
    %.
    """
    one = sensor()
    start = replace(setup(one), surface=None)
    alone, found = (
        vb.calibrate(recordings(one), start, tolerances=given)
        for given in (None, vb.Tolerances(youngs_modulus=0.03))
    )
    assert not alone.estimates["youngs_modulus"].determined
    assert found.estimates["youngs_modulus"].determined
    assert found.estimates["length"].deviation == pytest.approx(0.015 * WIRE.length, rel=0.3)
    assert alone.estimates["length"].deviation < 0.3 * found.estimates["length"].deviation


def test_without_an_object_each_sweep_is_predicted_by_the_others() -> None:
    """Sound sweeps are, and one whose torques are read by another gain is told apart, and so is a
    start that is far off.
    """
    one = sensor()
    start = replace(setup(one), surface=None)
    free = ("youngs_modulus", "length")
    sweeps = recordings(one)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = vb.calibrate(sweeps, start, free=free)
    assert [part.part for part in found.held_out] == [
        f"recordings[{index}]" for index in range(len(sweeps))
    ]
    assert all(0.5 < part.reduced_chi_square < 1.5 for part in found.held_out)
    odd = [*sweeps[:-1], *recordings(replace(one, gain=(1, 1, 1, 1.02, 1.02, 1.02)))[-1:]]
    with pytest.warns(vb.RecordingWarning, match=r"recordings\[[01]\]: not what the rest predicts"):
        told = vb.calibrate(odd, start, free=free)
    assert max(part.move for part in told.held_out) > 6
    with pytest.warns(
        vb.RecordingWarning,
        match="length: found .* from where it was given, .* times its tolerance",
    ):
        vb.calibrate(
            sweeps,
            replace(start, rod=replace(WIRE, length=1.12 * WIRE.length)),
            free=free,
            tolerances=vb.Tolerances(length=5e-4),
        )
