"""Sequences on disk: the same bytes every time, what is read is what was rendered."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from simbench import storage
from simbench.certificate import differences
from simbench.datasets.tum import TumFolder
from simbench.depth_range import farthest_depth
from simbench.errors import BadFile, BadFrame, UserError
from simbench.generate import GenerateSettings, generate
from simbench.render import make_renderer
from simbench.sequence import open_sequence
from simbench.simulate import SimulatedSequence
from simbench.verify import check_sequence, drawn_here

SCENE = str(Path(__file__).parent / "scenes" / "stored_room.py") + ":StoredRoom-v0"
FRAMES = 5


def settings(**changes):
    return GenerateSettings.resolve(SCENE, **changes)


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    out = tmp_path_factory.mktemp("generated") / "sequence"
    assert generate(settings(), out) == FRAMES
    return out


@pytest.fixture
def copy(generated, tmp_path):
    return Path(shutil.copytree(generated, tmp_path / "copy"))


def hashes(folder):
    return storage.file_hashes(folder) | {"manifest": storage.file_sha256(
        folder / storage.MANIFEST)}


def test_two_workers_in_other_processes_write_the_same_bytes(generated, tmp_path):
    generate(settings(), tmp_path / "again", workers=2)
    assert hashes(tmp_path / "again") == hashes(generated)


def test_another_seed_writes_other_truth(generated, tmp_path):
    generate(settings(seed=1, frames=1), tmp_path / "other")
    name = "truth.zarr/depth_m/c/0/0/0"
    assert hashes(tmp_path / "other")[name] != hashes(generated)[name]


def test_a_noisy_stereo_sensor_leaves_the_truth_untouched(generated, tmp_path):
    generate(settings(sensor="kinect", stereo=True), tmp_path / "noisy")
    exact, noisy = hashes(generated), hashes(tmp_path / "noisy")
    truth = [name for name in exact if name.startswith(("truth.zarr", "instance", "groundtruth"))]
    assert len(truth) > 3 * FRAMES
    assert all(exact[name] == noisy[name] for name in truth)
    assert exact["depth/000001.png"] != noisy["depth/000001.png"]
    assert exact["rgb/000001.png"] != noisy["rgb/000001.png"]
    sequence = open_sequence(tmp_path / "noisy")
    assert sequence.holds == {"depth", "masks", "stereo"}
    assert sequence.intrinsics.baseline_m > 0
    assert not np.array_equal(sequence.frame(1).right, sequence.frame(1).rgb)
    assert check_sequence(tmp_path / "noisy", sequence) == []


def test_what_is_read_is_what_was_rendered(generated):
    world = settings().make_world()
    renderer = make_renderer("mujoco", world)
    rendered = SimulatedSequence(world, renderer, FRAMES)
    read = open_sequence(generated)
    assert len(read) == FRAMES
    assert read.name == "StoredRoom-v0"
    assert read.intrinsics == rendered.intrinsics
    assert_array_equal(read.stamps_s, rendered.stamps_s)
    scale = read.calibration.depth_scale
    for k in range(FRAMES):
        frame, wanted = read.frame(k), rendered.truth.frame(k)
        assert_array_equal(frame.rgb, rendered.rgb(k))
        assert_allclose(frame.depth_m, wanted.depth_m, atol=0.5001 / scale)
        assert_array_equal(frame.instance_id, wanted.instance_id)
        for field in ("T_world_camera", "T_world_part", "depth_m", "part_id", "instance_id"):
            assert_array_equal(getattr(read.truth.frame(k), field), getattr(wanted, field))
        assert_array_equal(read.truth.states()[k], rendered.truth.world_at(k).state())
    flow, wanted_flow = read.truth.flow(1, 4), rendered.truth.flow(1, 4)
    for field in ("flow_px", "scene_flow_m", "valid", "occluded", "leaving", "newly_visible"):
        assert_array_equal(getattr(flow, field), getattr(wanted_flow, field))
    assert_array_equal(read.truth.edges(2).endpoints_px, rendered.truth.edges(2).endpoints_px)
    for number, poses in rendered.truth.trajectories.objects.items():
        got = read.truth.trajectories.objects[number]
        assert_array_equal(got.T_world_object, poses.T_world_object)
        assert_array_equal(got.valid, poses.valid)
        assert (got.name, got.rigid) == (poses.name, poses.rigid)
    renderer.close()


def test_it_is_a_tum_folder(generated):
    tum, ours = TumFolder.open(generated, None), open_sequence(generated)
    assert_allclose(tum.stamps_s, ours.stamps_s, atol=1e-6)
    assert_array_equal(tum.frame(3).rgb, ours.frame(3).rgb)
    assert_array_equal(tum.frame(3).depth_m, ours.frame(3).depth_m)
    assert_allclose(tum.truth.trajectories.T_world_camera,
                    ours.truth.trajectories.T_world_camera, atol=1e-4)
    pairs = (generated / "associations.txt").read_text().splitlines()
    assert pairs[1].split()[1::2] == ["rgb/000001.png", "depth/000001.png"]


def test_the_manifest_says_how_it_was_made(generated):
    manifest = json.loads((generated / "sequence.json").read_text())
    assert manifest["scene"] == SCENE
    assert manifest["seed"] == 0
    assert set(manifest["versions"]) >= {"mujoco", "numpy"}
    assert manifest["gl_renderer"]
    assert manifest["files"] == storage.file_hashes(generated)
    assert not (generated / "unfinished.json").exists()


def test_the_certificate_names_what_the_bytes_depend_on(generated):
    manifest = json.loads((generated / "sequence.json").read_text())
    certified = manifest["certificate"]
    assert set(certified["bytes_depend_on"]) <= manifest.keys()
    assert set(certified["bytes_depend_on"]) >= {"scene", "scene_sha256", "seed", "dials",
                                                 "versions", "gl_renderer", "sensor_settings"}
    assert any("workers" in each for each in certified["bytes_do_not_depend_on"])
    assert drawn_here(open_sequence(generated)) == []


@pytest.mark.parametrize(("changes", "key"), [({"seed": 1}, "motion_sha256"),
                                              ({"dials": {"texture": 0.5}}, "scene_sha256")])
def test_another_scene_has_another_certificate(generated, changes, key):
    there = json.loads((generated / "sequence.json").read_text())
    assert differences(there, settings(**changes).make_world()) == [f"{key} is another here"]


@pytest.mark.parametrize("changed", [{"seed": 9}, {"dials": {"texture": 0.5}},
                                     {"versions": {}}])
def test_a_manifest_that_was_edited_is_not_what_was_certified(copy, changed):
    manifest = json.loads((copy / "sequence.json").read_text())
    (copy / "sequence.json").write_text(json.dumps(manifest | changed))
    (problem,) = check_sequence(copy, open_sequence(copy))
    assert "its certificate is of another seed, other dials" in problem
    del manifest["certificate"]["claims_sha256"]            # as older sequences are
    (copy / "sequence.json").write_text(json.dumps(manifest))
    assert check_sequence(copy, open_sequence(copy)) == []


def test_what_differs_on_this_machine_is_said(copy):
    manifest = json.loads((copy / "sequence.json").read_text())
    manifest["versions"]["mujoco"] = "3.0.0"
    manifest["gl_renderer"] = "another"
    (copy / "sequence.json").write_text(json.dumps(manifest))
    said = "\n".join(drawn_here(open_sequence(copy)))
    assert "mujoco 3.0.0 there" in said
    assert "gl_renderer 'another' there" in said
    assert "has other bytes" not in said


def test_a_killed_run_resumes_to_the_same_bytes(generated, tmp_path):
    out = tmp_path / "killed"
    code = ("from simbench.generate import *; import sys; from pathlib import Path\n"
            "s = GenerateSettings.resolve(sys.argv[1])\n"
            "generate(s, Path(sys.argv[2]))\n")
    child = subprocess.Popen([sys.executable, "-c", code, SCENE, str(out)])
    while child.poll() is None and not (out / "rgb/000001.png").exists():
        time.sleep(0.002)
    child.send_signal(signal.SIGKILL)
    child.wait()
    assert not (out / storage.MANIFEST).exists()
    with pytest.raises(BadFile, match=r"not finished.*--resume"):
        open_sequence(out)
    (out / "rgb/000003.png.partial").write_bytes(b"half")   # what a kill within a write leaves
    assert 0 < generate(settings(), out, resume=True) < FRAMES
    assert hashes(out) == hashes(generated)
    assert generate(settings(), out, resume=True) == 0


def test_resume_refuses_other_settings_and_foreign_folders(generated, tmp_path):
    with pytest.raises(UserError, match="not empty"):
        generate(settings(), generated)
    with pytest.raises(UserError, match="was begun with seed 0, now it is 3"):
        generate(settings(seed=3), generated, resume=True)
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(UserError, match="nothing to resume"):
        generate(settings(), tmp_path, resume=True)


def test_stereo_with_motion_blur_is_refused():
    with pytest.raises(UserError, match="right images"):
        settings(sensor="handheld", stereo=True)


def test_a_motion_blurred_sequence_keeps_exact_truth(generated, tmp_path):
    generate(settings(sensor="handheld", frames=2), tmp_path / "blurred")
    sequence = open_sequence(tmp_path / "blurred")
    assert_array_equal(sequence.truth.frame(1).depth_m,
                       open_sequence(generated).truth.frame(1).depth_m)
    assert check_sequence(tmp_path / "blurred", sequence) == []


def test_no_pixel_is_deeper_than_the_bound(generated):
    truth = open_sequence(generated).truth
    model = settings().make_world().model
    frames = [truth.frame(k) for k in range(FRAMES)]
    reach_m = farthest_depth(model, np.stack([f.T_world_camera for f in frames]),
                             np.stack([f.T_world_part for f in frames]))
    deepest = max(f.depth_m.max() for f in frames)
    assert deepest <= reach_m * (1 + 1e-6)


def test_depths_beyond_16_bits_are_no_measurement():
    depth_m = np.array([[0.0, 1.0, 13.1066, 13.2]], np.float32)
    assert storage.encode_depth(depth_m, 5000.0).tolist() == [[0, 5000, 65533, 0]]


def test_verify_finds_nothing_wrong(generated):
    assert check_sequence(generated, open_sequence(generated)) == []


def _rewrite_png(path):
    depth = open_sequence(path.parents[1]).frame(2).depth_m.copy()
    depth[5, 5] += 0.5
    storage.write_png(path, storage.encode_depth(depth, 5000.0))


def _claim_other(folder, key):
    manifest = json.loads((folder / "sequence.json").read_text())
    manifest[key] = "0" * 64
    (folder / "sequence.json").write_text(json.dumps(manifest))


DAMAGE = {
    "other poses certified": (lambda f: _claim_other(f, "motion_sha256"),
                              ["sequence.json: its certificate is of other poses"]),
    "no certificate": (lambda f: _claim_other(f, "certificate"),
                       ["sequence.json: it has no certificate"]),
    "one byte": (lambda f: (f / "rgb.txt").write_text((f / "rgb.txt").read_text() + " "),
                 ["rgb.txt: its SHA-256"]),
    "missing file": (lambda f: (f / "associations.txt").unlink(), ["associations.txt: missing"]),
    "extra file": (lambda f: (f / "more.txt").write_text("x"), ["more.txt: not in"]),
    "depth not of the truth": (lambda f: _rewrite_png(f / "depth/000002.png"),
                               ["its SHA-256", "frame 2: its depth image is not its true depth"]),
    "truncated image": (lambda f: (f / "rgb/000001.png").write_bytes(b"\x89PNG\r\n\x1a\n"),
                        ["rgb/000001.png: its SHA-256", "rgb/000001.png: the image is truncated"]),
    "missing chunk": (lambda f: (f / "truth.zarr/part_id/c/1/0/0").unlink(),
                      ["part_id/c/1/0/0: missing", "part_id/c/1/0/0: no such file"]),
    "damaged chunk": (lambda f: (f / "truth.zarr/depth_m/c/1/0/0").write_bytes(b"xyz"),
                      ["its SHA-256", "depth_m/c/1/0/0: truncated or damaged"]),
    "swapped poses": (lambda f: (f / "groundtruth.txt").write_text("0 0 0 0 0 0 0 1\n"),
                      ["its SHA-256", "not the camera poses"]),
}


@pytest.mark.parametrize("case", DAMAGE)
def test_verify_names_what_is_wrong(copy, case):
    spoil, wanted = DAMAGE[case]
    spoil(copy)
    problems = "\n".join(check_sequence(copy, open_sequence(copy)))
    for message in wanted:
        assert message in problems


def test_a_missing_truth_array_is_a_bad_file(copy):
    (copy / "truth.zarr/T_world_part/c/0/0/0/0").unlink()
    with pytest.raises(BadFile, match="missing or damaged"):
        open_sequence(copy)


def test_a_missing_image_is_a_bad_frame(copy):
    (copy / "instance/000002.png").unlink()
    sequence = open_sequence(copy)
    assert sequence.frame(1).index == 1
    with pytest.raises(BadFrame, match=r"instance/000002\.png"):
        sequence.frame(2)


def test_a_broken_manifest_is_a_bad_file(copy):
    (copy / "sequence.json").write_text('{"scene": ')
    with pytest.raises(BadFile, match="not valid JSON"):
        open_sequence(copy)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_leaves_no_file_behind(tmp_path):
    (tmp_path / "x.png.partial").symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left"):
        storage.write_bytes(tmp_path / "x.png", b"data")
    assert list(tmp_path.iterdir()) == []
