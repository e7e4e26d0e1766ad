"""Do the covariances of aligned patches match their errors, and do neighbours err alike?

    python scripts/measure_alignment.py --seeds 0 1 2

Corners of the static world are aligned from frame to frame, beginning at the truth. Printed: χ² of
their errors over its two degrees of freedom (1 is right; the median over that of χ²₂); the part of
the errors that all corners of a pair of frames have in common; and how errors, in standard
deviations, hang together over the distance between two corners.
"""

from __future__ import annotations

import argparse

import numpy as np

from simbench.inputs import Feed, InputChoice
from simbench.render import make_renderer
from simbench.simulate import SimulatedSequence
from simbench.world import make_world
from slam.backend.anchors import carried
from slam.frontend.observe import observe
from slam.frontend.points import corner_response, detect_points
from slam.frontend.refine import RefineConfig, prepare_image, refine_matches
from slam.frontend.support import surface_image
from slam.frontend.surface import fit_surfaces
from slam.geometry import se3
from slam.geometry.arrays import Array

RINGS_PX = (0, 11, 16, 24, 40, 80, 160, 1000)
_MEDIAN_CHI2_2 = 1.3863


def errors(scene: str, seed: int, frames: int, texture: float, without_ramps: bool
           ) -> list[tuple[Array, Array, Array]]:
    """Of each pair of frames: corners (N, 2) px, their errors (N, 2) px, covariances (N, 2, 2)."""
    world = make_world(scene, seed, {"texture": texture})
    renderer = make_renderer("mujoco", world)
    sequence = SimulatedSequence(world, renderer, frames)
    feed = Feed(sequence, InputChoice(flow="dis", masks="truth", depth="sensor",
                                      sensor="gaussian"), seed)
    config, out = RefineConfig(without_ramps=without_ramps), []
    for k in range(frames - 1):
        a, b = (observe(feed.frame(i)) for i in (k, k + 1))
        uv, _ = detect_points(corner_response(a.gray), 600, np.asarray(a.label_index, np.int32),
                              np.zeros((0, 2)))
        column, row = np.rint(uv).astype(int).T
        flow, truth = sequence.truth.flow(k, k + 1), sequence.truth.frame(k)
        still = (a.label_index[row, column] == 0) & (truth.part_id[row, column] == 0)
        uv = uv[still]
        X = sequence.truth.trajectories.T_world_camera
        plane = fit_surfaces(np.where(truth.depth_m > 0, 1.0 / np.maximum(truth.depth_m, 1e-6), 0.0
                                      ).astype(np.float32), a.label_index, uv, 1e-4)
        T_b_a = np.broadcast_to(se3.inverse(X[k + 1]) @ X[k], (len(uv), 4, 4))
        true, _, warp = carried(sequence.intrinsics, uv, plane.rho, plane.slope, T_b_a)
        column, row = np.rint(uv).astype(int).T
        near = np.rint(true).astype(int)
        seen = ((plane.rho > 0) & ~flow.occluded[row, column]
                & (near >= 0).all(axis=1) & (near < [b.gray.shape[1], b.gray.shape[0]]).all(axis=1))
        uv, true, warp = uv[seen], true[seen], warp[seen]
        found = refine_matches(prepare_image(a.gray, config), prepare_image(b.gray, config), uv,
                               true, config, warp, surface_image(a.frame.depth_m, a.label_index))
        good = found.converged
        out.append((uv[good], (found.uv_current - true)[good], found.covariance[good]))
    renderer.close()
    return out


def report(pairs: list[tuple[Array, Array, Array]]) -> None:
    """Print what the errors of all pairs of frames tell."""
    white = [(np.linalg.inv(np.linalg.cholesky(P)) @ e[:, :, None])[:, :, 0] for _, e, P in pairs]
    chi2 = np.concatenate([np.sum(w**2, axis=1) for w in white])
    # Gross errors are the kernel's business.
    kept = [np.sum(w**2, axis=1) < 25.0 for w in white]
    common = np.array([np.median(e[k], axis=0) for (_, e, _), k in zip(pairs, kept, strict=True)])
    spread = np.concatenate([e[k] for (_, e, _), k in zip(pairs, kept, strict=True)])
    print(f"{len(chi2)} corners: chi2/2 {chi2[chi2 < 25.0].mean() / 2:.2f}, by the median "
          f"{np.median(chi2) / _MEDIAN_CHI2_2:.2f}, above 25: {np.mean(chi2 >= 25.0):.3f}; RMS "
          f"{np.sqrt(np.mean(spread**2)):.4f} px, in common "
          f"{np.sqrt(np.mean(common**2)):.4f} px")
    total, count = np.zeros(len(RINGS_PX) - 1), np.zeros(len(RINGS_PX) - 1)
    for (uv, _, _), w, k in zip(pairs, white, kept, strict=True):
        at, own = uv[k], w[k]
        i, j = np.triu_indices(len(at), 1)
        ring = np.digitize(np.linalg.norm(at[i] - at[j], axis=1), RINGS_PX) - 1
        total += np.bincount(ring, 0.5 * np.sum(own[i] * own[j], axis=1), len(total))[:len(total)]
        count += np.bincount(ring, minlength=len(total))[:len(total)]
    size = np.mean(np.concatenate([w[k] for w, k in zip(white, kept, strict=True)]) ** 2)
    for low, high, t, n in zip(RINGS_PX[:-1], RINGS_PX[1:], total, count, strict=True):
        print(f"  {low:4d} to {high:4d} px apart: correlation {t / max(n, 1) / size:+.3f} of "
              f"{int(n)} pairs")


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="SwingingBoxes-v0")
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--texture", type=float, default=1.0)
    chosen = parser.parse_args()
    for blind in (False, True):
        print("blind to ramps of brightness:" if blind else "as the tracker aligns:")
        report([pair for seed in chosen.seeds
                for pair in errors(chosen.scene, seed, chosen.frames, chosen.texture, blind)])


if __name__ == "__main__":
    main()
