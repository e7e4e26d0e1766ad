"""Pixels of the MuJoCo renderer, and the choice of the OpenGL platform."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from simbench.errors import UnknownName
from simbench.render import gl, make_renderer
from simbench.scene import SceneSpec
from simbench.world import make_world

ROOT = Path(__file__).parents[3]
_HASH = """
import hashlib, runpy
from simbench.render import make_renderer
from simbench.world import make_world
world = make_world(runpy.run_path("tests/simbench/scenes/marker_room.py")["SPEC"])
renderer = make_renderer("mujoco", world)
digest = hashlib.sha256()
for time_s in (0.0, 0.7):
    world.advance_to(time_s)
    for image in (renderer.rgb(world), *renderer.depth_and_parts(world)):
        digest.update(image.tobytes())
print(digest.hexdigest())
"""


def _run(code, **environment):
    clean = {name: value for name, value in os.environ.items()
             if name not in ("MUJOCO_GL", "PYOPENGL_PLATFORM", "SIMBENCH_GL")}
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, text=True,
                          capture_output=True, env={**clean, "PYTHONPATH": str(ROOT),
                                                    **environment})


@pytest.fixture
def renderer(marker_world):
    made = make_renderer("mujoco", marker_world)
    yield made
    made.close()


def test_equal_worlds_give_equal_bytes(marker_spec, marker_world, renderer):
    marker_world.advance_to(0.4)
    first = (renderer.rgb(marker_world), *renderer.depth_and_parts(marker_world))
    marker_world.advance_to(0.9)
    renderer.rgb(marker_world)
    again = make_world(marker_spec)
    again.advance_to(0.4)
    second = (renderer.rgb(again), *renderer.depth_and_parts(again))
    for a, b in zip(first, second, strict=True):
        assert np.array_equal(a, b)
    assert first[0].dtype == np.uint8
    assert first[1].dtype == np.float32
    assert first[2].dtype == np.int32


def test_egl_and_osmesa_give_equal_bytes():
    for platform in ("egl", "osmesa"):
        if not gl.platform_works(platform):
            pytest.skip(f"{platform} cannot be loaded here")
    hashes = {_run(_HASH, MUJOCO_GL=platform, LP_NUM_THREADS=threads).stdout
              for platform, threads in (("egl", "1"), ("egl", "2"), ("osmesa", "1"))}
    assert len(hashes) == 1


def test_a_process_that_never_closes_its_renderer_ends_in_silence():
    assert _run(_HASH).stderr == ""


def test_a_projected_marker_lands_on_its_own_mask(marker_sequence):
    intrinsics, truth = marker_sequence.intrinsics, marker_sequence.truth
    marker = next(each for each in truth.layout.objects if each.name == "marker")
    for k in range(len(marker_sequence)):
        frame = truth.frame(k)
        x, y, z = np.linalg.solve(frame.T_world_camera,
                                  frame.T_world_part[marker.root_part][:, 3])[:3]
        u, v = intrinsics.fx * x / z + intrinsics.cx, intrinsics.fy * y / z + intrinsics.cy
        assert frame.part_id[round(v), round(u)] == marker.root_part
        assert frame.instance_id[round(v), round(u)] == marker.instance_id
        rows, columns = np.nonzero(frame.part_id == marker.root_part)
        assert abs(columns.mean() - u) < 0.7
        assert abs(rows.mean() - v) < 0.7


def test_the_sky_has_no_depth_and_no_part(marker_world, renderer):
    depth, part = renderer.depth_and_parts(marker_world)
    assert (part == -1).any()
    assert np.array_equal(part == -1, depth == 0.0)


def test_colour_has_shadows_and_smooth_edges(marker_world, renderer):
    """Where the pole meets the sky some pixels are mixed: several samples a pixel."""
    picture = renderer.rgb(marker_world).astype(int)
    _, part = renderer.depth_and_parts(marker_world)
    sky = part == -1
    beside = np.zeros_like(sky)
    beside[:, 1:] |= sky[:, :-1]
    beside[:, :-1] |= sky[:, 1:]
    mixed = sky & (picture.sum(axis=-1) > 0)
    assert 0 < mixed.sum() < 0.02 * sky.size
    light = marker_world.model.light_castshadow.copy()
    marker_world.model.light_castshadow[:] = False
    unshadowed = renderer.rgb(marker_world).astype(int)
    marker_world.model.light_castshadow[:] = light
    assert (unshadowed - picture).max() > 30


def test_a_world_with_another_model_is_taken_up(tmp_path, marker_world, renderer):
    (tmp_path / "one.xml").write_text(
        '<mujoco><worldbody><light pos="0 0 3"/><geom type="box" size=".5 .5 .5" pos="0 0 -3"/>'
        '<camera name="camera"/></worldbody></mujoco>')
    spec = SceneSpec(name="One-v0", description="one box", mjcf=tmp_path / "one.xml",
                     motion=lambda time_s, seed, dials: {}, width=320, height=240)
    other = make_world(spec)
    expected = renderer.depth_and_parts(marker_world)
    depth, part = renderer.depth_and_parts(other)
    assert set(np.unique(part)) == {-1, 0}
    assert depth[120, 160] == pytest.approx(2.5, abs=1e-4)
    for a, b in zip(expected, renderer.depth_and_parts(marker_world), strict=True):
        assert np.array_equal(a, b)


def test_no_opengl_is_one_line_that_names_the_packages(monkeypatch):
    for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM", "SIMBENCH_GL"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(gl, "_PROBE", "raise SystemExit(1)")
    with pytest.raises(gl.NoOpenGL, match="libegl1 libgl1-mesa-dri libgles2") as caught:
        gl.choose_platform()
    assert "\n" not in str(caught.value)


def test_the_choice_is_handed_to_child_processes(monkeypatch):
    for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM", "SIMBENCH_GL"):
        monkeypatch.delenv(name, raising=False)
    chosen = gl.choose_platform()
    assert os.environ["MUJOCO_GL"] == os.environ["PYOPENGL_PLATFORM"] == chosen
    monkeypatch.setattr(gl, "_PROBE", "raise SystemExit(1)")
    assert gl.choose_platform() == chosen   # without another probe


def test_an_unknown_renderer_is_named(marker_world):
    with pytest.raises(UnknownName, match="'vulkan'"):
        make_renderer("vulkan", marker_world)
