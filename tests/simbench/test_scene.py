"""The registry of scenes, and a stranger's way to a scene of their own."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

import simbench
from simbench.errors import BadFile, UnknownName, UserError
from simbench.motion import look_at, pose
from simbench.scene import Dial, SceneSpec, find_scene, list_scenes, scenes_folder
from simbench.world import World, make_world

CRATE = """
<mujoco>
  <worldbody>
    <camera name="camera" pos="-3 0 1" xyaxes="0 -1 0 0 0 1" fovy="50"/>
    <geom type="box" size="4 4 .1" pos="0 0 -.1"/>
    <body name="crate"><geom type="box" size=".3 .2 .1"/></body>
    <body name="ball" pos="1 1 2"><freejoint/><geom type="box" size=".1 .1 .1"/></body>
    <body name="shelf" pos="2 0 0"><geom type="box" size=".1 .5 .1"/></body>
  </worldbody>
</mujoco>"""


def moved_crate(time_s, seed, dials):
    return {"crate": pose((dials["reach"] * time_s, seed, 1.0), yaw=time_s)}


@pytest.fixture
def crate_file(tmp_path: Path) -> Path:
    path = tmp_path / "crate.xml"
    path.write_text(CRATE)
    return path


def crate_spec(path: Path, **changes) -> SceneSpec:
    fields = {"name": "Crate-v0", "description": "a crate", "mjcf": path, "motion": moved_crate,
              "dials": (Dial("reach", 1.0, 0.0, 2.0, "m/s"),)}
    return SceneSpec(**{**fields, **changes})


def part_pose(world: World, body: str):
    return world.T_world_part[mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_BODY, body)]


def test_one_file_and_one_function_make_a_scene(crate_file):
    world = make_world(crate_spec(crate_file), seed=2, dials={"reach": 0.5})
    world.advance_to(1.0)
    assert_allclose(part_pose(world, "crate"), pose((0.5, 2.0, 1.0), yaw=1.0), atol=1e-15)
    assert [each.name for each in world.layout.objects] == ["crate", "ball"]   # not the shelf
    assert part_pose(world, "ball")[2, 3] < 0.1   # physics moves what no script moves
    assert_allclose(world.T_world_camera, look_at((-3, 0, 1), (0, 0, 1)), atol=1e-12)


def test_named_objects_are_the_objects(crate_file):
    layout = make_world(crate_spec(crate_file, objects=("shelf",))).layout
    assert [(each.instance_id, each.name) for each in layout.objects] == [(1, "shelf")]
    assert layout.instance_of_part[layout.objects[0].root_part] == 1


def test_a_camera_on_a_moving_body_is_carried_along(tmp_path):
    path = tmp_path / "carried.xml"
    path.write_text(CRATE.replace('<camera name="camera" pos="-3 0 1" xyaxes="0 -1 0 0 0 1" fovy='
                                  '"50"/>', "").replace(
        '<body name="crate">', '<body name="crate"><camera name="camera" fovy="50" '
        'xyaxes="0 -1 0 0 0 1"/>'))
    world = make_world(crate_spec(path))
    world.advance_to(0.5)
    T_crate_camera = look_at((0, 0, 0), (1, 0, 0))
    assert_allclose(world.T_world_camera, part_pose(world, "crate") @ T_crate_camera, atol=1e-12)


def test_a_scene_registered_in_a_file_of_its_own_is_found_through_it(tmp_path, crate_file):
    script = tmp_path / "mine.py"
    script.write_text(
        "import simbench\n"
        "simbench.register_scene(name='FromFile-v3', description='mine', motion=lambda *_: {},\n"
        f"                        mjcf={str(crate_file)!r})\n")
    spec = find_scene(f"{script}:FromFile-v3")
    assert spec.name == "FromFile-v3"
    assert spec in list_scenes()


def test_a_file_that_is_run_again_registers_its_scene_anew(crate_file):
    text = ("import simbench\ndef motion(time_s, seed, dials): return {}\n"
            "simbench.register_scene(name='Again-v0', description='DESCRIPTION', motion=motion,\n"
            f"                        mjcf={str(crate_file)!r})\n")
    for description in ("first", "second"):
        namespace = {"__name__": "a_notebook"}
        exec(text.replace("DESCRIPTION", description), namespace)
        assert find_scene("Again-v0").description == description
    with pytest.raises(UserError, match="registered already"):
        exec(text, {"__name__": "another_notebook"})


def test_unknown_scene_names_the_nearest():
    with pytest.raises(UnknownName, match="did you mean 'SwingingBoxes-v0'"):
        find_scene("SwingingBoxs-v0")


def test_a_module_that_is_not_there_is_a_users_error():
    with pytest.raises(BadFile, match="no_such_module"):
        find_scene("no_such_module:Some-v0")
    with pytest.raises(BadFile, match=r"no_such_file\.py"):
        find_scene("no_such_file.py:Some-v0")


def test_unknown_and_wrong_dials():
    spec = find_scene("SwingingBoxes-v0")
    with pytest.raises(UnknownName, match="did you mean 'texture'"):
        spec.resolve_dials({"textur": 1.0})
    for wrong in (1.5, -0.1, float("nan"), "much"):
        with pytest.raises(UserError, match=r"texture=.* from 0 to 1"):
            spec.resolve_dials({"texture": wrong})
    assert spec.resolve_dials({"objects": 3})["objects"] == 3.0


def test_a_wrong_dial_is_named_as_it_was_given():
    boxes, office = find_scene("SwingingBoxes-v0"), find_scene("Office-v0")
    for spec, dial, given, said in ((boxes, "objects", 99.0, "objects=99 must be a number from"),
                                    (boxes, "objects", "1e2", "objects=1e2 must be a number from"),
                                    (boxes, "objects", 2.5, "objects=2.5 must be a whole number"),
                                    (office, "people", "runing", "people=runing must be one of"),
                                    (office, "people", 7.0, "people=7 must be one of walking"),
                                    (office, "people", 0.5, "people=0.5 must be one of")):
        with pytest.raises(UserError, match=re.escape(said)):
            spec.resolve_dials({dial: given})


def test_registering_wrongly():
    with pytest.raises(UserError, match="version"):
        simbench.register_scene(name="NoVersion", description="", mjcf="x.xml",
                                motion=moved_crate)
    with pytest.raises(UserError, match="motion"):
        simbench.register_scene(name="Still-v0", description="", mjcf="x.xml")
    with pytest.raises(UserError, match="colour"):
        simbench.register_scene(name="Odd-v0", colour="red")
    with pytest.raises(UserError, match="registered already"):
        simbench.register_scene(name="SwingingBoxes-v0", description="", mjcf="x.xml",
                                motion=moved_crate)


@pytest.mark.parametrize(("text", "message"), [
    (None, "no MJCF file"),
    ("<mujoco><worldbody>", "broken.xml"),
    (CRATE.replace('size="4 4 .1"', 'size="4 -4 .1"'), "size"),
    (CRATE.replace('"crate"', '"other"'), "'crate'"),
    (CRATE.replace('<camera name="camera"', '<camera name="elsewhere"'), "camera"),
])
def test_a_bad_mjcf_file_gives_one_line(tmp_path, text, message):
    path = tmp_path / "broken.xml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(UserError, match=message) as caught:
        make_world(crate_spec(path))
    assert "\n" not in str(caught.value)


def test_an_object_that_is_no_body_is_a_users_error(crate_file):
    with pytest.raises(UserError, match="'ghost' is no body"):
        make_world(crate_spec(crate_file, objects=("ghost",)))


@pytest.mark.parametrize("wrong", [{"seed": -1}, {"size": (4, 480)}, {"fps": 0.0}])
def test_wrong_seed_size_or_rate(crate_file, wrong):
    with pytest.raises(UserError):
        make_world(crate_spec(crate_file), **wrong)


def test_scene_files_are_small_and_all_there():
    files = list(scenes_folder().rglob("*.*"))
    assert {"swinging_boxes.xml", "street.xml"} <= {path.name for path in files}
    assert sum(path.stat().st_size for path in files) < 3_000_000


def test_intrinsics_follow_the_field_of_view(crate_file):
    intrinsics = make_world(crate_spec(crate_file), size=(320, 200)).layout.intrinsics
    assert (intrinsics.cx, intrinsics.cy) == (159.5, 99.5)
    assert_allclose([intrinsics.fx, intrinsics.fy], 100.0 / np.tan(np.deg2rad(25.0)))
