"""Files from strangers: hostile ones are refused in a line, and nothing in them is run."""

import json
import os
import shutil
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from folders import CALIBRATION, HEIGHT, WIDTH, tum_folder, vdo_folder
from simbench.cli import main
from simbench.datasets.calibration import read_calibration
from simbench.datasets.image_header import image_size
from simbench.errors import BadFile, BadFrame, UserError
from simbench.run_source import read_source
from simbench.sequence import open_sequence
from simbench.suites.files import read_suite
from test_measuring_scripts import script

SCENE = str(Path(__file__).parent / "scenes" / "stored_room.py") + ":StoredRoom-v0"


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    out = tmp_path_factory.mktemp("untrusted") / "room"
    assert main(["generate", SCENE, "--out", str(out), "--frames", "2"]) == 0
    return out


@pytest.fixture
def copy(generated, tmp_path):
    return Path(shutil.copytree(generated, tmp_path / "copy"))


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_header(width, height):
    return chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))


def hollow_png(width, height):
    """A PNG that claims a size and holds next to nothing."""
    return (b"\x89PNG\r\n\x1a\n" + png_header(width, height)
            + chunk(b"IDAT", zlib.compress(b"\0" * 1000)) + chunk(b"IEND", b""))


def test_a_few_hundred_spoilt_files_are_read_or_refused(capsys):
    assert script("fuzz_readers").main(["--inputs", "700", "--seed", "3"]) == 0
    assert "700 inputs, 0 findings" in capsys.readouterr().out


def test_a_picture_that_claims_gigabytes_is_refused_by_its_header(tmp_path):
    folder = tum_folder(tmp_path / "tum")
    (folder / "rgb/1.png").write_bytes(hollow_png(30_000, 30_000))
    with pytest.raises(BadFrame, match="30000×30000 pixels"):
        open_sequence(folder).frame(1)


PICTURE = cv2.imencode(".png", np.full((HEIGHT, WIDTH, 3), 77, np.uint8))[1].tobytes()
HEADER_END = 33     # of a PNG: 8 bytes of signature, 25 of the header
ANIMATION = chunk(b"acTL", struct.pack(">II", 2, 0)) + chunk(
    b"fcTL", struct.pack(">IIIIIHHBB", 0, 30_000, 30_000, 0, 0, 1, 10, 0, 0))


@pytest.mark.parametrize(("more", "why"), [
    (struct.pack(">I", 2**31 - 1) + b"tEXtno text", "truncated"),    # 2 GB in OpenCV's decoder
    (png_header(30_000, 30_000), "spoilt, its header"),
    (chunk(b"IHDR", b""), "spoilt, its header")])
def test_a_png_whose_chunks_are_not_as_they_should_be_is_refused_undecoded(tmp_path, more, why):
    folder = tum_folder(tmp_path / "tum")
    (folder / "rgb/1.png").write_bytes(PICTURE[:HEADER_END] + more + PICTURE[HEADER_END:])
    with pytest.raises(BadFrame, match=rf"rgb/1\.png: the image is ({why})"):
        open_sequence(folder).frame(1)


def test_only_what_makes_the_pixels_of_a_png_is_decoded(tmp_path):
    folder = tum_folder(tmp_path / "tum")
    more = ANIMATION + chunk(b"tEXt", b"Comment\0" + bytes(1000))
    (folder / "rgb/1.png").write_bytes(PICTURE[:HEADER_END] + more + PICTURE[HEADER_END:] + b"\0")
    assert (open_sequence(folder).frame(1).rgb == 77).all()


def test_an_error_is_one_line_of_a_sensible_length_that_steers_no_terminal(copy):
    path = copy / "truth.zarr/depth_m/zarr.json"
    about = json.loads(path.read_text())
    path.write_text(json.dumps(about | {"data_type": "long " * 900 + "\x1b[2J\n\u202e"}))
    with pytest.raises(BadFile, match=r"depth_m/zarr\.json: .* generate the sequence again") as why:
        open_sequence(copy)
    assert len(str(why.value)) <= 1500
    assert str(why.value).isprintable()
    assert str(BadFile("a\x1b[2J\nb")) == "a\\x1b[2J b"


def test_the_size_of_an_image_is_read_from_its_header():
    picture = np.zeros((40, 70, 3), np.uint8)
    for suffix in (".png", ".jpg"):
        data = cv2.imencode(suffix, picture)[1].tobytes()
        assert image_size(data) == (70, 40)
        assert image_size(data[:18]) is None
    assert image_size(b"BM" + bytes(50)) is None


def test_flow_that_claims_gigabytes_is_refused(tmp_path):
    folder = vdo_folder(tmp_path / "vdo", 1)
    (folder / "flow").mkdir()
    (folder / "flow/000000.flo").write_bytes(b"PIEH" + struct.pack("<ii", 2**31 - 1, 2**31 - 1))
    with pytest.raises(BadFrame, match="2147483647"):
        open_sequence(folder).frame(1)


@pytest.mark.parametrize(("key", "value"), [
    ("shape", [2, 10**6, 10**6]), ("shape", [2]), ("shape", [float("inf"), 48, 64]),
    ("zarr_format", 2), ("data_type", "object"),
    ("codecs", [{"name": "numcodecs.pickle"}]), ("codecs", []),
    ("chunk_grid", {"name": "regular", "configuration": {"chunk_shape": [1, 10**6, 10**6]}})])
def test_an_array_of_another_form_is_refused_by_its_description(copy, key, value):
    path = copy / "truth.zarr/depth_m/zarr.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))
    with pytest.raises(BadFile, match="depth_m"):
        open_sequence(copy)


def test_a_chunk_that_unpacks_to_gigabytes_is_refused_by_its_header(copy):
    path = copy / "truth.zarr/depth_m/c/1/0/0"
    path.write_bytes(b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 2**40) + bytes(40))
    with pytest.raises(BadFrame, match="truncated or damaged"):
        open_sequence(copy).truth.frame(1)


def test_a_scene_that_a_sequence_names_is_not_run(copy, tmp_path):
    mark, evil = tmp_path / "it_was_run", tmp_path / "evil.py"
    evil.write_text(f"open({str(mark)!r}, 'w')\n")
    manifest = json.loads((copy / "sequence.json").read_text())
    (copy / "sequence.json").write_text(json.dumps(manifest | {"scene": f"{evil}:Evil-v0"}))
    with pytest.raises(UserError, match=r"give --scene .*evil\.py:Evil-v0"):
        open_sequence(copy).truth.flow(0, 1)
    assert not mark.exists()


def test_a_scene_that_the_user_names_is(generated, tmp_path):
    code = ("import sys; from simbench.cli import main; sys.exit(main(sys.argv[1:]))")
    words = [sys.executable, "-c", code, "verify", str(generated)]
    asked, trusted = (subprocess.run([*words, *more], capture_output=True, text=True, check=True)
                      for more in ([], ["--scene", SCENE]))
    assert "is not run because a file names it" in asked.stdout
    assert asked.stdout.count("certificate: ") == 1
    assert "drawn here, it has the same bytes" in trusted.stdout


@pytest.mark.parametrize("name", ["../secret.png", "/etc/hostname", "rgb/../../secret.png"])
def test_a_list_does_not_lead_out_of_its_folder(tmp_path, name):
    folder = tum_folder(tmp_path / "tum")
    rows = (folder / "rgb.txt").read_text().replace("rgb/2.png", name)
    (folder / "rgb.txt").write_text(rows)
    with pytest.raises(BadFile, match=r"rgb\.txt:4: .* leads out of the folder"):
        open_sequence(folder)


def test_a_link_does_not_lead_out_of_its_folder(tmp_path):
    folder = tum_folder(tmp_path / "tum")
    (tmp_path / "secret.png").write_bytes((folder / "rgb/1.png").read_bytes())
    (folder / "rgb/1.png").unlink()
    (folder / "rgb/1.png").symlink_to(tmp_path / "secret.png")
    with pytest.raises(BadFile, match="a link that leads out of"):
        open_sequence(folder)
    (folder / "rgb/1.png").unlink()
    (folder / "rgb/1.png").symlink_to("2.png")        # within the folder it may lead anywhere
    (tmp_path / "link").symlink_to(folder)            # and the folder itself may be a link
    assert (open_sequence(tmp_path / "link").frame(1).rgb
            == open_sequence(folder).frame(2).rgb).all()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
def test_a_pipe_is_no_file(tmp_path):
    folder = tum_folder(tmp_path / "tum")
    (folder / "groundtruth.txt").unlink()
    os.mkfifo(folder / "groundtruth.txt")
    with pytest.raises(BadFile, match="not a regular file"):
        open_sequence(folder)


LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [*{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}]\n"
    for a, b in zip("abcdefgh", "bcdefghi", strict=True))


@pytest.mark.parametrize("text", [LAUGHS + "distortion: *i\n", "[" * 5000, "fx: 2001-99-99\n",
                                  "!!python/object/apply:os.system [id]\n", "{a: 1\n"])
def test_yaml_that_is_a_trap_is_one_line(tmp_path, text):
    path = tmp_path / "file.yaml"
    path.write_text(text)
    for read in (read_calibration, read_suite):
        with pytest.raises(BadFile, match="not YAML") as raised:
            read(path)
        assert "\n" not in str(raised.value)
        assert len(str(raised.value)) < 700


@pytest.mark.parametrize("said", ["frames: .inf", "frames: 2\nseed: .inf", "frames: 2\nfps: 1e+99",
                                  "frames: 2\nsize: [.inf, 8]", "frames: 2\ndials: 3"])
def test_numbers_of_a_run_that_are_none_are_refused(tmp_path, said):
    (tmp_path / "config.yaml").write_text(f"source: SwingingBoxes-v0\n{said}\n")
    with pytest.raises(BadFile, match=r"config\.yaml"):
        read_source(tmp_path)


@pytest.mark.parametrize(("old", "new"), [
    (f"width: {WIDTH}", "width: 1000000"), (f"height: {HEIGHT}", "height: 1e300"),
    ("fx: 30.0", "fx: 1e-300"), ("depth_scale: 5000.0", "depth_scale: 1e-30"),
    ("cx: 15.5", "cx: 1e300"), ("distortion: [0, 0, 0, 0, 0]", "distortion: [1e300]")])
def test_a_camera_beyond_all_range_is_refused(tmp_path, old, new):
    path = tmp_path / "calibration.yaml"
    path.write_text(CALIBRATION.replace(old, new))
    with pytest.raises(BadFile, match=r"calibration\.yaml: "):
        read_calibration(path)
