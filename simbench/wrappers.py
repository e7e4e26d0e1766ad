"""Wrappers around the environments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, SupportsFloat

import gymnasium
import numpy as np

from simbench.envs import MAX_DEPTH_M
from simbench.errors import UserError
from simbench.metrics.motion import motion_errors
from simbench.sensors.depth import apply_depth_noise
from simbench.sensors.rgb import apply_rgb_noise
from simbench.sensors.spec import find_sensor
from simbench.sensors.streams import Stage, generator
from slam.geometry.arrays import Array
from slam.types import FlowField, Frame, FrameEstimate, Intrinsics, SlamResult


class System(Protocol):
    """Any SLAM system."""

    def process(self, frame: Frame) -> FrameEstimate: ...
    def finish(self) -> SlamResult: ...


class ScoreSlam(gymnasium.Wrapper[dict[str, Array], Array, dict[str, Array], Array]):
    """Runs a SLAM system on the observations.

    The reward is −(E_t + E_R) of the camera's last increment, in metres and radians;
    `info["score"]` holds `E_t` (m), `E_R` (degrees) and `tracked`, the system's own word.
    """

    def __init__(self, env: gymnasium.Env[dict[str, Array], Array],
                 system: System | Callable[[Intrinsics], System], own_flow: bool = False) -> None:
        """
        Args:
            env: a simbench environment, wrapped or not.
            system: a system, good for one episode, or a class or function that makes one of
                intrinsics for each episode.
            own_flow: the system computes its flow from the pictures instead of being given it.
        """
        super().__init__(env)
        ready = hasattr(system, "process") and not isinstance(system, type)
        self._own_flow = own_flow
        self._make = None if ready else system
        self._fresh = system if ready else None
        self.system: Any = None     # the one that runs; its `finish` gives the whole episode
        self.estimate: FrameEstimate | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None,
              ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Begin an episode with a fresh system, and give it the first frame.

        Raises:
            UserError: the wrapper was given one system, and its episode has been.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        if callable(self._make):
            self.system = self._make(self._intrinsics)
        elif self._fresh is not None:
            self.system, self._fresh = self._fresh, None
        else:
            raise UserError("ScoreSlam: this system has had its episode; give a function "
                            "intrinsics -> system instead of a system")
        self._index = 0
        self._process(observation, info)
        return observation, info

    def step(self, action: Array) -> tuple[dict[str, Array], SupportsFloat, bool, bool,
                                           dict[str, Any]]:
        observation, _, terminated, truncated, info = self.env.step(action)
        self._index += 1
        reward = self._process(observation, info)
        return observation, reward, terminated, truncated, info

    @property
    def _intrinsics(self) -> Intrinsics:
        intrinsics: Intrinsics = self.get_wrapper_attr("intrinsics")
        return intrinsics

    def _process(self, observation: dict[str, Array], info: dict[str, Any]) -> float:
        """Give the system a frame, put its score into `info`, and return the reward."""
        flow = None
        if self._index > 0 and not self._own_flow:
            flow = FlowField(observation["flow"], info["flow_valid"])
        frame = Frame(self._index, float(observation["time"][0]), observation["rgb"],
                      observation["depth"], self._intrinsics, observation["instance"], flow=flow)
        estimate = self.estimate = self.system.process(frame)
        E_t, E_R = motion_errors(estimate.T_previous_camera,
                                 info["truth"]["poses"]["T_previous_camera"])
        info["score"] = {"E_t": float(E_t), "E_R": float(E_R),
                         "tracked": estimate.status != "lost"}
        return -float(E_t + np.deg2rad(E_R))


class SensorNoise(gymnasium.Wrapper[dict[str, Array], Array, dict[str, Array], Array]):
    """A sensor's noise on an ideal environment's colour and depth.

    The bytes are those that the environment gives when it is made with `sensor=...`; as a wrapper
    it can be put on after others have seen the ideal pictures.
    """

    def __init__(self, env: gymnasium.Env[dict[str, Array], Array], sensor: str) -> None:
        """
        Raises:
            UnknownName: there is no such sensor.
            UserError: the sensor blurs moving things, which a picture cannot be given afterwards.
        """
        super().__init__(env)
        self._sensor = find_sensor(sensor)
        if self._sensor.exposure_s > 0:
            raise UserError(f"SensorNoise: sensor {sensor!r} blurs what moves while it is exposed; "
                            f"make the environment with sensor={sensor!r} instead")

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None,
              ) -> tuple[dict[str, Array], dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        self._index = 0
        return self._sensed(observation), info

    def step(self, action: Array) -> tuple[dict[str, Array], SupportsFloat, bool, bool,
                                           dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._index += 1
        return self._sensed(observation), reward, terminated, truncated, info

    def _sensed(self, ideal: dict[str, Array]) -> dict[str, Array]:
        episode, k = self.get_wrapper_attr("episode"), self._index
        depth_m = apply_depth_noise(ideal["depth"], self.get_wrapper_attr("intrinsics"),
                                    self._sensor.depth, generator(episode, Stage.DEPTH, k))
        return {**ideal, "depth": np.minimum(depth_m, np.float32(MAX_DEPTH_M)),
                "rgb": apply_rgb_noise(ideal["rgb"], self._sensor.rgb,
                                       generator(episode, Stage.RGB, k))}


class ActiveCamera(gymnasium.Wrapper[dict[str, Array], Array, dict[str, Array], Array]):
    """The camera goes its scripted way; the agent chooses where it looks, so that SLAM errs little.

    Action, in [−1, 1]²: tilt (up is positive) and pan (right is positive), as shares of the
    environment's `max_turn_rad_s`, on top of the script. The gaze stays within `reach_rad` of the
    script's. Reward: ScoreSlam's, and `lost_reward` for a frame in which the system was lost.
    `info["gaze_rad"]`: (2,) tilt and pan from the script so far.
    """

    def __init__(self, env: gymnasium.Env[dict[str, Array], Array],
                 system: Callable[[Intrinsics], System], *, reach_rad: float = 0.5,
                 lost_reward: float = -0.1, own_flow: bool = True) -> None:
        """
        Args:
            env: a simbench environment, wrapped or not.
            system: a class or function that makes a system of intrinsics for each episode.
            own_flow: the system computes its flow from the pictures, so that what they show
                matters; else it is given the observation's.
        """
        super().__init__(ScoreSlam(env, system, own_flow))
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._reach_rad, self._lost_reward = reach_rad, lost_reward

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None,
              ) -> tuple[dict[str, Array], dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        self._gaze_rad = np.zeros(2)
        return observation, info | {"gaze_rad": self._gaze_rad.copy()}

    def step(self, action: Array) -> tuple[dict[str, Array], SupportsFloat, bool, bool,
                                           dict[str, Any]]:
        """Turn the camera until the next frame. Raises UserError: not two finite numbers."""
        share = np.asarray(action, np.float64)
        if share.shape != (2,) or not np.all(np.isfinite(share)):
            raise UserError("action: wanted 2 finite numbers within [-1, 1], got "
                            f"{action!r}".replace("\n", " "))
        most_rad = self.get_wrapper_attr("max_twist")[:2] * self.get_wrapper_attr("period_s")
        wanted = self._gaze_rad + np.clip(share, -1.0, 1.0) * most_rad
        gaze_rad = np.clip(wanted, -self._reach_rad, self._reach_rad)
        twist = np.zeros(6, np.float32)
        twist[:2] = (gaze_rad - self._gaze_rad) / most_rad
        self._gaze_rad = gaze_rad
        observation, reward, terminated, truncated, info = self.env.step(twist)
        if not info["score"]["tracked"]:
            reward = self._lost_reward
        return observation, reward, terminated, truncated, info | {"gaze_rad": gaze_rad.copy()}
