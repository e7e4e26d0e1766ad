"""Lines in the batches: what they add, and degenerate ones."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from point_world import CAMERA, odometry, position_rms, stream, world
from slam.backend.atlas import Atlas
from slam.backend.bundle import bundle
from slam.backend.config import BundleConfig, WindowConfig
from slam.backend.refine_run import spread_out
from slam.backend.window import SlidingWindow
from slam.geometry import camera as pinhole
from slam.geometry import line
from slam.line_sightings import packed
from slam.map import LineObservations, MapRecord
from slam.tables import taken

PX, RHO = 0.05, 0.001
FORMS = ["well_conditioned", "paper"]        # of eq. (5)


def lines_of(T, seed, count=25, noise=1.0, rho_sigma=RHO):
    """Lines (L, 10) around the points' place, and their sightings in every frame."""
    rng = np.random.default_rng(seed)
    A = rng.uniform([-1.5, -1.0, 3.5], [1.5, 1.0, 6.0], (count, 3))
    B = A + rng.normal(size=(count, 3)) * [0.8, 0.8, 0.3]
    frame = np.tile(np.arange(len(T)), count)
    number = np.repeat(np.arange(count), len(T))
    ends, rho = [], []
    for P in (A, B):
        p = np.einsum("mji,mj->mi", T[frame][:, :3, :3], P[number] - T[frame][:, :3, 3])
        ends.append(pinhole.project(CAMERA, p))
        rho.append(1.0 / p[:, 2])
    ends, rho = np.stack(ends, axis=1), np.stack(rho, axis=1)
    along = ends[:, 1] - ends[:, 0]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    m = len(frame)
    ends = ends + rng.normal(size=(m, 2, 1)) * PX * noise * normal[:, None]
    ends = ends + rng.normal(size=(m, 2, 1)) * 5.0 * noise * (along / np.linalg.norm(
        along, axis=1, keepdims=True))[:, None]       # ends slide along: that must not matter
    seen = LineObservations(number, frame, ends, np.broadcast_to(np.eye(2) * PX**2, (m, 2, 2)),
                            rho + rng.normal(size=(m, 2)) * rho_sigma * noise,
                            np.full((m, 2), rho_sigma))
    return packed(line.orthonormal_from_plucker(line.plucker_from_points(A, B))), seen


# A length weighs all directions alike: as printed, lines help where depth is nearly as sharp as px.
@pytest.mark.parametrize(("form", "rho_sigma", "left"), [("well_conditioned", RHO, 0.5),
                                                         ("paper", 0.1 * RHO, 0.9)])
def test_lines_alone_take_drift_away(form, rho_sigma, left):
    config = BundleConfig(line_form=form)
    ratios = []
    for seed in range(3):
        T, _, s = world(seed)
        none = taken(s, np.zeros(0, np.int64))
        lines, seen = lines_of(T, seed, rho_sigma=rho_sigma)
        path = odometry(T, seed)
        got = bundle(path, np.zeros((0, 3)), none, CAMERA, config, lines, seen)
        assert got.objective < got.objective_before
        ratios.append(position_rms(got.T_body_camera, T) / position_rms(path.T_body_camera, T))
    assert np.mean(ratios) < left


def test_few_points_gain_by_lines():
    gains = []
    for seed in range(4):
        T, xyz, s = world(seed, landmarks=8)
        lines, seen = lines_of(T, seed)
        path = odometry(T, seed)
        without = bundle(path, xyz, s, CAMERA, BundleConfig())
        both = bundle(path, xyz, s, CAMERA, BundleConfig(), lines, seen)
        gains.append(position_rms(both.T_body_camera, T) / position_rms(without.T_body_camera, T))
    assert np.mean(gains) < 0.8


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("case", ["parallel", "end on", "through the origin", "no length",
                                  "no depth", "none"])
def test_degenerate_lines_do_no_harm(case, form):
    T, xyz, s = world(0)
    lines, seen = lines_of(T, 0)
    path = odometry(T, 0)
    if case == "parallel":                        # all the same way: nothing holds along it
        A = np.random.default_rng(0).uniform([-1, -1, 4], [1, 1, 6], (25, 3))
        lines = packed(line.orthonormal_from_plucker(line.plucker_from_points(A, A + np.eye(3)[0])))
    elif case == "end on":                        # each line runs through the first camera
        A = np.random.default_rng(0).uniform([-1, -1, 4], [1, 1, 6], (25, 3))
        lines = packed(line.orthonormal_from_plucker(line.plucker_from_points(A, 2.0 * A)))
    elif case == "through the origin":            # of the body: polar coordinates at their pole
        lines = np.array(lines)
        lines[:, 9] = np.pi / 2
    elif case == "no length":
        seen = replace(seen, ends_px=np.repeat(seen.ends_px[:, :1], 2, axis=1))
    elif case == "no depth":
        none = np.zeros((len(seen), 2))
        seen = replace(seen, rho=none, rho_sigma=none + np.inf)
    elif case == "none":
        lines = np.zeros((0, 10))
        seen = taken(seen, np.zeros(0, np.int64))
    got = bundle(path, xyz, s, CAMERA, BundleConfig(line_form=form), lines, seen)
    assert got.objective <= got.objective_before
    assert np.isfinite(got.T_body_camera).all()
    assert np.isfinite(got.lines_body).all()
    assert position_rms(got.T_body_camera, T) < position_rms(path.T_body_camera, T) + 1e-3


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("spoil", [False, True])
def test_the_window_holds_lines_that_leave_it(spoil, form):
    T, _, _ = world(1, frames=24)
    lines, seen = lines_of(T, 1)
    path = odometry(T, 1)
    window = SlidingWindow(CAMERA, WindowConfig(), BundleConfig(line_form=form), MapRecord())

    def given(row, now):
        if row == 0:                              # as anchors say it: noise not known yet
            now = replace(now, covariance=np.full((len(now), 2, 2), np.nan))
        if spoil and 10 <= row < 13:
            now = replace(now, ends_px=now.ends_px * np.nan)
        return now

    online = stream(T, path, window, lines=(lines, seen), spoil=given)
    assert np.isfinite(online).all()
    assert np.isfinite(window.lines.alive.place).all()
    assert (window.lines.alive.information[:, 0, 0] > 0).any()
    limit = 0.6 if form == "well_conditioned" else 2.0       # no gain as printed, and no jump
    assert position_rms(online, T) < limit * position_rms(path.T_body_camera, T)


def test_an_atlas_gives_back_what_was_put_in_and_uses_its_slots_again():
    rng = np.random.default_rng(0)
    image = rng.normal(size=(60, 80)).astype(np.float32)
    uv = rng.uniform([10, 10], [68, 48], (40, 2))
    atlas = Atlas(3)
    slots = atlas.put(image, uv)
    at = atlas.positions(slots, uv)
    whole, there = np.floor(uv).astype(int), np.floor(at).astype(int)
    assert_allclose(at - there, uv - whole, atol=1e-12)
    for (u, v), (x, y) in zip(whole, there, strict=True):
        assert_allclose(atlas.image[y - 4:y + 6, x - 4:x + 6], image[v - 4:v + 6, u - 4:u + 6])
    size = atlas.image.shape
    for _ in range(50):
        atlas.release(slots)
        slots = atlas.put(image, uv)
    assert atlas.image.shape == size
    assert len(np.unique(slots)) == 40


def test_long_tracks_are_thinned_evenly():
    landmark = np.repeat([0, 1, 2], [5, 200, 1])
    kept = spread_out(np.array([5, 200, 1]), landmark, 60)
    assert np.bincount(landmark[kept]).tolist() == [5, 60, 1]
    assert np.diff(np.flatnonzero(kept[5:205])).max() <= 4
