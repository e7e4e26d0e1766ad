"""Gymnasium environments: a scene, a sensor, and a camera that an agent may push about."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium import spaces

from simbench.errors import UserError
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Frame, Intrinsics

if TYPE_CHECKING:   # MuJoCo is loaded when an environment is made, not when it is registered
    from simbench.inputs import Feed
    from simbench.live import LiveSequence
    from simbench.render import Renderer
    from simbench.world import World

BUILTIN_SCENES = ("Corridor-v0", "Loop-v0", "Office-v0", "Street-v0", "SwingingBoxes-v0")
MAX_DEPTH_M = 10_000.0


def register_env(scene: str) -> None:
    """Make `gymnasium.make("simbench/" + scene)` work; a second time does nothing."""
    name = f"simbench/{scene}"
    if name not in gymnasium.registry:
        gymnasium.register(id=name, entry_point="simbench.envs:SceneEnv", kwargs={"scene": scene})


def register_envs() -> None:
    """Register an environment for each scene that comes with simbench."""
    for scene in BUILTIN_SCENES:
        register_env(scene)


class SceneEnv(gymnasium.Env[dict[str, Array], Array]):
    """One scene by its name.

    Observation, a dict of arrays without NaN:
        rgb (H, W, 3) uint8; depth (H, W) float32 z-depth in metres, 0 where there is none;
        instance (H, W) int32 mask labels, 0 = background, shuffled anew in every frame;
        flow (H, W, 2) float32 pixels from the previous frame to this one on the previous frame's
        pixels, 0 where `info["flow_valid"]` is False and in the first frame; time (1,) seconds.
    Action, in [−1, 1]⁶: a twist [ω, v] of the camera in its own frame, as shares of
        `max_turn_rad_s` and `max_speed_m_s`, added on the scripted motion until the next frame.
    Reward 0; an episode never terminates and is truncated after `frames` steps.
    `info["truth"]`: see `_truth_info`; padded to `max_objects` and `max_edges`.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium's form; each environment has its own)
        "render_modes": ["rgb_array", "depth_array"], "render_fps": 30}

    def __init__(self, scene: str, frames: int | None = None, sensor: str = "ideal",
                 render_mode: str | None = None, *, flow: str = "truth", masks: str = "truth",
                 shuffle_labels: bool = True, size: tuple[int, int] | None = None,
                 fps: float | None = None, max_turn_rad_s: float = 0.5,
                 max_speed_m_s: float = 0.5, max_objects: int | None = None, max_edges: int = 2048,
                 **dials: float | str) -> None:
        """
        Args:
            scene: a registered scene.
            frames: steps of an episode; the scene's own number if None.
            sensor: what acts on colour and depth, and on flow and masks where they are noisy.
            flow: truth or noisy.
            masks: truth, noisy or hsv.
            size: (width, height) px; the scene's own if None.
            fps: frames per second; the scene's own if None.
            max_objects, max_edges: rows to which truth is padded; objects: the scene's own most.
            dials: the scene's dials, such as texture=0.5.
        Raises:
            UserError: an unknown scene, sensor, dial or choice, or a value out of range.
        """
        from simbench.inputs import InputChoice  # noqa: PLC0415 (see TYPE_CHECKING above)
        from simbench.scene import find_scene  # noqa: PLC0415
        from simbench.sensors import find_sensor  # noqa: PLC0415

        _check_one_of("flow", flow, ("truth", "noisy"))
        _check_one_of("masks", masks, ("truth", "noisy", "hsv"))
        if render_mode is not None:
            _check_one_of("render_mode", render_mode, tuple(self.metadata["render_modes"]))
        find_sensor(str(sensor))
        self.spec_of_scene = find_scene(scene)
        self.frames = self.spec_of_scene.frames if frames is None else frames
        _check_numbers(self.frames, size, fps, max_objects, max_edges)
        self.choice = InputChoice(flow=flow, masks=masks, boxes="none", depth="sensor",
                                  sensor=sensor, shuffle_labels=shuffle_labels)
        self.render_mode = render_mode
        self.max_objects = self.spec_of_scene.most_objects if max_objects is None else max_objects
        self.max_edges = max_edges
        if not (0.0 <= max_turn_rad_s < np.inf and 0.0 <= max_speed_m_s < np.inf):
            raise UserError(f"max_turn_rad_s={max_turn_rad_s}, max_speed_m_s={max_speed_m_s}: "
                            "wanted finite numbers that are not negative")
        self.max_twist = np.repeat([max_turn_rad_s, max_speed_m_s], 3).astype(np.float64)
        self._dials = self.spec_of_scene.resolve_dials(dials)
        self._size = size or (self.spec_of_scene.width, self.spec_of_scene.height)
        self._fps = self.spec_of_scene.fps if fps is None else float(fps)
        self.spec_of_scene.check_view(self._size, self._fps, int(self.frames))
        self.metadata = {**self.metadata, "render_fps": round(self._fps)}
        self.observation_space: spaces.Space[Any] = _observation_space(
            *self._size, self.frames / self._fps)
        self.action_space = spaces.Box(-1.0, 1.0, (6,), np.float32)
        self.episode = 0        # the seed of this episode's world and noise
        self._world: World | None = None
        self._renderer: Renderer | None = None
        self._live: LiveSequence | None = None
        self._feed: Feed | None = None
        self._seen: Frame | None = None

    @property
    def intrinsics(self) -> Intrinsics:
        """The camera; the same in every episode."""
        return self._any_world().layout.intrinsics

    @property
    def period_s(self) -> float:
        """Time from one frame to the next."""
        return 1.0 / self._fps

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None,
              ) -> tuple[dict[str, Array], dict[str, Any]]:
        """A new world, drawn with its noise from the environment's generator."""
        from simbench.inputs import Feed  # noqa: PLC0415 (see TYPE_CHECKING above)
        from simbench.live import LiveSequence  # noqa: PLC0415
        from simbench.render import make_renderer  # noqa: PLC0415

        super().reset(seed=seed, options=options)
        episode = self.episode = int(self.np_random.integers(2**31))
        world = self._world = self._make_world(episode)
        if self._renderer is None:   # here, so that a vector environment's parent needs no OpenGL
            self._renderer = make_renderer("mujoco", world)
        self._live = LiveSequence(world, self._renderer, self.frames)
        self._feed = Feed(self._live, self.choice, episode)
        return self._observe()

    def step(self, action: Array) -> tuple[dict[str, Array], SupportsFloat, bool, bool,
                                           dict[str, Any]]:
        """Move the camera by the action until the next frame.

        Raises:
            UserError: the action is not six finite numbers, or the episode is over.
        """
        share = np.asarray(action, np.float64)
        if share.shape != (6,) or not np.all(np.isfinite(share)):
            raise UserError(f"action: wanted 6 finite numbers within [-1, 1], got {action!r}"
                            .replace("\n", " "))
        if self._live is None or self._live.index >= self.frames:
            raise UserError("step: the episode has not begun or is over; call reset first")
        self._live.step(np.clip(share, -1.0, 1.0) * self.max_twist)
        observation, info = self._observe()
        return observation, 0.0, False, self._live.index >= self.frames, info

    def render(self) -> Array | None:
        """What the sensor saw last: (H, W, 3) uint8, or (H, W) float32 metres."""
        if self._seen is None or self.render_mode is None:
            return None
        return np.array(self._seen.rgb if self.render_mode == "rgb_array" else self._seen.depth_m)

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = self._world = self._live = self._feed = self._seen = None

    def _make_world(self, seed: int) -> World:
        from simbench.world import make_world  # noqa: PLC0415 (see TYPE_CHECKING above)
        return make_world(self.spec_of_scene, seed, self._dials, self._size, self._fps)

    def _any_world(self) -> World:
        if self._world is None:
            self._world = self._make_world(0)
        return self._world

    def _observe(self) -> tuple[dict[str, Array], dict[str, Any]]:
        assert self._feed is not None        # both are there from the first reset on
        assert self._live is not None
        k = self._live.index
        frame = self._seen = self._feed.frame(k)
        observation, valid = _observation(frame)
        labels = np.zeros(self.max_objects + 1, np.int32)
        for label, instance in self._feed.true_object_of_label(k).items():
            if label <= self.max_objects:
                labels[label] = instance
        return observation, {"flow_valid": valid, "truth": {
            **_truth_info(self._live, self.max_objects, self.max_edges),
            "object_of_label": labels}}


def _check_numbers(frames: Any, size: Any, fps: Any, max_objects: Any, max_edges: Any) -> None:
    """What has no meaning whatever the scene. Raises UserError."""
    if not isinstance(frames, int | np.integer) or frames < 1:
        raise UserError(f"frames={frames!r}: an episode has a whole number of steps, at least one")
    if size is not None and not (isinstance(size, Sequence) and len(size) == 2 and all(
            isinstance(side, int | np.integer) for side in size)):
        raise UserError(f"size={size!r}: wanted (width, height) in whole pixels, as in (640, 480)")
    if fps is not None and not (isinstance(fps, SupportsFloat) and float(fps) > 0.0):
        raise UserError(f"fps={fps!r}: wanted a number above 0")
    for name, rows in (("max_objects", max_objects), ("max_edges", max_edges)):
        if rows is not None and not (isinstance(rows, int | np.integer) and rows > 0):
            raise UserError(f"{name}={rows!r}: wanted a whole number above 0")


def _check_one_of(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise UserError(f"{name}={value!r}: wanted one of {', '.join(known)}")


def _observation_space(width: int, height: int, duration_s: float) -> spaces.Dict:
    size = (height, width)
    reach = 2.0 * max(size)
    return spaces.Dict({
        "rgb": spaces.Box(0, 255, (*size, 3), np.uint8),
        "depth": spaces.Box(0.0, MAX_DEPTH_M, size, np.float32),
        "instance": spaces.Box(0, np.iinfo(np.int32).max, size, np.int32),
        "flow": spaces.Box(-reach, reach, (*size, 2), np.float32),
        "time": spaces.Box(0.0, duration_s, (1,), np.float64),
    })


def _observation(frame: Frame) -> tuple[dict[str, Array], Array]:
    """The observation, and (H, W) bool where its flow is valid."""
    height, width = frame.depth_m.shape
    flow, valid = np.zeros((height, width, 2), np.float32), np.zeros((height, width), bool)
    if frame.flow is not None and frame.flow.valid is not None:
        valid = np.array(frame.flow.valid)
        reach = 2.0 * max(height, width)
        np.clip(frame.flow.flow_px, -reach, reach, out=flow)
        flow[~valid] = 0.0
    instance = frame.instance_id
    return {
        "rgb": np.array(frame.rgb),
        "depth": np.minimum(frame.depth_m, np.float32(MAX_DEPTH_M)),
        "instance": np.zeros((height, width), np.int32) if instance is None else np.array(instance),
        "flow": flow,
        "time": np.array([frame.stamp_s]),
    }, valid


def _truth_info(live: LiveSequence, max_objects: int, max_edges: int) -> dict[str, Any]:
    """Truth of the present frame as arrays; rows beyond what there is are 0 and not `valid`.

    poses: T_world_camera (4, 4), T_previous_camera (4, 4) motion since the last frame.
    objects, row = instance id − 1: valid, visible, T_world_object (N, 4, 4), H_world (N, 4, 4)
        motion since the last frame in the world.
    edges: valid, endpoints_px (E, 2, 2), endpoints_camera (E, 2, 3), edge, instance_id.
    flow, from the previous frame, on its pixels (newly_visible: on this frame's): flow_px, valid,
        occluded, leaving, newly_visible; all 0 in the first frame.
    depth_m and instance_id (H, W): before the sensor.
    """
    truth, k = live.truth, live.index
    now, before = truth.frame(k), truth.frame(max(k - 1, 0))
    count = max((each.instance_id for each in truth.layout.objects), default=0)
    if count > max_objects:
        raise UserError(f"{live.name} has {count} objects: make the environment with "
                        f"max_objects={count} or more")
    objects: dict[str, Array] = {
        "valid": np.zeros(max_objects, bool), "visible": np.zeros(max_objects, bool),
        "T_world_object": np.zeros((max_objects, 4, 4)),
        "H_world": np.zeros((max_objects, 4, 4))}
    for each in truth.layout.objects:
        row = each.instance_id - 1
        objects["valid"][row] = True
        objects["visible"][row] = bool(np.any(now.instance_id == each.instance_id))
        objects["T_world_object"][row] = T = now.T_world_part[each.root_part]
        objects["H_world"][row] = T @ se3.inverse(before.T_world_part[each.root_part])
    return {
        "poses": {"T_world_camera": np.array(now.T_world_camera),
                  "T_previous_camera": se3.inverse(before.T_world_camera) @ now.T_world_camera},
        "objects": objects,
        "edges": _edge_info(live, max_edges),
        "flow": _flow_info(live),
        "depth_m": np.array(now.depth_m),
        "instance_id": np.array(now.instance_id),
    }


def _edge_info(live: LiveSequence, max_edges: int) -> dict[str, Array]:
    edges = live.truth.edges(live.index)
    count = len(edges.edge)
    if count > max_edges:
        raise UserError(f"{live.name} shows {count} edges: make the environment with "
                        f"max_edges={2 * count}")
    padded = {"valid": np.arange(max_edges) < count}
    for name in ("edge", "instance_id", "endpoints_px", "endpoints_camera"):
        values = getattr(edges, name)
        padded[name] = np.zeros((max_edges, *values.shape[1:]), values.dtype)
        padded[name][:count] = values
    return padded


def _flow_info(live: LiveSequence) -> dict[str, Array]:
    names = ("flow_px", "valid", "occluded", "leaving", "newly_visible")
    if live.index == 0:
        size = (live.intrinsics.height, live.intrinsics.width)
        return {name: np.zeros((*size, 2), np.float32) if name == "flow_px"
                else np.zeros(size, bool) for name in names}
    flow = live.truth.flow(live.index - 1, live.index)
    return {name: np.array(getattr(flow, name)) for name in names}
