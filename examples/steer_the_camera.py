"""A SLAM system inside a Gymnasium environment: an agent moves the camera, rewarded for low error.

The environment adds the action, a twist in [-1, 1]^6, to the scene's own camera path; zeros follow
the path. Here the camera is shaken on it, and the mean error says what that costs a system that
finds the optical flow in the images.
"""

import argparse
from dataclasses import replace

import gymnasium
import numpy as np

import slam
from simbench.wrappers import ScoreSlam


class FromImages:
    """sdpl, without the exact flow that the environment observes."""

    def __init__(self, intrinsics):
        self.system = slam.make("sdpl", intrinsics)

    def process(self, frame):
        return self.system.process(replace(frame, flow=None))

    def finish(self):
        return self.system.finish()


def mean_error_m(frames: int, shaking: float) -> float:
    """Mean translation error of a frame's motion, in metres.

    Args:
        shaking: standard deviation of the twist that is added, as a share of the largest one.
    """
    env = ScoreSlam(gymnasium.make("simbench:simbench/SwingingBoxes-v0", frames=frames,
                                   size=(320, 240), sensor="kinect"), FromImages)
    hand = np.random.default_rng(0)
    env.reset(seed=0)
    errors, truncated = [], False
    while not truncated:
        twist = np.clip(shaking * hand.normal(size=6), -1, 1).astype(np.float32)
        *_, truncated, info = env.step(twist)
        errors.append(info["score"]["E_t"])
    env.close()
    return float(np.mean(errors))


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=30)
    frames = parser.parse_args(arguments).frames
    for shaking in (0.0, 1.0):
        print(f"shaking {shaking:.1f}: camera E_t {1e3 * mean_error_m(frames, shaking):.3f} mm")


if __name__ == "__main__":
    main()
