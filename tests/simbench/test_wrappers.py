"""ScoreSlam: the reward is the error of the increment that the system reports."""

import gymnasium
import numpy as np
import pytest

from simbench.errors import UserError
from simbench.wrappers import ScoreSlam
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
