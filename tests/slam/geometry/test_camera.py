import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from numerics import numerical_jacobian
from slam.geometry import camera as pinhole
from slam.types import Intrinsics
from strategies import cameras, points_in_front

CAMERA = Intrinsics(fx=500.0, fy=400.0, cx=319.5, cy=239.5, width=640, height=480)


@given(cameras(), points_in_front())
def test_projection_is_the_calibration_matrix_and_a_division(camera, xyz):
    homogeneous = xyz @ camera.matrix.T
    assert_allclose(pinhole.project(camera, xyz), homogeneous[:, :2] / homogeneous[:, 2:],
                    rtol=1e-12, atol=1e-9)


def test_image_axes_are_right_and_down():
    """OpenCV's camera axes: what lies to the right has a larger u, what lies below a larger v."""
    assert_allclose(pinhole.project(CAMERA, [[0, 0, 2.0], [0.2, 0, 2.0], [0, 0.2, 2.0]]),
                    [[319.5, 239.5], [369.5, 239.5], [319.5, 279.5]])


@given(cameras(), points_in_front())
def test_back_projection_inverts_projection(camera, xyz):
    uv = pinhole.project(camera, xyz)
    assert_allclose(pinhole.back_project(camera, uv, xyz[:, 2]), xyz, rtol=1e-12, atol=1e-11)
    assert_allclose(pinhole.rays(camera, uv), xyz / xyz[:, 2:], rtol=1e-12, atol=1e-11)


@given(cameras(), points_in_front(1))
def test_projection_jacobian(camera, xyz):
    depth = xyz[0, 2]
    numeric = numerical_jacobian(lambda p: pinhole.project(camera, p), at=xyz[0], step=1e-5 * depth)
    analytic = pinhole.project_jacobian(camera, xyz)[0]
    assert_allclose(analytic, numeric, atol=1e-7 * camera.fx / depth)


@given(st.sampled_from([0.0, -1e-9, -3.0]))
def test_what_is_not_in_front_has_no_image(z):
    assert np.isnan(pinhole.project(CAMERA, [0.1, 0.2, z])).all()


def test_one_point_or_many():
    xyz = np.array([0.3, -0.2, 2.0])
    assert pinhole.project(CAMERA, xyz).shape == (2,)
    assert pinhole.project(CAMERA, np.tile(xyz, (4, 5, 1))).shape == (4, 5, 2)
    assert pinhole.project_jacobian(CAMERA, np.tile(xyz, (4, 5, 1))).shape == (4, 5, 2, 3)
    assert pinhole.back_project(CAMERA, np.zeros((4, 5, 2)), np.ones((4, 5))).shape == (4, 5, 3)
