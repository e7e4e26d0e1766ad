"""Where should the camera look? A scripted policy against the fixed path, over seeds.

    python examples/active_camera.py --seeds 10

Nothing is learnt here. The policy turns the camera to where unmoving things are near and have
structure, which is where a depth camera measures well and flow can be followed. Both ways get the
same worlds; the table shows the change of the error in pairs, with its 95 % interval.
"""

from __future__ import annotations

import argparse

import cv2
import gymnasium
import numpy as np
from scipy.stats import bootstrap

import simbench  # noqa: F401 (registers the environments)
import slam
from simbench.wrappers import ActiveCamera

CELLS = (6, 8)          # rows and columns in which the picture is judged
EAGERNESS = 2.0         # share of the full turning speed per half picture of offset


def fixed(observation: dict[str, np.ndarray]) -> np.ndarray:
    """The scripted path as it is."""
    return np.zeros(2, np.float32)


def towards_near_structure(observation: dict[str, np.ndarray]) -> np.ndarray:
    """Tilt and pan towards the middle of what is near, structured and not masked."""
    grey = cv2.cvtColor(observation["rgb"], cv2.COLOR_RGB2GRAY).astype(np.float32)
    slope = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
    depth_m = observation["depth"]
    useful = (observation["instance"] == 0) & (depth_m > 0)
    worth = np.where(useful, np.minimum(slope, 100.0) / np.maximum(depth_m, 0.5) ** 2, 0.0)
    rows, columns = CELLS
    cell = cv2.resize(worth, (columns, rows), interpolation=cv2.INTER_AREA) + 1e-9
    share = cell / cell.sum()
    down = float(np.sum(share * np.linspace(-1, 1, rows)[:, None]))
    right = float(np.sum(share * np.linspace(-1, 1, columns)))
    return np.clip(EAGERNESS * np.array([-down, right]), -1.0, 1.0).astype(np.float32)


def episode(env: ActiveCamera, policy, seed: int) -> tuple[float, float, float]:
    """Mean E_t (mm) and E_R (degrees) of the camera, and the share of frames tracked."""
    observation, info = env.reset(seed=seed)
    scores, over = [], False
    while not over:
        observation, _, terminated, truncated, info = env.step(policy(observation))
        scores.append(info["score"])
        over = terminated or truncated
    return (1e3 * float(np.mean([s["E_t"] for s in scores])),
            float(np.mean([s["E_R"] for s in scores])),
            float(np.mean([s["tracked"] for s in scores])))


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--scene", default="SwingingBoxes-v0")
    parser.add_argument("--system", default="vdo")
    chosen = parser.parse_args(arguments)
    env = ActiveCamera(gymnasium.make(
        f"simbench/{chosen.scene}", frames=chosen.frames, sensor="kinect", size=(320, 240)),
        lambda intrinsics: slam.make(chosen.system, intrinsics))
    table = np.array([[episode(env, policy, seed) for policy in (fixed, towards_near_structure)]
                      for seed in range(chosen.seeds)])
    env.close()
    print("| seed | fixed E_t mm | active E_t mm | fixed E_R ° | active E_R ° |")
    print("|---|---|---|---|---|")
    for seed, ((a_t, a_R, _), (b_t, b_R, _)) in enumerate(table):
        print(f"| {seed} | {a_t:.2f} | {b_t:.2f} | {a_R:.4f} | {b_R:.4f} |")
    for name, column in (("E_t", 0), ("E_R", 1)):
        ratio = np.log(table[:, 1, column] / table[:, 0, column])
        interval = bootstrap((ratio,), np.mean, random_state=0).confidence_interval
        middle, low, high = (100 * (np.exp(x) - 1) for x in (ratio.mean(), *interval))
        print(f"{name}: {middle:+.0f} % [{low:+.0f}, {high:+.0f}] against the fixed path")
    print(f"tracked: fixed {table[:, 0, 2].mean():.3f}, active {table[:, 1, 2].mean():.3f}")


if __name__ == "__main__":
    main()
