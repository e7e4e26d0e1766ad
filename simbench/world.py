"""One compiled, seeded, moving scene."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from simbench.errors import BadFile, UserError
from simbench.layout import model_layout
from simbench.randomise import scale_light, set_texture_contrast
from simbench.scene import SceneObject, SceneSpec, Staging, find_scene, scenes_folder
from simbench.types import SceneLayout
from slam.geometry import se3
from slam.geometry.arrays import Array

_CARRIER = "camera of the MJCF"   # what an MJCF's own "camera" is called once ours takes its name
_SUBFRAMES = 16                   # physics steps divide a frame by this, for motion blur
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_GL_FROM_CV = (0.0, 1.0, 0.0, 0.0)   # half a turn about x: OpenGL's camera looks along −z
_SAME_TIME_S = 1e-9


def make_world(scene: str | SceneSpec, seed: int = 0,
               dials: Mapping[str, float | str] | None = None,
               size: tuple[int, int] | None = None, fps: float | None = None) -> World:
    """Build, randomise and compile a scene.

    Args:
        scene: a registered name or a spec.
        seed: not negative; equal seeds give equal worlds.
        dials: values of the scene's dials; the rest keep their defaults.
        size: (width, height) px; the scene's own if None. The vertical field of view stays.
        fps: frames per second; the scene's own if None. It decides the physics step only.
    Raises:
        UserError: an unknown scene or dial, a value out of range, an MJCF file that cannot be read.
    """
    spec = find_scene(scene) if isinstance(scene, str) else scene
    if seed < 0:
        raise UserError(f"scene {spec.name}: seed {seed} must not be negative")
    width, height = size or (spec.width, spec.height)
    fps = spec.fps if fps is None else fps
    spec.check_view((width, height), fps)
    return World(spec, int(seed), spec.resolve_dials(dials), (int(width), int(height)), float(fps))


class World:
    """A scene at one instant, ready to be rendered and to be asked for truth.

    Scripted bodies, joints and the camera are functions of time; all other joints are MuJoCo's
    physics, on a grid of fine steps that depends on `fps` alone, so that every way of reaching a
    time gives the same state. Between two steps positions are carried on at constant velocity.
    """

    def __init__(self, spec: SceneSpec, seed: int, dials: dict[str, float],
                 size: tuple[int, int], fps: float) -> None:
        self.spec, self.seed, self.dials, self.fps = spec, seed, dials, fps
        staged, staging = _stage(spec, seed, dials)
        self._script = staging.script
        self._file = str(spec.mjcf)
        start = self._script(0.0)
        _prepare(staged, start, size, spec.name)
        self.model: mujoco.MjModel = _compiled(staged, spec)
        set_texture_contrast(self.model, dials["texture"])
        scale_light(self.model, dials["light"])
        self._carrier = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_CAMERA, _CARRIER)
        self._mocap, self._joints = self._targets(start)
        substeps = _SUBFRAMES * int(np.ceil(
            1.0 / (1.05 * fps * _SUBFRAMES * self.model.opt.timestep)))
        self._step_s = 1.0 / (fps * substeps)
        self.model.opt.timestep = self._step_s
        self._physical = self.model.nv > len(self._joints)
        self._scripted_in_physics = len(self._mocap) > 1 or bool(self._joints)
        self.data = mujoco.MjData(self.model)
        if self.model.nkey:   # a keyframe, where there is one, is where physics starts
            mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        self._initial = self._physics_state()
        self.layout: SceneLayout = model_layout(self.model, staging, size, spec)
        self.reset()

    def reset(self) -> None:
        """Back to time 0 with the scripted camera; equal bytes every time."""
        self._time_s, self._steps = 0.0, 0
        self._offset = np.eye(4)
        self._grid = self._initial
        self._show()

    def advance_to(self, time_s: float) -> None:
        """Go forward to `time_s`.

        Raises:
            ValueError: the time lies before the present; `reset` or `restore` goes back.
        """
        if time_s < self._time_s - _SAME_TIME_S:
            raise ValueError(f"advance_to({time_s}): the world stands at {self._time_s} s already")
        wanted = int(np.floor(time_s / self._step_s + 1e-6))
        if self._physical and wanted > self._steps:
            mujoco.mj_setState(self.model, self.data, self._grid, _STATE)
            for step in range(self._steps, wanted):
                if self._scripted_in_physics:
                    self._place(self._script(step * self._step_s))
                mujoco.mj_step(self.model, self.data)
            self._grid = self._physics_state()
        self._steps, self._time_s = max(wanted, self._steps), float(time_s)
        self._show()

    @property
    def time_s(self) -> float:
        return self._time_s

    @property
    def T_world_camera(self) -> Array:
        """(4, 4), OpenCV axes; exactly the pose of the MuJoCo camera named "camera"."""
        return self._T_world_camera.copy()

    @property
    def T_world_part(self) -> Array:
        """(P, 4, 4) poses of all MuJoCo bodies."""
        quat_xyzw = np.roll(self.data.xquat, -1, axis=1)
        return se3.from_rotation_translation(se3.rotation_from_quaternion(quat_xyzw),
                                             self.data.xpos)

    @property
    def camera_offset(self) -> Array:
        """(4, 4): T_world_camera = scripted pose @ camera_offset. Assign to move the camera."""
        return self._offset.copy()

    @camera_offset.setter
    def camera_offset(self, offset: ArrayLike) -> None:
        self._offset = se3.orthonormalised(np.asarray(offset, dtype=np.float64).reshape(4, 4))
        self._show()

    def state(self) -> Array:
        """All that decides the picture, as one float64 vector."""
        return np.concatenate([[self._time_s, float(self._steps)], self._offset.ravel(),
                               self._grid])

    def restore(self, state: Array) -> None:
        """Return to the instant at which `state()` gave this vector, exactly."""
        if np.shape(state) != (18 + len(self._initial),):
            raise ValueError(f"restore: this is no state of {self.spec.name} with these dials")
        self._time_s, self._steps = float(state[0]), int(state[1])
        self._offset = np.array(state[2:18]).reshape(4, 4)
        self._grid = np.array(state[18:])
        self._show()

    def _physics_state(self) -> Array:
        state = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, state, _STATE)
        return state

    def _show(self) -> None:
        """Bring model and data to the present instant, for renderers and rays."""
        mujoco.mj_setState(self.model, self.data, self._grid, _STATE)
        rest = self._time_s - self._steps * self._step_s
        if self._physical and abs(rest) > _SAME_TIME_S:
            mujoco.mj_integratePos(self.model, self.data.qpos, self.data.qvel, rest)
        self.data.time = self._time_s
        placement = self._script(self._time_s)
        self._place(placement)
        camera = placement.get("camera")
        if camera is None:
            self._forward()
            camera = self._carried_camera()
        self._T_world_camera = se3.orthonormalised(np.asarray(camera) @ self._offset)
        self._put_mocap("camera", self._T_world_camera)
        self._forward()

    def _forward(self) -> None:
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    def _carried_camera(self) -> Array:
        """Pose of the camera that the MJCF file itself holds."""
        R = self.data.cam_xmat[self._carrier].reshape(3, 3) * np.array([1.0, -1.0, -1.0])
        return se3.from_rotation_translation(R, self.data.cam_xpos[self._carrier])

    def _place(self, placement: Mapping[str, ArrayLike]) -> None:
        for name, value in placement.items():
            if name in self._joints:
                position, velocity = self._joints[name]
                self.data.qpos[position], self.data.qvel[velocity] = float(value), 0.0  # type: ignore[arg-type]
            elif name != "camera":
                self._put_mocap(name, np.asarray(value, dtype=np.float64))

    def _put_mocap(self, body: str, T_world_body: Array) -> None:
        index = self._mocap[body]
        quat_xyzw = se3.quaternion_from_rotation(T_world_body[:3, :3])
        self.data.mocap_pos[index] = T_world_body[:3, 3]
        self.data.mocap_quat[index] = np.roll(quat_xyzw, 1)

    def _targets(self, start: Mapping[str, ArrayLike]
                 ) -> tuple[dict[str, int], dict[str, tuple[int, int]]]:
        """The mocap index of each scripted body, the qpos and dof address of each joint."""
        bodies, joints = {}, {}
        for name in {"camera", *start}:
            body = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, name)
            joint = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, name)
            if body >= 0 and self.model.body_mocapid[body] >= 0:
                bodies[name] = int(self.model.body_mocapid[body])
            elif joint >= 0 and int(self.model.jnt_type[joint]) in (mujoco.mjtJoint.mjJNT_HINGE,
                                                               mujoco.mjtJoint.mjJNT_SLIDE):
                joints[name] = (int(self.model.jnt_qposadr[joint]),
                                int(self.model.jnt_dofadr[joint]))
            else:
                raise UserError(
                    f"scene {self.spec.name}: the motion moves {name!r}, but {self._file} has no "
                    "hinge or slide joint of that name, and no body of that name that is a child "
                    "of the world without joints")
        return bodies, joints


def _stage(spec: SceneSpec, seed: int, dials: dict[str, float]) -> tuple[mujoco.MjSpec, Staging]:
    """The MJCF file, edited by the scene's `build`."""
    path = Path(spec.mjcf)
    if not path.is_absolute() and not path.is_file():
        path = scenes_folder() / path
    if not path.is_file():
        raise BadFile(f"scene {spec.name}: there is no MJCF file {spec.mjcf}")
    try:
        staged = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise BadFile(f"scene {spec.name}: {path}: {error}") from error
    if spec.build is not None:
        staging = spec.build(staged, seed, dials)
        return staged, staging
    motion = spec.motion
    assert motion is not None   # SceneSpec holds one of the two
    objects = None if spec.objects is None else tuple(
        each if isinstance(each, SceneObject) else SceneObject(each) for each in spec.objects)
    return staged, Staging(lambda time_s: motion(time_s, seed, dials), objects)


def _prepare(staged: mujoco.MjSpec, start: Mapping[str, ArrayLike], size: tuple[int, int],
             scene: str) -> None:
    """Free the name "camera" for our mocap camera, and let scripted bodies be moved."""
    own = staged.camera("camera")
    fovy = float(own.fovy) if own is not None else float(staged.visual.global_.fovy)
    if own is not None:
        own.name = _CARRIER
    elif "camera" not in start:
        raise UserError(f'scene {scene}: the motion gives no "camera" and the MJCF file has none: '
                        'return {"camera": T_world_camera, ...} or add <camera name="camera" .../>')
    for body in staged.worldbody.bodies:
        if body.name in start and not body.joints:
            body.mocap = True
    carrier = staged.worldbody.add_body(name="camera", mocap=True)
    carrier.add_camera(name="camera", fovy=fovy, quat=_GL_FROM_CV)
    staged.visual.global_.offwidth, staged.visual.global_.offheight = size


def _compiled(staged: mujoco.MjSpec, spec: SceneSpec) -> mujoco.MjModel:
    try:
        return staged.compile()
    except ValueError as error:
        raise BadFile(f"scene {spec.name}: {spec.mjcf}: {error}") from error
