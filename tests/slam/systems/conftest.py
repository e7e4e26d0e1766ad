"""Small ray-cast sequences that several tests share."""

import pytest

import box_world as bw

FRAMES = 10


@pytest.fixture(scope="session")
def two_boxes():
    """Camera poses, boxes (3 moves and turns, 5 stands), frames with exact flow."""
    camera = bw.hand_held(FRAMES)
    boxes = {3: bw.Box((0.45, 0.35, 0.4), bw.moving(-0.9, 0.1, 0.2, FRAMES, (0.05, 0.0, 0.02),
                                                    (0.0, 0.03, 0.01))),
             5: bw.Box((0.4, 0.5, 0.4), bw.standing(1.0, 0.4, 0.5, FRAMES))}
    return camera, boxes, bw.sequence(camera, boxes)
