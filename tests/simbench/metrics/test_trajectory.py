"""ATE and RPE against evo and against the published values of known trajectories."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from simbench.metrics.camera import camera_metrics
from simbench.metrics.estimates import camera_from_poses
from simbench.metrics.trajectory import (
    ate_errors,
    frame_pairs,
    rpe_errors,
    statistics,
    time_pairs,
)
from simbench.types import Trajectories
from slam.geometry import se3
from slam.geometry.arrays import Array
from synthetic import smooth_poses

DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "trajectories"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"{DATA} is not here")


def read_kitti(path: Path) -> Array:
    with gzip.open(path) as stream:
        rows = np.loadtxt(stream)
    T = np.repeat(np.eye(4)[None], len(rows), 0)
    T[:, :3] = rows.reshape(-1, 3, 4)
    return T


def read_tum(path: Path) -> tuple[Array, Array]:
    """Stamps and poses; fr2's truth has one stamp twice."""
    rows = np.loadtxt(path)
    R = se3.rotation_from_quaternion(rows[:, 4:8])
    return rows[:, 0], se3.from_rotation_translation(R, rows[:, 1:4])


def at_estimates(true: str, estimated: str, within_periods: float | None
                 ) -> tuple[Trajectories, Array]:
    """The nearest truth at the estimate's stamps, within 0.02 s or so many periods of the truth
    (as the script for ATE does, and the one for RPE); and the estimate."""
    true_stamps, T_true = read_tum(DATA / true)
    stamps, T = read_tum(DATA / estimated)
    nearest = np.abs(stamps[:, None] - true_stamps).argmin(axis=1)
    limit = within_periods * np.median(np.diff(true_stamps)) if within_periods else 0.02
    valid = np.abs(stamps - true_stamps[nearest]) <= limit
    return Trajectories(stamps, T_true[nearest], valid, {}), T


@needs_data
@pytest.mark.parametrize(("true", "estimated", "ate", "rpe_m", "rpe_deg"), [
    ("freiburg1_xyz-groundtruth.txt", "freiburg1_xyz-rgbdslam.txt", 0.013473, 0.021217, 0.934480),
    ("fr2_desk_groundtruth.txt", "fr2_desk_ORB.txt", 0.008144, 0.007161, 0.455005)])
def test_the_tum_scripts_values(true, estimated, ate, rpe_m, rpe_deg):
    truth, T = at_estimates(true, estimated, None)
    out = camera_metrics(camera_from_poses(T, np.ones(len(T), dtype=bool)), truth, exact=False)
    # fr2: the script gives a pose of the truth to one estimate only, which changes two of 2139.
    assert out["ate"]["rmse"] == pytest.approx(ate, abs=3e-6)
    truth, T = at_estimates(true, estimated, 2.0)
    out = camera_metrics(camera_from_poses(T, np.ones(len(T), dtype=bool)), truth, exact=False)
    assert out["rpe"]["1s"]["t_rmse"] == pytest.approx(rpe_m, abs=1e-6)
    assert out["rpe"]["1s"]["r_rmse_deg"] == pytest.approx(rpe_deg, abs=1e-6)
    assert out["rpe"]["1s"]["r_rmse_rad"] == pytest.approx(np.radians(rpe_deg), abs=1e-7)


@needs_data
def test_kitti_00():
    true, estimated = (read_kitti(DATA / f"KITTI_00_{kind}.txt.gz") for kind in ("gt", "ORB"))
    assert statistics(ate_errors(estimated, true))["rmse"] == pytest.approx(1.303450, abs=1e-6)


@pytest.mark.parametrize("delta", [1, 10])
def test_ate_and_rpe_equal_evo(delta):
    metrics = pytest.importorskip("evo.core.metrics")
    trajectory = pytest.importorskip("evo.core.trajectory")
    rng = np.random.default_rng(3)
    true = smooth_poses(60, rng)
    estimated = se3.exp(rng.normal(size=6)) @ true @ se3.exp(0.03 * rng.normal(size=(60, 6)))
    stamps = np.arange(60) * 0.1
    reference, other = (trajectory.PoseTrajectory3D(poses_se3=list(T), timestamps=stamps)
                        for T in (true, estimated))
    for relation, ours in ((metrics.PoseRelation.translation_part, 0),
                           (metrics.PoseRelation.rotation_angle_deg, 1)):
        rpe = metrics.RPE(relation, delta, metrics.Unit.frames, all_pairs=True)
        rpe.process_data((reference, other))
        errors = rpe_errors(estimated, true, frame_pairs(60, delta))[ours]
        np.testing.assert_allclose(errors, rpe.error, atol=2e-7)
    other.align(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, other))
    ours = statistics(ate_errors(estimated, true))
    for key in ("rmse", "mean", "median", "std"):
        assert ours[key] == pytest.approx(ape.get_all_statistics()[key], abs=1e-9)


def test_the_partner_after_a_second_is_the_nearest_and_never_the_last():
    stamps = np.array([0.0, 0.4, 0.97, 1.1, 1.45, 2.0, 2.5])
    assert time_pairs(stamps, 1.0).tolist() == [[0, 2], [1, 4], [2, 5], [3, 5]]
    assert len(time_pairs(np.array([0.0, 1.0]), 1.0)) == 0
    assert len(time_pairs(np.zeros(0), 1.0)) == 0


def test_a_mirrored_path_is_turned_and_not_mirrored():
    path = np.random.default_rng(0).normal(size=(20, 3))
    mirrored = se3.from_rotation_translation(np.eye(3), path * [-1.0, 1.0, 1.0])
    errors = ate_errors(mirrored, se3.from_rotation_translation(np.eye(3), path))
    assert errors.max() > 0.1


def test_lost_frames_lower_the_coverage_and_leave_the_errors():
    true = smooth_poses(40, np.random.default_rng(1))
    truth = Trajectories(np.arange(40) * 0.1, true, np.ones(40, dtype=bool), {})
    known = np.ones(40, dtype=bool)
    known[[5, 20]] = False
    out = camera_metrics(camera_from_poses(true, known), truth, exact=True)
    assert out["coverage"] == pytest.approx(35 / 39)       # four steps touch a lost frame
    assert out["ate"]["coverage"] == pytest.approx(38 / 40)
    assert out["rpe"]["10f"]["coverage"] == pytest.approx(27 / 30)   # 5→15, 10→20, 20→30
    assert out["E_t"] < 1e-12
    nothing = camera_metrics(camera_from_poses(true, np.zeros(40, dtype=bool)), truth, exact=True)
    assert nothing == {"coverage": 0.0}
