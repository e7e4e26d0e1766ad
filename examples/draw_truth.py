"""Exact truth of a simulated frame, drawn on it: flow, what it hides, and the visible 3D edges.

Arrows lead to where a pixel is in a later frame; pixels that will be hidden there are red, those
that will have left the image blue; green lines are edges of the scene, cut where something stands
before them.
"""

import argparse

import cv2
import numpy as np

from simbench.render import make_renderer
from simbench.simulate import SimulatedSequence
from simbench.world import make_world

STEP_PX = 24         # between arrows
AHEAD = 6            # frames


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="SwingingBoxes-v0")
    parser.add_argument("--out", default="truth.png")
    asked = parser.parse_args(arguments)

    world = make_world(asked.scene, seed=0)
    renderer = make_renderer("mujoco", world)
    sequence = SimulatedSequence(world, renderer, AHEAD + 1)
    picture = sequence.frame(0).rgb[..., ::-1].copy()
    flow, edges = sequence.truth.flow(0, AHEAD), sequence.truth.edges(0)
    picture[flow.occluded] = (0, 0, 255)
    picture[flow.leaving] = (255, 0, 0)
    for start, end in np.rint(edges.endpoints_px).astype(int):
        cv2.line(picture, start, end, (0, 255, 0), 1, cv2.LINE_AA)
    for v in range(STEP_PX // 2, picture.shape[0], STEP_PX):
        for u in range(STEP_PX // 2, picture.shape[1], STEP_PX):
            if flow.valid[v, u]:
                there = np.rint([u, v] + flow.flow_px[v, u]).astype(int)
                cv2.arrowedLine(picture, (u, v), there, (0, 255, 255), 1, cv2.LINE_AA)
    cv2.imwrite(asked.out, picture)
    print(f"{asked.out}: {len(edges.endpoints_px)} visible edges, "
          f"{100 * flow.occluded.mean():.1f} % will be hidden, "
          f"{100 * flow.leaving.mean():.1f} % will have left")
    renderer.close()


if __name__ == "__main__":
    main()
