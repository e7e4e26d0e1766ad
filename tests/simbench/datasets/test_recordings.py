"""The readers on excerpts of real recordings, where they stand beside the checkout."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from simbench.sequence import open_sequence
from slam.geometry import se3

DATA = Path(__file__).resolve().parents[4] / "shared/data"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"no recordings in {DATA}")


def test_kitti_tracking_cars_move_forward_and_lie_on_their_masks():
    sequence = open_sequence(DATA / "kitti_tracking_0003")
    assert len(sequence) == 30
    truth = sequence.truth.trajectories
    valid = {i: int(o.valid.sum()) for i, o in truth.objects.items()}
    assert (valid[1], valid[2]) == (30, 6)
    car = truth.objects[1].T_world_object
    motion = np.diff(car[:, :3, 3], axis=0)
    heading = motion / np.linalg.norm(motion, axis=1, keepdims=True)
    # R_y(ry + π/2) turns the car's z axis to where it drives.
    assert np.all(np.sum(heading * car[:-1, :3, 2], axis=1) > 0.99)
    frame = sequence.frame(15)
    T_camera_car = se3.inverse(truth.T_world_camera[15]) @ car[15]
    xyz = T_camera_car[:3, 3] - [0.0, 0.7, 0.0]     # the row is the bottom of the box
    i = sequence.intrinsics
    u, v = int(i.fx * xyz[0] / xyz[2] + i.cx), int(i.fy * xyz[1] / xyz[2] + i.cy)
    assert frame.instance_id[v, u] == 1
    assert abs(frame.depth_m[v, u] - xyz[2]) < 3.0   # the near side of a car of 4 m


def test_kitti_odometry():
    sequence = open_sequence(DATA / "kitti_odometry_06")
    assert len(sequence) == 25
    assert sequence.intrinsics.baseline_m == pytest.approx(0.53715, abs=1e-5)
    frame = sequence.frame(24)
    assert frame.right.shape == frame.rgb.shape == (370, 1226, 3)
    # The right camera sees the same scene shifted to the left.
    a, b = (x[150:250, 400:900, 0].astype(float) for x in (frame.rgb, frame.right))
    gaps = {s: np.abs(a[:, 40:460] - b[:, 40 - s:460 - s]).mean() for s in range(-40, 41)}
    assert min(gaps, key=gaps.__getitem__) > 0


@pytest.mark.parametrize(("name", "frames"), [("tum_fr1_rpy", 60),
                                              ("tum_fr3_structure_notexture_far", 49)])
def test_tum(name, frames):
    sequence = open_sequence(DATA / name)
    assert len(sequence) == frames
    assert sequence.truth.trajectories.camera_valid.all()
    frame = sequence.frame(frames - 1)
    assert 0.3 < np.median(frame.depth_m[frame.depth_m > 0]) < 6.0
    T = sequence.truth.trajectories.T_world_camera
    R = T[:, :3, :3]
    assert_allclose(np.swapaxes(R, 1, 2) @ R, np.tile(np.eye(3), (frames, 1, 1)), atol=1e-12)
