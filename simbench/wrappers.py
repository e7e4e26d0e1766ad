"""Wrappers around the environments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, SupportsFloat

import gymnasium
import numpy as np

from simbench.errors import UserError
from simbench.metrics.motion import motion_errors
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
                 system: System | Callable[[Intrinsics], System]) -> None:
        """
        Args:
            env: a simbench environment, wrapped or not.
            system: a system, good for one episode, or a class or function that makes one of
                intrinsics for each episode.
        """
        super().__init__(env)
        ready = hasattr(system, "process") and not isinstance(system, type)
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
        if self._index > 0:
            flow = FlowField(observation["flow"], info["flow_valid"])
        frame = Frame(self._index, float(observation["time"][0]), observation["rgb"],
                      observation["depth"], self._intrinsics, observation["instance"], flow=flow)
        estimate = self.estimate = self.system.process(frame)
        E_t, E_R = motion_errors(estimate.T_previous_camera,
                                 info["truth"]["poses"]["T_previous_camera"])
        info["score"] = {"E_t": float(E_t), "E_R": float(E_R),
                         "tracked": estimate.status != "lost"}
        return -float(E_t + np.deg2rad(E_R))
