"""Systems by name: presets are configurations of the same stages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from typing import Any, NamedTuple, Protocol

from slam.backend.config import SdplBatchConfig
from slam.config import SdplConfig
from slam.dpl.config import DplConfig
from slam.systems.dpl import DplSlam
from slam.systems.sdpl import SdplSlam
from slam.systems.sdpl_batch import SdplBatch
from slam.types import Frame, FrameEstimate, Intrinsics, SlamResult

SystemConfig = SdplConfig | DplConfig


class SlamSystem(Protocol):
    """Anything with these two methods is a SLAM system."""

    def process(self, frame: Frame) -> FrameEstimate: ...
    def finish(self) -> SlamResult: ...


class Preset(NamedTuple):
    """A name's meaning: what it is, in a line, and the settings that make it."""

    description: str
    config: SystemConfig


_SDPL = SdplConfig()
_BATCH = SdplBatchConfig()
_DPL = DplConfig()
_STATIC = replace(_DPL, cull=replace(_DPL.cull, enabled=False))


def _with_anchors(**settings: Any) -> SdplBatchConfig:
    backend = _BATCH.backend
    return replace(_BATCH, backend=replace(backend, anchors=replace(backend.anchors, **settings)))


PRESETS: Mapping[str, Preset] = {
    "sdpl": Preset("SDPL-SLAM tracking: points and lines, static and moving", _SDPL),
    "sdpl-no-flow-opt": Preset(
        "SDPL-SLAM without optimising the flow (the paper's ablation)",
        replace(_SDPL, motion=replace(_SDPL.motion, optimise_flow=False))),
    "vdo": Preset("points only, as VDO-SLAM",
                  replace(_SDPL, segments=replace(_SDPL.segments, enabled=False))),
    "sdpl-batch": Preset("sdpl, a partial batch with every frame, and a global one at the end",
                         _BATCH),
    "sdpl-batch-no-lines": Preset(
        "sdpl-batch with points only in both batches (ablation)", _with_anchors(lines=False)),
    "sdpl-batch-static-lines": Preset(
        "sdpl-batch without lines on objects (ablation)", _with_anchors(object_lines=0)),
    "sdpl-batch-static": Preset(
        "sdpl-batch with landmarks of the static world only (ablation)",
        _with_anchors(object_count=0, object_lines=0)),
    "sdpl-partial": Preset(
        "sdpl and the partial batch alone",
        replace(_BATCH, backend=replace(_BATCH.backend, global_batch=False))),
    "sdpl-paper-batch": Preset(
        "sdpl-batch with the global batch in the paper's own formulation",
        replace(_BATCH, backend=replace(_BATCH.backend, formulation="paper"))),
    "dpl": Preset("DPL-SLAM: ORB points and LBD lines, dynamic ones removed, keyframes",
                  _DPL),
    "orb": Preset("dpl without lines and without removing anything: the static baseline",
                  replace(_STATIC, lines=replace(_STATIC.lines, enabled=False))),
    "orb-lines": Preset("dpl without removing anything: points and lines", _STATIC),
}


class UnknownSystem(KeyError):
    """No preset of this name."""

    def __str__(self) -> str:
        return str(self.args[0])


def names() -> tuple[str, ...]:
    return tuple(PRESETS)


def descriptions() -> dict[str, str]:
    return {name: preset.description for name, preset in PRESETS.items()}


def default_config(name: str) -> SystemConfig:
    """The complete settings of a preset.

    Raises:
        UnknownSystem: no such preset; the message names the closest.
    """
    if name not in PRESETS:
        closest = get_close_matches(name, PRESETS, n=1)
        hint = f"; did you mean {closest[0]!r}?" if closest else "."
        raise UnknownSystem(f"no system {name!r}{hint} There are {', '.join(PRESETS)}")
    return PRESETS[name].config


def make(name: str, intrinsics: Intrinsics, config: SystemConfig | None = None) -> SlamSystem:
    """A fresh system of this name, with its preset's settings unless `config` is given.

    Raises:
        UnknownSystem: no such preset; the message names the closest.
        TypeError: settings of another kind of system.
    """
    preset = default_config(name)
    config = preset if config is None else config
    if type(config) is not type(preset):
        raise TypeError(f"{name!r} is told by a {type(preset).__name__}, not by a "
                        f"{type(config).__name__}; start from default_config({name!r})")
    if isinstance(config, DplConfig):
        return DplSlam(intrinsics, config)
    if isinstance(config, SdplBatchConfig):
        return SdplBatch(intrinsics, config)
    return SdplSlam(intrinsics, config)
