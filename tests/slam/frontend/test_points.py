"""Corners stand where they may and where there is texture."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from slam.frontend.points import PointConfig, corner_response, detect_points
from wave_pictures import picture

SIZE = (160, 200)


def objects():
    labels = np.zeros(SIZE, np.int32)
    labels[40:90, 50:110] = 7
    labels[100:140, 120:180] = 300
    return labels


def distance_to(mask):
    return cv2.distanceTransform(np.where(mask, 0, 1).astype(np.uint8), cv2.DIST_C, 3)


def test_points_are_spread_one_per_cell():
    config = PointConfig()
    uv, response = detect_points(corner_response(picture()), 10_000, config=config)
    cells = np.unique(uv.astype(int) // config.static_cell_px, axis=0)
    assert len(cells) == len(uv) == len(response)
    assert len(uv) > 0.7 * (SIZE[0] // config.static_cell_px) * (SIZE[1] // config.static_cell_px)
    assert (response >= config.min_eigenvalue).all()


def test_count_keeps_the_strongest():
    _, response = detect_points(corner_response(picture()), 10_000)
    fewer, best = detect_points(corner_response(picture()), 20)
    assert len(fewer) == 20
    np.testing.assert_allclose(np.sort(best), np.sort(response)[-20:])


def test_objects_are_denser_and_borders_are_kept_off():
    labels, config = objects(), PointConfig()
    uv, _ = detect_points(corner_response(picture()), 10_000, labels, config=config)
    at = uv.astype(int)
    label = labels[at[:, 1], at[:, 0]]
    per_pixel = {each: (label == each).sum() / (labels == each).sum() for each in (0, 7, 300)}
    assert per_pixel[7] > 2 * per_pixel[0]
    assert per_pixel[300] > 2 * per_pixel[0]
    for each in (0, 7, 300):
        off_border = distance_to(labels != each)[at[:, 1], at[:, 0]]
        assert (off_border[label == each] > config.mask_margin_px).all()
    b = config.border_margin_px
    assert (uv >= b).all()
    assert (uv[:, 0] < SIZE[1] - b).all()
    assert (uv[:, 1] < SIZE[0] - b).all()


def test_each_object_has_its_own_quota():
    config = replace(PointConfig(), object_count=5)
    labels = objects()
    uv, _ = detect_points(corner_response(picture()), 0, labels, config=config)
    label = labels[uv[:, 1].astype(int), uv[:, 0].astype(int)]
    assert {each: int((label == each).sum()) for each in (0, 7, 300)} == {0: 0, 7: 5, 300: 5}


def test_living_tracks_are_kept_off():
    first, _ = detect_points(corner_response(picture()), 10_000)
    far_away = np.array([[np.nan, 4.0], [1e7, -3.0]])
    second, _ = detect_points(corner_response(picture()), 10_000,
                              existing_uv=np.concatenate([first, far_away]))
    gap = np.abs(second[:, None] - first[None]).max(axis=-1).min(axis=1)
    assert len(second) > 0
    assert (gap > PointConfig().track_margin_px).all()


@pytest.mark.parametrize("grey", [0, 255])
def test_an_image_without_texture_gives_nothing(grey):
    uv, response = detect_points(corner_response(np.full(SIZE, grey, np.uint8)), 500, objects())
    assert uv.shape == (0, 2)
    assert response.shape == (0,)
