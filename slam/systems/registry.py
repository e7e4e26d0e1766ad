"""Systems by name: presets are configurations of the same stages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from typing import NamedTuple, Protocol

from slam.backend.config import BackendConfig
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
    description: str
    config: SystemConfig
    backend: BackendConfig | None = None     # None: tracking alone


_SDPL = SdplConfig()
_BATCH = BackendConfig()
_DPL = DplConfig()
_STATIC = replace(_DPL, cull=replace(_DPL.cull, enabled=False))

PRESETS: Mapping[str, Preset] = {
    "sdpl": Preset("SDPL-SLAM tracking: points and lines, static and moving", _SDPL),
    "sdpl-no-flow-opt": Preset(
        "SDPL-SLAM without optimising the flow (the paper's ablation)",
        replace(_SDPL, motion=replace(_SDPL.motion, optimise_flow=False))),
    "vdo": Preset("points only, as VDO-SLAM",
                  replace(_SDPL, segments=replace(_SDPL.segments, enabled=False))),
    "sdpl-batch": Preset("sdpl, a partial batch with every frame, and a global one at the end",
                         _SDPL, _BATCH),
    "sdpl-batch-no-lines": Preset(
        "sdpl-batch with points only in both batches (ablation)", _SDPL,
        replace(_BATCH, anchors=replace(_BATCH.anchors, lines=False))),
    "sdpl-batch-static-lines": Preset(
        "sdpl-batch without lines on objects (ablation)", _SDPL,
        replace(_BATCH, anchors=replace(_BATCH.anchors, object_lines=0))),
    "sdpl-batch-static": Preset(
        "sdpl-batch with landmarks of the static world only (ablation)", _SDPL,
        replace(_BATCH, anchors=replace(_BATCH.anchors, object_count=0, object_lines=0))),
    "sdpl-partial": Preset("sdpl and the partial batch alone", _SDPL,
                           BackendConfig(global_batch=False)),
    "sdpl-paper-batch": Preset("sdpl-batch with the global batch in the paper's own formulation",
                               _SDPL, BackendConfig(formulation="paper")),
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
    """A fresh system of this name, with its preset's settings unless `config` is given."""
    preset = default_config(name)
    config = preset if config is None else config
    if isinstance(config, DplConfig):
        return DplSlam(intrinsics, config)
    backend = PRESETS[name].backend
    if backend is None:
        return SdplSlam(intrinsics, config)
    return SdplBatch(intrinsics, config, backend=backend)
