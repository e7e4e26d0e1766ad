"""The environments: Gymnasium's own checker, determinism, vector environments, a clean exit."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence

import simbench
from simbench import scene
from simbench.envs import BUILTIN_SCENES, SceneEnv
from simbench.errors import UnknownName, UserError
from simbench.motion import look_at
from simbench.scene import list_scenes
from simbench.world import make_world
from slam.geometry import se3

ROOT = Path(__file__).resolve().parents[2]
SMALL = {"size": (80, 60), "frames": 3}
NAME = "simbench/SwingingBoxes-v0"


@pytest.fixture(scope="module")
def env():
    made = gymnasium.make(NAME, sensor="kinect", texture=0.5, **SMALL)
    yield made
    made.close()


def still() -> np.ndarray:
    return np.zeros(6, np.float32)


def run(script: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run([sys.executable, "-c", script], env=environment, check=False,
                          capture_output=True, text=True, timeout=300)


def test_every_scene_has_its_environment():
    names = {spec.name for spec in list_scenes()}
    assert set(BUILTIN_SCENES) <= names
    assert {f"simbench/{name}" for name in names} <= set(gymnasium.registry)


@pytest.mark.parametrize("name", BUILTIN_SCENES)
def test_gymnasium_finds_nothing_wrong(name):
    counts = {"objects", "people"} & {d.name for d in scene.find_scene(name).dials if not d.choices}
    with warnings.catch_warnings():
        warnings.simplefilter("error")      # few objects, since the checker makes many worlds
        made = gymnasium.make(f"simbench/{name}", **SMALL, **dict.fromkeys(counts, 1))
        check_env(made.unwrapped)
    made.close()


@pytest.mark.parametrize("name", BUILTIN_SCENES)
def test_truth_has_room_for_all_that_the_dials_allow(name):
    spec = scene.find_scene(name)
    most = [{dial.name: dial.high for dial in spec.dials if dial.integer and not dial.choices}]
    choices = {dial.name: dial.choices for dial in spec.dials if dial.choices}
    most += [most[0] | {key: value} for key, values in choices.items() for value in values[1:]]
    counts = [len(make_world(spec, 0, spec.resolve_dials(dials), (64, 48), spec.fps).layout.objects)
              for dials in most]
    assert max(counts) <= spec.most_objects


def test_an_episode_as_documented(env):
    observation, info = env.reset(seed=0)
    assert set(observation) == {"rgb", "depth", "instance", "flow", "time"}
    assert not observation["flow"].any()
    for step in range(1, 4):
        observation, reward, terminated, truncated, info = env.step(still())
        assert env.observation_space.contains(observation)
        assert (reward, terminated, truncated) == (0.0, False, step == 3)
        assert observation["time"][0] == pytest.approx(step / 30.0)
    assert observation["flow"][info["flow_valid"]].any()
    assert not observation["flow"][~info["flow_valid"]].any()
    with pytest.raises(UserError, match="reset"):
        env.step(still())


def test_truth_travels_in_info(env):
    env.reset(seed=3)
    observation, _, _, _, info = env.step(still())
    truth = info["truth"]
    objects, edges = truth["objects"], truth["edges"]
    assert objects["valid"].sum() == 4
    assert objects["T_world_object"].shape == (20, 4, 4)    # as many boxes as the dial allows
    assert edges["valid"].any()
    assert not edges["endpoints_px"][~edges["valid"]].any()
    # Labels are shuffled; the map leads each back to its object.
    undone = truth["object_of_label"][observation["instance"]]
    np.testing.assert_array_equal(undone, truth["instance_id"])
    assert info["truth"]["flow"]["flow_px"].shape == (60, 80, 2)
    # Depth went through the sensor: near the truth, not equal to it.
    seen = observation["depth"] > 0
    error = np.abs(observation["depth"] - truth["depth_m"])[seen]
    assert 1e-4 < np.median(error) < 0.1


def test_equal_seeds_give_equal_bytes(env):
    def episode(seed: int) -> list[object]:
        made = [env.reset(seed=seed)]
        made += [env.step(np.full(6, 0.3, np.float32)) for _ in range(2)]
        return made

    first, other = episode(5), episode(6)
    assert data_equivalence(first, episode(5), exact=True)
    assert not data_equivalence(first, other, exact=True)


def test_resets_without_a_seed_go_on_with_the_generator(env):
    first = env.reset(seed=5)[0]["rgb"]
    assert not np.array_equal(env.reset()[0]["rgb"], first)
    np.testing.assert_array_equal(env.reset(seed=5)[0]["rgb"], first)


def test_the_action_is_a_twist_on_top_of_the_script(env):
    def camera(action: np.ndarray) -> np.ndarray:
        env.reset(seed=1)
        for _ in range(2):
            info = env.step(action)[-1]
        return info["truth"]["poses"]["T_world_camera"]

    share = np.array([0.2, -0.4, 1.0, 0.5, -1.0, 0.1], np.float32)
    offset = se3.inverse(camera(still())) @ camera(share)
    twist = share.astype(np.float64) * 0.5     # 0.5 rad/s and 0.5 m/s at most
    np.testing.assert_allclose(offset, se3.exp(twist * 2 / 30.0), atol=1e-9)
    np.testing.assert_allclose(camera(10 * share), camera(np.clip(10 * share, -1, 1)))


def test_truth_follows_the_action(env):
    """Depth and pose of both frames explain the flow of a background pixel, pushed or not."""
    env.reset(seed=2)
    before = env.step(np.ones(6, np.float32))[-1]["truth"]
    now = env.step(-np.ones(6, np.float32))[-1]["truth"]
    K = env.unwrapped.intrinsics.matrix
    v, u = np.nonzero((before["instance_id"] == 0) & now["flow"]["valid"])
    z = before["depth_m"][v, u].astype(np.float64)
    rays = np.stack([u, v, np.ones(len(u))], -1) @ np.linalg.inv(K).T
    points = se3.transform_points(se3.inverse(now["poses"]["T_previous_camera"]),
                                  rays * z[:, None])
    pixels = points @ K.T
    flow = pixels[:, :2] / pixels[:, 2:] - np.stack([u, v], -1)
    np.testing.assert_allclose(now["flow"]["flow_px"][v, u], flow, atol=1e-3)


@pytest.mark.parametrize("sensor", ["handheld"])
def test_motion_blur_averages_around_the_same_instant(sensor):
    """The truth is that of mid-exposure: it is the same with and without blur."""
    sharp, blurred = (gymnasium.make(NAME, sensor=name, masks="truth", **SMALL)
                      for name in ("realsense", sensor))
    action = np.array([0, 1, 0, 0, 0, 0], np.float32)
    for made in (sharp, blurred):
        made.reset(seed=0)
    seen = [made.step(action) for made in (sharp, blurred)]
    seen = [made.step(action) for made in (sharp, blurred)]
    (one, *_, info_one), (two, *_, info_two) = seen
    assert data_equivalence(info_one["truth"], info_two["truth"], exact=True)
    np.testing.assert_array_equal(one["depth"], two["depth"])
    assert not np.array_equal(one["rgb"], two["rgb"])
    difference = np.mean(one["rgb"].astype(float) - two["rgb"])
    assert abs(difference) < 3.0
    sharp.close()
    blurred.close()


def test_render_modes_show_what_the_sensor_sees():
    for mode, key in (("rgb_array", "rgb"), ("depth_array", "depth")):
        made = gymnasium.make(NAME, render_mode=mode, sensor="kinect", **SMALL)
        observation, _ = made.reset(seed=0)
        np.testing.assert_array_equal(made.render(), observation[key])
        made.close()


@pytest.mark.parametrize(("wrong", "error"), [
    ({"sensor": "eye"}, UnknownName), ({"textures": 0.5}, UnknownName),
    ({"texture": 7}, UserError), ({"frames": 0}, UserError), ({"flow": "dis"}, UserError),
    ({"size": "64x48"}, UserError), ({"size": (64,)}, UserError), ({"size": (3, 3)}, UserError),
    ({"size": (64.5, 48)}, UserError),
    ({"frames": 2.5}, UserError), ({"frames": "3"}, UserError), ({"fps": 0}, UserError),
    ({"fps": "fast"}, UserError), ({"sensor": None}, UnknownName), ({"max_objects": 0}, UserError),
    ({"max_edges": -1}, UserError), ({"max_turn_rad_s": float("nan")}, UserError),
    ({"max_speed_m_s": -1.0}, UserError),
    ({"masks": "given"}, UserError), ({"render_mode": "human"}, UserError),
])
def test_wrong_arguments_are_one_line_errors(wrong, error):
    with pytest.raises(error) as caught:
        SceneEnv("SwingingBoxes-v0", **wrong)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("action", [[np.nan] * 6, [0.0] * 5])
def test_a_broken_action_is_refused(action):
    made = SceneEnv("SwingingBoxes-v0", **SMALL)
    with pytest.raises(UserError, match="6 finite numbers"):
        made.step(np.array(action))


def test_more_objects_than_the_padding_is_an_error():
    made = SceneEnv("SwingingBoxes-v0", max_objects=2, **SMALL)
    with pytest.raises(UserError, match="max_objects=4"):
        made.reset(seed=0)
    made.close()


def test_sync_vector_environment_equals_single_ones(env):
    vector = gymnasium.make_vec(NAME, num_envs=2, vectorization_mode="sync",
                                vector_kwargs={"copy": True}, sensor="kinect", texture=0.5,
                                **SMALL)
    observations, infos = vector.reset(seed=[5, 6])
    assert infos["truth"]["poses"]["T_world_camera"].shape == (2, 4, 4)
    for row, seed in enumerate((5, 6)):
        single, _ = env.reset(seed=seed)
        for name, value in single.items():
            np.testing.assert_array_equal(observations[name][row], value)
    vector.close()


ASYNC = """
import gymnasium, numpy as np, simbench
if __name__ == "__main__":
    vector = gymnasium.make_vec("simbench/SwingingBoxes-v0", num_envs=2, frames=2,
                                size=(80, 60), vectorization_mode="async",
                                vector_kwargs={"context": "spawn"})
    first = vector.reset(seed=[5, 5])[0]
    second = vector.step(np.zeros((2, 6), np.float32))[0]
    assert all(np.array_equal(second[k][0], second[k][1]) for k in second)
    vector.close()
    print("done", first["rgb"].shape)
"""


def test_async_vector_environment_by_spawn_and_a_silent_end(tmp_path):
    script = tmp_path / "vector.py"
    script.write_text(ASYNC)
    done = subprocess.run([sys.executable, str(script)], check=False, capture_output=True,
                          text=True, timeout=300, env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert done.stdout.strip() == "done (2, 60, 80, 3)", done.stderr
    assert done.stderr == ""


@pytest.mark.parametrize("close", ["env.close()", "pass"])
def test_nothing_is_said_at_exit(close):
    done = run("import gymnasium\n"
               "env = gymnasium.make('simbench:simbench/SwingingBoxes-v0', size=(80, 60))\n"
               f"env.reset(seed=0)\n{close}")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_registering_does_not_load_mujoco():
    done = run("import simbench, sys; print('mujoco' in sys.modules, 'OpenGL' in sys.modules)")
    assert done.stdout.strip() == "False False"


def test_a_scene_of_ones_own_gets_an_environment_too(monkeypatch):
    monkeypatch.setattr(scene, "_SCENES", dict(scene._SCENES))
    monkeypatch.delitem(gymnasium.registry, "simbench/Own-v0", raising=False)
    own = Path(__file__).parent / "scenes" / "marker_room.xml"
    simbench.register_scene(name="Own-v0", description="mine", mjcf=own, fps=10.0,
                            motion=lambda time_s, seed, dials: {"camera": look_at((0, -3, 1.5),
                                                                                 (0, 0, 1))})
    made = gymnasium.make("simbench/Own-v0", size=(80, 60), frames=1)
    observation, _ = made.reset(seed=0)
    assert observation["depth"].any()
    assert made.step(still())[3]
    made.close()
    del gymnasium.registry["simbench/Own-v0"]
