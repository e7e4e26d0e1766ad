"""The page: complete, self-contained, well-formed, and drawn by a browser where there is one."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from browser import opened
from simbench.metrics.camera import gauge
from simbench.report.content import ReportContent
from simbench.report.filmstrip import (
    DYNAMIC_LINE,
    OBJECT_POINT,
    STATIC_LINE,
    STATIC_POINT,
    Filmstrip,
    shown_speeds,
    speed_m_s,
)
from simbench.report.map_plot import map_plots, plane_of
from simbench.report.map_view import map_of
from simbench.report.page import render_report
from simbench.report.plots import all_path_plots, error_plots
from simbench.report.table import error_table, shown_number, trajectory_table
from simbench.run import run, score
from simbench.score import Online
from slam.geometry import se3
from slam.types import ClosedLoops, ObjectEstimate, SlamResult, Status
from synthetic import PerturbedTruth, SyntheticFeed, SyntheticSequence, world

TRUTH = world()
P = se3.exp(np.array([0.001, -0.002, 0.0005, 0.003, 0.001, -0.002]))


@pytest.fixture(scope="module")
def content() -> ReportContent:
    film = Filmstrip(len(TRUTH.stamps_s), 3)
    feed = SyntheticFeed(SyntheticSequence(TRUTH, broken=(7,)))
    record = run(PerturbedTruth(TRUTH, P, P), feed, observers=(film,))
    metrics = {"system": "sdpl <b>", "sequence": {"name": "synthetic", "frames": 40,
                                                  "sha256": "ab" * 32}}
    metrics |= score(TRUTH, record)
    online = Online.of(record)
    return ReportContent.of(metrics, record.stamps_s, online.camera, online.motions, online.owner,
                            TRUTH, True, film.pictures, {"seed": 3, "settings": {"a": "<script>"}},
                            record.log)


@pytest.fixture(scope="module")
def page(content: ReportContent) -> str:
    return render_report(content)


class Outline(HTMLParser):
    """Checks that tags close, and collects what a page refers to."""

    VOID = frozenset({"meta", "img", "br", "link", "input", "path", "use", "rect", "circle"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []
        self.images: list[dict] = []
        self.figures = 0
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        named = dict(attrs)
        self.sources += [named[k] for k in ("src", "href", "xlink:href") if k in named]
        if tag == "img" or named.get("role") == "img":
            self.images.append(named)
        self.figures += tag == "figure"
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.open.pop() == tag


def test_the_page_is_well_formed_and_fetches_nothing(page):
    outline = Outline(page)
    assert not outline.open
    assert outline.figures == 3 + 2 + 6   # film; errors; camera and two objects, twice each
    assert all(s.startswith(("data:image/jpeg;base64,", "#")) for s in outline.sources)
    assert not re.search(r"url\((?!#)|@import|<script|<link", page)


def test_the_map_is_drawn_with_lines_and_without(content):
    seen = mapped(content)
    both = map_plots(seen.map)
    assert [plot.title for plot in both] == ["map: points and lines", "map: points alone"]
    assert "2 lines" in both[0].caption
    assert "loops closed (1)" in both[0].caption
    shown = [pixels(plot.svg) for plot in both]
    blue = [np.count_nonzero((image[..., 3] > 200) & (image[..., 2] > image[..., 0] + 90))
            for image in shown]
    assert blue[0] > 200
    assert blue[1] == 0
    page = render_report(seen)
    assert page.count("<h2>Map</h2>") == 1
    outline = Outline(page)
    assert outline.figures == 3 + 2 + 6 + 2
    assert all(s.startswith(("data:image/jpeg;base64,", "data:image/png;base64,", "#"))
               for s in outline.sources)


def test_a_map_stands_in_the_true_world_and_is_seen_along_its_shortest_axis(content):
    seen = mapped(content).map
    S = gauge(content.camera, TRUTH)
    assert np.allclose(seen.points, se3.transform_points(S, POINTS))
    flat = replace(seen, points=seen.points * [5.0, 0.1, 3.0], lines=np.zeros((0, 2, 3)))
    assert plane_of(flat) == (0, 2)
    assert [plot.title for plot in map_plots(flat)] == ["map: points alone"]


def test_without_a_map_none_is_drawn(content, page):
    assert map_plots(content.map) == []
    assert "<h2>Map</h2>" not in page
    none = SlamResult(np.zeros(0), np.zeros((0, 4, 4)), {}, (), np.full((3, 3), np.nan))
    assert map_of(none, content.camera, TRUTH) is None


def test_loops_are_told_with_their_errors(content):
    loops = {"closed": 2, "false": 1, "at": [
        {"frame": 30, "seen_before": 2, "position_m": [0, 0, 0], "error_m": 0.0123,
         "error_deg": 0.5}, {"frame": 39, "seen_before": 3, "position_m": [0, 0, 0]}]}
    page = render_report(replace(content, metrics={**content.metrics, "loops": loops}))
    assert "2, 1 of them false (frame 30 at frame 2&#39;s place, 0.012 m and 0.50° off" in page


POINTS = np.random.default_rng(0).uniform(-2.0, 2.0, (300, 3))
LINES = np.array([[[-1.0, 0.0, 1.0], [1.0, 0.5, 1.0]], [[0.0, -1.0, 1.0], [0.5, 1.0, -1.0]]])


def mapped(content: ReportContent) -> ReportContent:
    """The same run by a system with a map."""
    T = content.camera.T_world_camera
    result = SlamResult(content.stamps_s, T, {}, (Status.TRACKED,) * len(T), POINTS, LINES,
                        loops=ClosedLoops(np.array([30]), np.array([2]), np.eye(4)[None]))
    return replace(content, map=map_of(result, content.camera, TRUTH))


def pixels(svg: str) -> np.ndarray:
    """(H, W, 4) of the picture within a drawing."""
    data = re.search(r"data:image/png;base64,([^\"]+)", svg)
    raw = np.frombuffer(base64.b64decode(data[1]), np.uint8)
    return cv2.cvtColor(cv2.imdecode(raw, cv2.IMREAD_UNCHANGED), cv2.COLOR_BGRA2RGBA
                        ).astype(np.int64)


def test_every_picture_says_in_words_what_it_shows(page):
    for image in Outline(page).images:
        assert len(image.get("alt") or image.get("aria-label")) > 15


def test_text_from_outside_is_escaped(page):
    assert "sdpl &lt;b&gt;" in page
    assert "&lt;script&gt;" in page


def test_the_errors_stand_on_the_page(page, content):
    for cell in (c for row in error_table(content.metrics).rows for c in row):
        assert cell.replace("<", "&lt;") in page
    assert "rgb/7.png: truncated" in page
    assert "seed: 3" in page


def test_plots_are_svg_in_the_colour_of_the_page(content):
    for plot in all_path_plots(content) + error_plots(content):
        root = ElementTree.fromstring(plot.svg)
        assert root.tag.endswith("svg")
        assert "viewBox" in root.attrib
        assert "width" not in root.attrib
        assert "currentColor" in plot.svg
        assert "#010203" not in plot.svg
    assert "Red bands" in error_plots(content)[0].caption   # frame 7 is lost


def test_plots_are_the_same_each_time(content):
    assert error_plots(content)[0].svg == error_plots(content)[0].svg


def colours_near(image: np.ndarray, colour: tuple[int, int, int]) -> int:
    gap = np.abs(image.astype(int) - np.array(colour)).max(axis=-1)
    return int(np.count_nonzero(gap < 60))


def test_the_film_shows_points_lines_and_speeds_in_the_papers_colours(content):
    assert [p.index for p in content.pictures] == [13, 26, 39]
    picture = content.pictures[-1]
    image = cv2.imdecode(np.frombuffer(picture.jpeg, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert image.shape == (picture.height, picture.width, 3) == (96, 128, 3)
    for colour in (STATIC_POINT, OBJECT_POINT, STATIC_LINE, DYNAMIC_LINE):
        assert colours_near(image, colour) > 3
    assert "2 points" in picture.caption
    assert "track 7" in picture.caption


def test_the_speed_is_that_of_the_points_and_not_of_the_worlds_origin():
    centroid = np.array([100.0, 0.0, 0.0])
    turn = se3.exp(np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    about = se3.from_rotation_translation(np.eye(3), centroid)
    spin = about @ turn @ se3.inverse(about)   # turns in place
    assert speed_m_s(ObjectEstimate(spin, centroid, 1), 0.1) < 1e-9
    drive = se3.exp(np.array([0.0, 0.0, 0.0, 1.5, 0.0, 0.0]))
    assert speed_m_s(ObjectEstimate(drive, centroid, 1), 0.1) == pytest.approx(15.0)
    assert shown_speeds({1: 15.0, 2: 0.5}) == {1: "54 km/h", 2: "2 km/h"}
    assert shown_speeds({2: 0.5}) == {2: "0.50 m/s"}


@pytest.mark.parametrize(("value", "text"), [
    (None, "–"), (0.0, "0"), (1.0, "1.00"), (0.06478, "0.0648"), (12.345, "12.3"),
    (123.45, "123"), (0.000741, "0.00074"), (9.996, "10.0"), (0.9996, "1.00"), (3e-9, "<1e-6"),
    (123456.0, "123456")])
def test_numbers_have_three_digits(value, text):
    assert shown_number(value) == text


def test_the_tables_leave_out_what_nobody_has(content):
    errors = error_table(content.metrics)
    assert errors.columns[1] == "E_t (mm)"
    assert [row[0] for row in errors.rows] == ["camera", "thing 1", "thing 2", "all objects"]
    assert "thing 3" in errors.notes[0]
    alone = error_table({"camera": {"E_t": 0.5, "E_R": 0.1, "coverage": 1.0}})
    assert alone.columns == ("", "E_t (m)", "E_R (°)", "coverage (%)")
    assert not trajectory_table({"camera": {"coverage": 0.0}}).rows


@pytest.fixture(scope="module")
def camera_only() -> ReportContent:
    record = run(PerturbedTruth(TRUTH, P, tracks=lambda k: {}),
                 SyntheticFeed(SyntheticSequence(TRUTH)))
    metrics = {"system": "orb",
               "sequence": {"name": "synthetic", "frames": 40, "sha256": "0" * 64}}
    online = Online.of(record)
    return ReportContent.of(metrics | score(TRUTH, record), record.stamps_s, online.camera,
                            online.motions, online.owner, TRUTH, True)


def test_a_system_of_the_camera_alone_has_one_row_for_all_objects(camera_only):
    errors = error_table(camera_only.metrics)
    assert [row[0] for row in errors.rows] == ["camera", "all objects"]
    assert errors.rows[1][1:] == ("–", "–", "0")
    moved = sum(block.get("moving_frames", 0)
                for block in camera_only.metrics["objects"].values())
    sentence = f"No motion of an object was estimated (true motions: {moved})."
    assert moved > 0
    assert errors.notes[0] == sentence
    page = render_report(camera_only)
    assert sentence in page
    assert "thing 1" not in page


def test_a_motion_on_no_object_is_an_estimate(camera_only):
    objects = camera_only.metrics["objects"]
    ghost = camera_only.metrics | {
        "objects": objects | {"mean": objects["mean"] | {"tracks_without_object": 1}}}
    errors = error_table(ghost)
    assert [row[0] for row in errors.rows] == ["camera", "thing 1", "thing 2", "all objects"]
    assert not any("No motion" in note for note in errors.notes)


def test_a_run_without_truth_has_a_page_too(content):
    blank = {key: content.metrics[key] for key in ("system", "sequence", "timing")}
    page = render_report(ReportContent.of(blank, content.stamps_s, content.camera,
                                          content.motions, content.owner, None, False))
    assert "No truth is known" in page
    assert not Outline(page).open


@pytest.mark.parametrize("width", [1200, 390])
def test_a_browser_draws_it_without_fault_or_sideways_scrolling(page, content, tmp_path, width):
    path = tmp_path / "report.html"
    path.write_text(page)
    seen = opened(path, width)
    assert seen.faults == []
    assert seen.images >= len(content.pictures) > 0
    assert seen.empty == 0
    assert seen.width <= width
    assert seen.small == 0


def test_the_browser_would_tell(tmp_path):
    path = tmp_path / "bad.html"
    path.write_text('<html><head></head><body><img src="none.png"><script>nothing()</script>'
                    '<div style="width:600px"><p style="font-size:5px">x</p></div></body></html>')
    seen = opened(path, 390)
    assert (seen.images, seen.empty, seen.small) == (1, 1, 1)
    assert seen.width >= 600
    assert any("none.png" in fault for fault in seen.faults)
    assert any("nothing is not defined" in fault for fault in seen.faults)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_the_shortest_runs_have_a_page(count):
    truth = world(count=count)
    film = Filmstrip(count)
    record = run(PerturbedTruth(truth, P, P), SyntheticFeed(SyntheticSequence(truth)),
                 observers=(film,))
    online = Online.of(record)
    metrics = score(truth, record)
    assert ("E_t" in metrics.get("camera", {})) == (count > 1)
    assert film.pictures
    page = render_report(ReportContent.of(metrics, record.stamps_s, online.camera, online.motions,
                                          online.owner, truth, True, film.pictures))
    assert not Outline(page).open


def test_errors_of_very_different_size_are_drawn_by_powers_of_ten(content):
    errors = dict(content.object_errors)
    errors[2] = replace(errors[2], t_m=np.where(np.arange(len(errors[2].t_m)) < 3, 5.0, 1e-4))
    objects = error_plots(replace(content, object_errors=errors))[1]
    assert "{10^{" in objects.svg
    assert "{10^{" not in error_plots(content)[1].svg
