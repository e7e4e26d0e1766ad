"""Suites from YAML: those of the package, and what is said of a wrong one."""

import numpy as np
import pytest

from simbench.errors import BadFile, UnknownName, UserError
from simbench.suites.files import list_suites, load_suite, read_suite
from simbench.suites.jobs import runs_of, tasks_of
from simbench.suites.run_suite import check_names
from simbench.suites.spec import parse_seeds
from simbench.suites.stage import opened

GOOD = """
schema: 1
name: mine
systems: [sdpl, vdo]
seeds: 0-2
defaults: {frames: 5, size: 64x48, sensor: gaussian, dials: {speed: 2}}
cases:
  boxes:
    scene: SwingingBoxes-v0
    sweep: {texture: [1, 0.5], flow: [truth, dis], sensor.depth.sigma_m_at_1m: [0.001],
            set.motion.kernel: [huber]}
"""


@pytest.mark.parametrize("name", list_suites())
def test_every_suite_of_the_package_can_be_run(name):
    suite = load_suite(name)
    assert suite.name == name
    assert suite.description
    check_names(suite)
    runs = runs_of(suite)
    assert len({run.key for run in runs}) == len({run.folder for run in runs}) == len(runs)


def test_a_sweep_becomes_every_combination(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(GOOD)
    suite = load_suite(str(path))
    runs = runs_of(suite)
    assert len(runs) == 2 * 2 * 2 * 3
    one = runs[-1]
    assert (one.system, one.seed, dict(one.point)["texture"]) == ("vdo", 2, 0.5)
    assert dict(one.sequence.dials) == {"texture": 0.5, "speed": 2.0}
    assert (one.choice.flow, one.choice.depth, one.choice.masks) == ("dis", "sensor", "truth")
    assert one.choice.sensor_settings == {"depth.sigma_m_at_1m": 0.001}
    assert one.settings == ("motion.kernel=huber",)
    tasks = tasks_of(runs)
    assert len(tasks) == 2 * 3           # one for each texture and seed: their frames are shared
    assert all(len(task.runs) == 4 for task in tasks)


@pytest.mark.parametrize(("old", "new", "message"), [
    ("schema: 1", "schema: 7", "schema is 7"),
    ("name: mine", "name: ../mine", "no name of letters"),
    ("seeds: 0-2", "seeds: 2-0", "wanted the lower seed first"),
    ("systems: [sdpl, vdo]", "systems: [sdpl, sdpl]", "stands there twice"),
    ("systems: [sdpl, vdo]", "sistems: [sdpl]", r"yaml: no key 'sistems'; did you mean 'systems'"),
    ("scene: SwingingBoxes-v0", "frames: 3", "either scene or folder"),
    ("texture: [1, 0.5]", "texture: 1", "wanted a list"),
    ("texture: [1, 0.5]", "texture: [1, red]", "'red' is not a number"),
    ("texture: [1, 0.5]", "texture: [1, .inf]", "finite"),
    ("flow: [truth, dis]", "flow: [truth, guess]", "wanted one of truth"),
    ("flow: [truth, dis]", "flow: [truth, no]", "neither a number nor a word"),
    ("sensor: gaussian", "sensor: gausian", "did you mean 'gaussian'"),
    ("sigma_m_at_1m", "sigma", "no setting 'sigma'"),
    ("size: 64x48", "size: big", "wanted width and height"),
    ("frames: 5", "frames: 0", "whole number from 1"),
    ("cases:", "cases: [", "not YAML"),
    ("cases:", "metrics: [camera.Et]\ncases:", "did you mean 'camera.E_t'"),
    ("name: mine", "name: mine\nname: ours", r"yaml:\d+: .*'name' stands there twice"),
    ("name: mine", "name: !!python/object/apply:os.system [echo]", "not YAML"),
])
def test_a_wrong_file_is_one_line_that_says_where(tmp_path, old, new, message):
    path = tmp_path / "mine.yaml"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(BadFile, match=message) as raised:
        read_suite(path)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_dial_of_named_values_takes_their_names(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(GOOD.replace("speed: 2", "people: none").replace("texture: [1, 0.5]",
                    "camera_motion: [rpy, static]").replace("SwingingBoxes", "Office"))
    suite = load_suite(str(path))
    check_names(suite)
    assert {run.sequence.dials for run in runs_of(suite)} == {
        (("camera_motion", motion), ("people", "none")) for motion in ("rpy", "static")}
    path.write_text(path.read_text().replace("rpy", "rpi"))
    with pytest.raises(UserError, match="camera_motion=rpi must be one of"):
        check_names(load_suite(str(path)))


def test_wrong_names_are_told_before_anything_runs(tmp_path):
    with pytest.raises(UnknownName, match="did you mean 'smoke'"):
        load_suite("smok")
    path = tmp_path / "mine.yaml"
    for old, new, message in (("SwingingBoxes-v0", "Swinging-v0", "no scene"),
                              ("texture:", "tekture:", "no dial 'tekture'"),
                              ("[1, 0.5]", "[1, 5]", "from 0 to 1"),
                              ("set.motion.kernel", "set.motion.kernels", "no setting"),
                              ("[sdpl, vdo]", "[sdpl, vdoo]", "did you mean 'vdo'")):
        path.write_text(GOOD.replace(old, new))
        with pytest.raises(UserError, match=message):
            check_names(read_suite(path))


def test_seeds_are_ranges_and_numbers():
    assert parse_seeds("0-2,7") == (0, 1, 2, 7)
    assert parse_seeds(5) == (5,)
    for wrong in ("", "a", "1-", "3-1", "1,1", "-1", "0-99999"):
        with pytest.raises(UserError):
            parse_seeds(wrong)


def test_depth_from_stereo_asks_for_right_pictures(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(GOOD.replace("sensor: gaussian", "sensor: gaussian, depth: stereo"))
    runs = runs_of(load_suite(str(path)))
    assert all(run.sequence.stereo for run in runs)
    with opened(runs[0].sequence, 2, None, False) as sequence:
        frame = sequence.frame(1)
        assert frame.right is not None
        assert np.any(frame.right != frame.rgb)
        assert sequence.right(1) is sequence.right(1)   # kept for the next system


def test_some_of_the_cases():
    suite = load_suite("rigidity")
    some = suite.with_cases(("people", "boxes"))
    assert [case.name for case in some.cases] == ["boxes", "people"]
    assert some.seeds == suite.seeds
