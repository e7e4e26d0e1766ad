"""What a sequence's bytes depend on, what they do not, and whether they would be drawn here."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import asdict
from importlib import metadata
from typing import Any

import mujoco
import numpy as np

from simbench.render.gl import gl_renderer_name
from simbench.sensors.spec import find_sensor
from simbench.world import World
from slam.geometry.arrays import Array

VERSIONS = ("simbench-slam", "mujoco", "numpy", "opencv-contrib-python-headless", "zarr",
            "numcodecs")
DEPENDS_ON = ("scene", "scene_sha256", "motion_sha256", "seed", "dials", "frames", "size", "fps",
              "sensor", "sensor_settings", "stereo", "versions", "gl_renderer")
INDEPENDENT_OF = ("the process that draws a frame", "the number of workers",
                  "the number of threads", "being killed and resumed", "when and where it is drawn",
                  "EGL or OSMesa, where both are of one Mesa version")


def scene_sha256(world: World) -> str:
    """SHA-256 of the compiled model: shapes, textures, colours, lights, camera."""
    data = np.zeros(mujoco.mj_sizeModel(world.model), np.uint8)
    mujoco.mj_saveModel(world.model, None, data)
    return hashlib.sha256(data.data).hexdigest()


def motion_sha256(T_world_camera: Array, T_world_part: Array) -> str:
    """SHA-256 of the poses of camera (K, 4, 4) and parts (K, P, 4, 4) in all frames."""
    digest = hashlib.sha256()
    for poses in (T_world_camera, T_world_part):
        digest.update(np.ascontiguousarray(poses, "<f8").data)
    return digest.hexdigest()


def poses_of(world: World, frames: int) -> tuple[Array, Array]:
    """Poses of camera and parts in all frames; the world is moved through them."""
    world.reset()
    cameras, parts = [], []
    for k in range(frames):
        world.advance_to(k / world.fps)
        cameras.append(world.T_world_camera)
        parts.append(world.T_world_part)
    return np.stack(cameras), np.stack(parts)


def origin(world: World, sensor: str) -> dict[str, Any]:
    """What decides the bytes besides the settings of `generate`, as sequence.json holds it.

    Raises:
        UserError: no such sensor, or no OpenGL.
    """
    spec = find_sensor(sensor)
    noise = {"depth": [type(spec.depth).__name__, asdict(spec.depth)] if spec.depth else None,
             "rgb": asdict(spec.rgb) if spec.rgb else None, "exposure_s": spec.exposure_s,
             "exposure_subframes": spec.exposure_subframes}
    return {"scene_sha256": scene_sha256(world), "sensor_settings": noise,
            "versions": {"python": platform.python_version(),
                         **{name: metadata.version(name) for name in VERSIONS}},
            "gl_renderer": gl_renderer_name()}


def certificate(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """The certificate of a sequence with this manifest, which holds all but the certificate."""
    return {"bytes_depend_on": list(DEPENDS_ON), "bytes_do_not_depend_on": list(INDEPENDENT_OF),
            "claims_sha256": _claims_sha256(manifest),
            "content_sha256": _sha256(manifest["files"])}


def _claims_sha256(manifest: Mapping[str, Any]) -> str:
    """One SHA-256 for all that the bytes depend on, as the manifest says it."""
    return _sha256({key: manifest[key] for key in DEPENDS_ON})


def _sha256(values: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(dict(values), sort_keys=True).encode()).hexdigest()


def faults(manifest: Mapping[str, Any], T_world_camera: Array, T_world_part: Array) -> list[str]:
    """What of the certificate in a manifest does not hold of the sequence itself."""
    claim = manifest.get("certificate")
    if not isinstance(claim, Mapping):
        return ["it has no certificate"]
    missing = [key for key in DEPENDS_ON if key not in manifest]
    found = [f"its certificate does not say {key}" for key in missing]
    # Sequences of before certificates held it have none.
    if "claims_sha256" in claim and not missing and (
            claim["claims_sha256"] != _claims_sha256(manifest)):
        found.append("its certificate is of another seed, other dials, settings or versions")
    if claim.get("content_sha256") != _sha256(manifest["files"]):
        found.append("its certificate is of other files")
    if manifest.get("motion_sha256") != motion_sha256(T_world_camera, T_world_part):
        found.append("its certificate is of other poses")
    return found


def differences(manifest: Mapping[str, Any], world: World) -> list[str]:
    """Where drawing it here could give other bytes: one line for each, empty where it cannot.

    Args:
        world: the scene of the manifest as it is built here.
    """
    here = origin(world, str(manifest["sensor"]))
    here["motion_sha256"] = motion_sha256(*poses_of(world, int(manifest["frames"])))
    there, versions = manifest["versions"], here.pop("versions")
    lines = [f"{name} {there.get(name)} there, {version} here"
             for name, version in versions.items() if there.get(name) != version]
    lines += [f"gl_renderer {manifest['gl_renderer']!r} there, {here['gl_renderer']!r} here"
              ] * (here.pop("gl_renderer") != manifest["gl_renderer"])
    return lines + [f"{key} is another here" for key, value in here.items()
                    if manifest[key] != json.loads(json.dumps(value))]
