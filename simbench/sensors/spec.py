"""Sensors by name: each says what a camera, a flow and a detector do to the truth."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from simbench.errors import UnknownName
from simbench.sensors.boxes import BoxNoise
from simbench.sensors.depth import DepthModel, GaussianDepth, KinectDepth, StereoDepth
from simbench.sensors.flow import FlowNoise
from simbench.sensors.masks import MaskNoise
from simbench.sensors.rgb import RgbNoise
from simbench.settings import with_settings


@dataclass(frozen=True, slots=True)
class SensorSpec:
    """One sensor. `flow`, `masks` and `boxes` only act where noisy ones are asked for."""

    name: str
    help: str
    depth: DepthModel | None = None
    rgb: RgbNoise | None = None
    exposure_s: float = 0.0        # > 0: motion blur; the stamp is mid-exposure
    exposure_subframes: int = 8    # pictures averaged over an exposure
    flow: FlowNoise = field(default_factory=FlowNoise)
    masks: MaskNoise = field(default_factory=MaskNoise)
    boxes: BoxNoise = field(default_factory=BoxNoise)


def _reach(depth: KinectDepth | StereoDepth) -> str:
    return f"no depth beyond {depth.max_m:g} m, for rooms"


SENSORS: Mapping[str, SensorSpec] = {spec.name: spec for spec in (
    SensorSpec("ideal", "Exact depth and noiseless colour."),
    SensorSpec("gaussian", "White depth noise of 0.002 z² m: the setting of the accuracy tables.",
               depth=GaussianDepth()),
    SensorSpec("kinect", "Structured light: axial and lateral noise, disparity steps, shadows; "
               f"{_reach(KinectDepth())}.",
               depth=KinectDepth(), rgb=RgbNoise(full_well_e=8_000.0, read_dn=1.5)),
    SensorSpec("realsense", "Active stereo: smooth noise z² · subpixel / (f B), shadows; "
               f"{_reach(StereoDepth())}.",
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
        UserError: a value that is not of the setting's type.
    """
    if name not in SENSORS:
        close = difflib.get_close_matches(name, SENSORS, n=1, cutoff=0.5)
        hint = f"; did you mean {close[0]!r}? There" if close else "; there"
        raise UnknownName(f"no sensor {name!r}{hint} are: {', '.join(SENSORS)}.")
    given = (f"{path}={value}" for path, value in (settings or {}).items())
    return with_settings(SENSORS[name], given)
