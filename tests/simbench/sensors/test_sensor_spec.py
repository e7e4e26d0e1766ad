"""Sensors by name, their settings, and that stages do not disturb each other."""

import numpy as np
import pytest

from simbench.errors import UnknownName, UserError
from simbench.sensors import SENSORS, Stage, find_sensor, generator


def test_the_ideal_sensor_does_nothing():
    ideal = find_sensor("ideal")
    assert ideal.depth is None
    assert ideal.rgb is None
    assert ideal.exposure_s == 0


@pytest.mark.parametrize("name", ["ideal", "gaussian", "kinect", "realsense"])
def test_every_sensor_says_what_it_is(name):
    assert SENSORS[name].name == name
    assert SENSORS[name].help.endswith(".")


def test_a_misspelt_sensor_gets_the_nearest_name():
    with pytest.raises(UnknownName, match="did you mean 'kinect'"):
        find_sensor("kinekt")


def test_every_figure_can_be_set():
    spec = find_sensor("kinect", {"depth.max_m": "5", "rgb.read_dn": 3, "exposure_s": 0.02,
                                  "flow.sigma_px": 0.1})
    assert (spec.depth.max_m, spec.rgb.read_dn, spec.exposure_s) == (5.0, 3.0, 0.02)
    assert spec.flow.sigma_px == 0.1
    assert find_sensor("kinect").depth.max_m == 8.0


@pytest.mark.parametrize(("path", "value", "error"), [
    ("depth.colour", 1, UnknownName), ("dept.max_m", 1, UnknownName), ("depth", 1, UserError),
    ("depth.max_m", "far", UserError), ("exposure_s.x", 1, UnknownName),
])
def test_wrong_settings_are_one_line_errors(path, value, error):
    with pytest.raises(error) as caught:
        find_sensor("kinect", {path: value})
    assert "\n" not in str(caught.value)
    assert path in str(caught.value)


def test_streams_of_stages_and_frames_differ_and_repeat():
    def draw(seed: int, stage: Stage, frame: int) -> float:
        return float(generator(seed, stage, frame).random())

    drawn = {draw(seed, stage, frame) for seed in (0, 1) for stage in Stage for frame in range(5)}
    assert len(drawn) == 2 * len(Stage) * 5
    assert draw(0, Stage.RGB, 2) == draw(0, Stage.RGB, 2)
    assert np.unique([int(stage) for stage in Stage]).size == len(Stage)
