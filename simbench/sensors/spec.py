"""Sensors by name: each says what a camera, a flow and a detector do to the truth."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

from simbench.errors import UnknownName, UserError
from simbench.sensors.depth import DepthModel, GaussianDepth, KinectDepth, StereoDepth
from simbench.sensors.flow import FlowNoise
from simbench.sensors.masks import MaskNoise
from simbench.sensors.rgb import RgbNoise


@dataclass(frozen=True, slots=True)
class SensorSpec:
    """One sensor. `flow` and `masks` only act where noisy flow or masks are asked for."""

    name: str
    help: str
    depth: DepthModel | None = None
    rgb: RgbNoise | None = None
    exposure_s: float = 0.0        # > 0: motion blur; the stamp is mid-exposure
    exposure_subframes: int = 8    # pictures averaged over an exposure
    flow: FlowNoise = field(default_factory=FlowNoise)
    masks: MaskNoise = field(default_factory=MaskNoise)


SENSORS: Mapping[str, SensorSpec] = {spec.name: spec for spec in (
    SensorSpec("ideal", "Exact depth and noiseless colour."),
    SensorSpec("gaussian", "White depth noise of 0.002 z² m: the setting of the accuracy tables.",
               depth=GaussianDepth()),
    SensorSpec("kinect", "Structured light: axial and lateral noise, disparity steps, shadows.",
               depth=KinectDepth(), rgb=RgbNoise(full_well_e=8_000.0, read_dn=1.5)),
    SensorSpec("realsense", "Active stereo: smooth noise z² · subpixel / (f B), shadows.",
               depth=StereoDepth(), rgb=RgbNoise(full_well_e=10_000.0, read_dn=1.0)),
    SensorSpec("handheld", "The realsense sensor with 10 ms of exposure: moving things blur.",
               depth=StereoDepth(), rgb=RgbNoise(full_well_e=10_000.0, read_dn=1.0),
               exposure_s=0.010),
)}


def find_sensor(name: str, settings: Mapping[str, Any] | None = None) -> SensorSpec:
    """The sensor of that name, with single figures changed.

    Args:
        settings: dotted field → value, such as `{"depth.sigma_m_at_1m": 0.004, "exposure_s": 0}`.
    Raises:
        UnknownName: there is no such sensor or setting.
    """
    if name not in SENSORS:
        closest = difflib.get_close_matches(name, SENSORS, n=1, cutoff=0.0)[0]
        raise UnknownName(f"no sensor {name!r}; did you mean {closest!r}? "
                          f"There are: {', '.join(SENSORS)}.")
    spec = SENSORS[name]
    for path, value in (settings or {}).items():
        spec = _with_setting(spec, path.split("."), value, f"sensor {name}: {path}")
    return spec


def _with_setting(node: Any, path: list[str], value: Any, where: str) -> Any:
    names = [f.name for f in fields(node) if f.name not in ("name", "help")]
    if path[0] not in names:
        raise UnknownName(f"{where}: no setting {path[0]!r}; there are: {', '.join(names)}.")
    old = getattr(node, path[0])
    if len(path) > 1:
        if not is_dataclass(old):
            raise UnknownName(f"{where}: {path[0]!r} has no settings of its own here.")
        return replace(node, **{path[0]: _with_setting(old, path[1:], value, where)})
    if is_dataclass(old) or old is None:
        raise UserError(f"{where}: {path[0]!r} is a group; name one of its settings.")
    try:
        return replace(node, **{path[0]: type(old)(value)})
    except (TypeError, ValueError) as error:
        raise UserError(f"{where}: wanted a {type(old).__name__}, got {value!r}.") from error
