"""ScoreSlam: the reward is the error of the increment that the system reports."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import FrameStackObservation

from simbench.envs import SceneEnv
from simbench.errors import UserError
from simbench.wrappers import ActiveCamera, ScoreSlam, SensorNoise
from slam.geometry import se3
from slam.systems.sdpl import SdplSlam
from slam.types import FrameEstimate, Status

NAME = "simbench/SwingingBoxes-v0"
WRONG = np.array([0.0, 0.01, 0.0, 0.003, 0.0, 0.004])     # 0.01 rad and about 5 mm


class Oracle:
    """Reports what it is told, whatever it sees."""

    def __init__(self) -> None:
        self.frames = []
        self.told = np.eye(4)

    def process(self, frame):
        self.frames.append(frame)
        return FrameEstimate(frame.index, frame.stamp_s, np.eye(4), self.told,
                             status=Status.TRACKED if frame.index else Status.FIRST)

    def finish(self):
        raise NotImplementedError


class Whisper(gymnasium.Wrapper):
    """Tells the oracle the true motion, with an error, before it is asked."""

    def __init__(self, env, oracle, error):
        super().__init__(env)
        self.oracle, self.error = oracle, error

    def step(self, action):
        result = self.env.step(action)
        true = result[-1]["truth"]["poses"]["T_previous_camera"]
        self.oracle.told = true @ se3.inverse(se3.exp(self.error))
        return result


def make(oracle, error, system=None):
    env = gymnasium.make(NAME, size=(80, 60), frames=3)
    return ScoreSlam(Whisper(env, oracle, error), system or oracle)


def test_a_perfect_system_gets_no_penalty():
    oracle = Oracle()
    env = make(oracle, np.zeros(6))
    _, info = env.reset(seed=0)
    assert info["score"]["E_t"] == 0.0
    _, reward, _, _, info = env.step(np.zeros(6, np.float32))
    assert reward == pytest.approx(0.0, abs=1e-7)
    assert info["score"]["tracked"] is True
    env.close()


def test_the_reward_is_the_error_in_metres_and_radians():
    oracle = Oracle()
    env = make(oracle, WRONG)
    env.reset(seed=0)
    _, reward, _, truncated, info = env.step(np.zeros(6, np.float32))
    E_t = np.linalg.norm(se3.exp(WRONG)[:3, 3])
    assert info["score"]["E_t"] == pytest.approx(E_t, rel=1e-6)
    assert info["score"]["E_R"] == pytest.approx(np.rad2deg(0.01), rel=1e-6)
    assert reward == pytest.approx(-(E_t + 0.01), rel=1e-6)
    assert not truncated
    env.close()


def test_the_system_sees_the_observations_and_no_truth():
    oracle = Oracle()
    env = make(oracle, WRONG)
    observation, _ = env.reset(seed=0)
    seen, _, _, _, info = env.step(np.zeros(6, np.float32))
    first, second = oracle.frames
    np.testing.assert_array_equal(first.rgb, observation["rgb"])
    assert first.flow is None
    assert (first.index, second.index) == (0, 1)
    np.testing.assert_array_equal(second.depth_m, seen["depth"])
    np.testing.assert_array_equal(second.flow.flow_px, seen["flow"])
    np.testing.assert_array_equal(second.flow.valid, info["flow_valid"])
    assert second.stamp_s == pytest.approx(1 / 30)
    env.close()


def test_one_system_is_good_for_one_episode_a_function_for_many():
    oracle = Oracle()
    env = make(oracle, WRONG)
    env.reset(seed=0)
    with pytest.raises(UserError, match="function"):
        env.reset(seed=0)
    env.close()
    made = []

    def factory(intrinsics):
        made.append((Oracle(), intrinsics))
        return made[-1][0]

    env = make(oracle, WRONG, factory)
    env.reset(seed=0)
    env.reset(seed=1)
    assert len(made) == 2
    assert made[0][1].width == 80
    assert env.system is made[1][0]
    env.close()


def test_our_own_system_follows_a_pushed_camera():
    env = ScoreSlam(gymnasium.make(NAME, size=(320, 240), frames=3), SdplSlam)
    env.reset(seed=0)
    for push in (1.0, -1.0, 0.3):
        _, reward, _, _, info = env.step(np.full(6, push, np.float32))
        assert info["score"]["tracked"]
        assert -5e-4 < reward <= 0.0      # half a millimetre: truth flow and depth
    env.close()


@pytest.mark.parametrize("sensor", ["kinect", "realsense"])
def test_a_sensor_put_on_gives_the_bytes_of_a_sensor_built_in(sensor):
    built_in = gymnasium.make(NAME, size=(80, 60), frames=2, sensor=sensor)
    put_on = SensorNoise(gymnasium.make(NAME, size=(80, 60), frames=2), sensor)
    for _ in range(2):                       # the second episode has another seed
        (a, _), (b, _) = built_in.reset(seed=5), put_on.reset(seed=5)
        for _ in range(2):
            for key in ("rgb", "depth", "instance", "flow"):
                np.testing.assert_array_equal(a[key], b[key])
            a, b = (env.step(np.zeros(6, np.float32))[0] for env in (built_in, put_on))
    assert put_on.observation_space.contains(b)
    built_in.close()
    put_on.close()


def test_a_sensor_that_blurs_cannot_be_put_on():
    env = gymnasium.make(NAME, size=(80, 60), frames=2)
    with pytest.raises(UserError, match="sensor='handheld'"):
        SensorNoise(env, "handheld")


def test_gymnasiums_own_stack_of_frames_takes_our_observations():
    env = FrameStackObservation(gymnasium.make(NAME, size=(80, 60), frames=3), 3)
    first, _ = env.reset(seed=0)
    second, *_ = env.step(np.ones(6, np.float32))
    assert env.observation_space.contains(second)
    assert second["rgb"].shape == (3, 60, 80, 3)
    np.testing.assert_array_equal(second["depth"][1], first["depth"][2])
    assert (second["depth"][2] != second["depth"][1]).any()
    env.close()


def gaze(env, action, steps=3):
    """How the camera has been turned from the fixed path: (right, down) of its axis, and info."""
    ends = []
    for each in (np.zeros(2, np.float32), np.asarray(action, np.float32)):
        env.reset(seed=0)
        for _ in range(steps):
            info = env.step(each)[-1]
        ends.append(info["truth"]["poses"]["T_world_camera"])
    fixed, turned = ends
    np.testing.assert_allclose(turned[:3, 3], fixed[:3, 3], atol=1e-12)     # it goes its own way
    right, down, _ = fixed[:3, :3].T @ turned[:3, 2]
    return right, down, info


def test_an_active_camera_is_turned_and_not_moved():
    env = ActiveCamera(gymnasium.make(NAME, size=(80, 60), frames=3), lambda _: Oracle())
    step_rad = 0.5 / 30
    right, down, info = gaze(env, [0.0, 1.0])
    assert right == pytest.approx(np.sin(3 * step_rad), abs=1e-6)
    assert abs(down) < 1e-6
    np.testing.assert_allclose(info["gaze_rad"], [0.0, 3 * step_rad])
    right, down, _ = gaze(env, [1.0, 0.0])
    assert down == pytest.approx(-np.sin(3 * step_rad), abs=1e-6)           # up
    env.close()


def test_an_active_camera_looks_no_farther_aside_than_it_may():
    env = ActiveCamera(gymnasium.make(NAME, size=(80, 60), frames=3), lambda _: Oracle(),
                       reach_rad=0.02)
    right, _, info = gaze(env, [0.0, -1.0])
    assert right == pytest.approx(-np.sin(0.02), abs=1e-6)
    np.testing.assert_allclose(info["gaze_rad"], [0.0, -0.02])
    with pytest.raises(UserError, match="2 finite numbers"):
        env.step(np.zeros(6))
    env.close()


class Loser(Oracle):
    def process(self, frame):
        assert frame.flow is None               # it computes its own
        return FrameEstimate(frame.index, frame.stamp_s, np.eye(4), np.eye(4), status=Status.LOST)


def test_a_lost_frame_costs_what_was_said():
    env = ActiveCamera(gymnasium.make(NAME, size=(80, 60), frames=3), lambda _: Loser(),
                       lost_reward=-3.0)
    env.reset(seed=0)
    assert env.step(np.zeros(2, np.float32))[1] == -3.0
    env.close()


def test_gymnasium_finds_nothing_wrong_with_an_active_camera():
    # Without a spec: a wrapper around a function cannot be made again from a registry's words.
    env = ActiveCamera(SceneEnv("SwingingBoxes-v0", size=(80, 60), frames=3), lambda _: Oracle())
    check_env(env, skip_render_check=True)
    env.close()
