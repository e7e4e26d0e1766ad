"""Flow noise: its σ, its tail, its following of the image, and how it adds up along tracks."""

import cv2
import numpy as np
import pytest

from simbench.errors import UserError
from simbench.sensors import FlowNoise, draw_noise, flow_noise
from simbench.sensors.structure import structure_sigmas
from simbench.types import FlowTruth

H, W = 240, 320


def flow_truth(du: float = 0.0, dv: float = 0.0, occluded: np.ndarray | None = None) -> FlowTruth:
    none = np.zeros((H, W), bool)
    flow = np.full((H, W, 2), (du, dv), np.float32)
    u, v = np.arange(W) + du, np.arange(H)[:, None] + dv
    leaving = np.broadcast_to((u < -0.5) | (u >= W - 0.5) | (v < -0.5) | (v >= H - 0.5), (H, W))
    return FlowTruth(flow, np.zeros((H, W, 3), np.float32), ~none,
                     none if occluded is None else occluded, leaving, none)


def noisy(truth, noise, seed=0, frame=1, rgb_source=None, rgb_target=None):
    if noise.kind == "pairwise":
        return flow_noise(truth, noise, seed, frame,
                          draw_noise(noise, seed, frame, (H, W), rgb_source))
    return flow_noise(truth, noise, seed, frame,
                      draw_noise(noise, seed, frame - 1, (H, W), rgb_source),
                      draw_noise(noise, seed, frame, (H, W), rgb_target))


@pytest.mark.parametrize("kind", ["pairwise", "localisation"])
@pytest.mark.parametrize("correlation_px", [0.0, 2.0])
def test_sigma_is_that_of_the_flow_in_both_kinds(kind, correlation_px):
    noise = FlowNoise(sigma_px=0.3, kind=kind, correlation_px=correlation_px)
    truth = flow_truth(12.4, -7.7)
    error = np.stack([noisy(truth, noise, seed).flow_px - truth.flow_px for seed in range(6)])
    assert error.std() == pytest.approx(0.3, rel=0.02 if correlation_px == 0 else 0.05)
    assert abs(error.mean()) < 0.02
    assert abs(np.mean(error[..., 0] * error[..., 1])) < 0.05 * 0.3**2
    np.testing.assert_allclose(noisy(truth, noise).sigma_px, 0.3, rtol=1e-5)


def test_localisation_noise_telescopes_along_a_chained_track():
    """The summed flow errs by n_K − n_0 alone, however long the track; pairwise errors add up."""
    steps = [(5, 2), (-3, 4), (6, -1), (2, 2), (-4, 3), (3, 3), (1, -4), (2, 5)]
    errors = {}
    for kind in ("localisation", "pairwise"):
        noise = FlowNoise(sigma_px=0.5, kind=kind)
        v, u = np.mgrid[60:160, 60:240]
        total = np.zeros((*u.shape, 2))
        for k, (du, dv) in enumerate(steps, start=1):
            field = noisy(flow_truth(du, dv), noise, frame=k)
            total += field.flow_px[v, u] - (du, dv)
            u, v = u + du, v + dv
        errors[kind] = total
    noise = FlowNoise(sigma_px=0.5, kind="localisation")
    first = draw_noise(noise, 0, 0, (H, W)).offset_px[60:160, 60:240]
    last = draw_noise(noise, 0, len(steps), (H, W)).offset_px[v, u]
    np.testing.assert_allclose(errors["localisation"], last - first, atol=1e-5)
    assert errors["localisation"].std() == pytest.approx(0.5, rel=0.03)
    assert errors["pairwise"].std() == pytest.approx(0.5 * np.sqrt(len(steps)), rel=0.03)


def test_smooth_localisation_noise_telescopes_between_pixels_too():
    """A tracker reads the field where it believes to be, a fraction of a pixel beside."""
    noise = FlowNoise(sigma_px=0.2, kind="localisation", correlation_px=4.0)
    v, u = (a.astype(np.float32) for a in np.mgrid[60:160, 60:240])
    start = np.stack([u, v], -1)
    seen = start.copy()
    for k in range(1, 7):
        flow = noisy(flow_truth(3.3, 1.6), noise, frame=k).flow_px
        seen += cv2.remap(flow, seen[..., 0], seen[..., 1], cv2.INTER_LINEAR)
    error = seen - start - 6 * np.array([3.3, 1.6])
    assert error.std() == pytest.approx(0.2, rel=0.25)


def test_structure_noise_is_large_along_an_edge_and_small_at_a_corner():
    rgb = np.full((H, W, 3), 60, np.uint8)
    rgb[:, 100:] = 180                                  # a vertical edge
    rng = np.random.default_rng(0)
    rgb[150:, 180:300] = rng.integers(0, 255, (H - 150, 120, 1), dtype=np.uint8)   # texture
    rgb = cv2.GaussianBlur(rgb, (0, 0), 1.0)
    noise = FlowNoise(sigma_px=0.1, shape="structure")
    truth = flow_truth()
    error = np.stack([noisy(truth, noise, seed, rgb_source=rgb).flow_px for seed in range(40)])
    across_edge, along_edge = error[:, 20:100, 100, 0], error[:, 20:100, 100, 1]
    assert across_edge.std() == pytest.approx(0.1, rel=0.1)
    assert along_edge.std() == pytest.approx(0.1 * noise.structure_cap, rel=0.1)
    assert error[:, 180:220, 210:270].std() == pytest.approx(0.1, rel=0.2)
    assert error[:, 20:100, 200:290].std() == pytest.approx(0.1 * noise.structure_cap, rel=0.05)
    sigma = noisy(truth, noise, rgb_source=rgb).sigma_px
    rms = np.sqrt(np.mean(error**2, axis=(0, -1)))
    np.testing.assert_allclose(rms[::40, ::40], sigma[::40, ::40], rtol=0.35)


def test_structure_turns_with_the_image():
    """Along a diagonal edge the noise lies on the diagonal."""
    v, u = np.mgrid[:H, :W]
    rgb = np.repeat((np.clip(u - v, -10, 10) * 8 + 128).astype(np.uint8)[..., None], 3, -1)
    noise = FlowNoise(sigma_px=0.1, shape="structure")
    error = np.stack([noisy(flow_truth(), noise, seed, rgb_source=rgb).flow_px[100, 100]
                      for seed in range(200)])
    along, across = error @ [1, 1] / np.sqrt(2), error @ [1, -1] / np.sqrt(2)
    assert along.std() > 10 * across.std()


def test_structure_sigmas_never_leave_their_bounds():
    rgb = np.random.default_rng(1).integers(0, 255, (H, W, 3), dtype=np.uint8)
    along, across, axis = structure_sigmas(rgb, 2.0, 8.0, 20.0)
    assert along.min() >= 1.0
    assert across.max() <= 20.0 * (1 + 1e-5)
    assert (across >= along).all()
    np.testing.assert_allclose(np.linalg.norm(axis, axis=-1), 1.0, atol=1e-4)


def test_occluded_pixels_have_a_heavier_tail():
    occluded = np.zeros((H, W), bool)
    occluded[:120] = True
    noise = FlowNoise(sigma_px=0.3)
    truth = flow_truth(occluded=occluded)
    field = noisy(truth, noise)
    error = field.flow_px - truth.flow_px
    assert error[~occluded].std() == pytest.approx(0.3, rel=0.03)
    assert error[occluded].std() == pytest.approx(0.3 * np.sqrt(0.5 * 100 + 0.5), rel=0.03)
    kurtosis = np.mean(error[occluded] ** 4) / np.mean(error[occluded] ** 2) ** 2
    assert kurtosis > 5.0
    np.testing.assert_allclose(field.sigma_px, 0.3, rtol=1e-6)   # occlusion is not given away


def test_leaving_pixels_are_not_valid_and_truth_stays_as_it_is():
    truth = flow_truth(40.0, 0.0)
    before = truth.flow_px.copy()
    field = noisy(truth, FlowNoise(kind="localisation"))
    np.testing.assert_array_equal(field.valid, np.broadcast_to(np.arange(W) < W - 40, (H, W)))
    np.testing.assert_array_equal(truth.flow_px, before)
    assert not truth.flow_px.flags.writeable
    assert np.isfinite(field.flow_px).all()


@pytest.mark.parametrize("kind", ["pairwise", "localisation"])
def test_equal_seeds_give_equal_bytes(kind):
    noise = FlowNoise(kind=kind)
    first, again, other = (noisy(flow_truth(1.5), noise, seed).flow_px for seed in (1, 1, 2))
    assert first.tobytes() == again.tobytes()
    assert first.tobytes() != other.tobytes()


@pytest.mark.parametrize("wrong", [{"kind": "often"}, {"shape": "round"}, {"sigma_px": -1.0},
                                   {"sigma_px": float("nan")}])
def test_wrong_settings_are_named(wrong):
    with pytest.raises(UserError, match=next(iter(wrong))):
        FlowNoise(**wrong)


def test_structure_without_an_image_is_refused():
    with pytest.raises(UserError, match="image"):
        draw_noise(FlowNoise(shape="structure"), 0, 1, (H, W))
