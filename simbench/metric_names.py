"""The metrics that suites plot and gates guard: unit, direction, and what change is none."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from simbench.errors import UnknownName

_NOT_NUMBERS_OF_THE_ESTIMATE = ("timing", "sequence", "schema")


@dataclass(frozen=True, slots=True)
class Metric:
    """A number of metrics.json, by its dotted name."""

    name: str
    unit: str                # "" for a share or a count
    better: str              # "lower" or "higher"
    tolerance: float         # a smaller change is none: relative to the old value, or absolute
    relative: bool
    floor: float = 0.0       # relative changes are taken of no less than this
    help: str = ""

    def worsening(self, old: float, new: float) -> float:
        """How much worse `new` is: a share of `old` if relative, else in the metric's unit."""
        change = new - old if self.better == "lower" else old - new
        return change / max(abs(old), self.floor) if self.relative else change


def _error(name: str, unit: str, floor: float, text: str) -> Metric:
    return Metric(name, unit, "lower", 0.02, True, floor, text)


def _share(name: str, text: str) -> Metric:
    return Metric(name, "", "higher", 0.01, False, help=text)


_BLOCKS = (("camera", "camera"), ("camera_batch", "camera after finish"),
           ("objects.mean", "objects"), ("objects_batch.mean", "objects after finish"))

METRICS: Mapping[str, Metric] = {metric.name: metric for metric in (
    *(m for block, who in _BLOCKS for m in (
        _error(f"{block}.E_t", "m", 1e-6, f"{who}: translation error of a motion"),
        _error(f"{block}.E_R", "°", 1e-5, f"{who}: rotation error of a motion"),
        _share(f"{block}.coverage", f"{who}: share of true motions that were estimated"))),
    *(_error(f"objects.all.{key}{suffix}", unit, floor, f"all objects{against}: {what} error")
      for key, unit, floor, what in (("E_t", "m", 1e-6, "translation"),
                                     ("E_R", "°", 1e-5, "rotation"))
      for suffix, against in (("", ""), ("_rigid_fit", ", against their best rigid motion"))),
    _share("objects.all.coverage", "all objects: share of true motions that were estimated"),
    *(_error(f"{block}.ate.rmse", "m", 1e-6, f"{who}: ATE")
      for block, who in _BLOCKS[:2]),
    *(_error(f"{block}.rpe.{over}.{key}", unit, floor, f"{who}: RPE over {over}")
      for block, who in _BLOCKS[:2] for over in ("1f", "10f", "1s")
      for key, unit, floor in (("t_rmse", "m", 1e-6), ("r_rmse_deg", "°", 1e-5))),
    Metric("objects.mean.id_switches", "", "lower", 0.5, False, help="identity switches"),
    Metric("objects.mean.false_motions", "", "lower", 0.5, False,
           help="motions given to things at rest"),
    _error("flow.epe", "px", 1e-3, "end-point error of the flow given"),
    Metric("lines.static_tracklet_length", "frames", "higher", 0.02, True, 1.0,
           "mean life of a static line"),
    Metric("loops.false", "", "lower", 0.5, False, help="loops closed at another place"),
    *(Metric(f"consistency.efficiency_{of}", "", "higher", 0.05, True, 0.01,
             help=f"{of}: Cramér–Rao bound over mean squared translation error")
      for of in ("camera", "objects")),
    _share("culling.precision", "moving features among those left out"),
    _share("culling.recall", "of the moving features, those left out"),
)}

SHOWN = ("camera.E_t", "camera.E_R", "objects.mean.E_t", "objects.mean.E_R")
COVERAGES = ("camera.coverage", "objects.mean.coverage")


def find_metric(name: str) -> Metric:
    """The metric of that dotted name. Raises UnknownName with the closest."""
    if name not in METRICS:
        close = difflib.get_close_matches(name, METRICS, n=1, cutoff=0.4)
        hint = f"; did you mean {close[0]!r}?" if close else "."
        raise UnknownName(f"no metric {name!r}{hint} There are {', '.join(METRICS)}")
    return METRICS[name]


def flat_metrics(metrics: Mapping[str, Any]) -> dict[str, float]:
    """The numbers of a metrics.json by dotted names; timing and single objects left out."""
    kept = {key: value for key, value in metrics.items()
            if key not in _NOT_NUMBERS_OF_THE_ESTIMATE}
    for key in ("objects", "objects_batch"):
        if key in kept:
            kept[key] = {"mean": kept[key].get("mean", {}), "all": _of_all(kept[key])}
    return dict(_flattened("", kept))


def _of_all(objects: Mapping[str, Any]) -> dict[str, float]:
    """Means over the scored motions of all moving objects, those that deform among them.

    `*_rigid_fit` holds deforming objects against the rigid motion that fits them best; to a rigid
    object that is its own motion.
    """
    blocks = [block for key, block in objects.items()
              if key != "mean" and block.get("frames") and "E_t" in block]
    total = sum(block["frames"] for block in blocks)
    out = {}
    for name in ("E_t", "E_R"):
        for suffix in ("", "_rigid_fit"):
            values = [block.get(name + suffix, block[name]) * block["frames"] for block in blocks]
            if total:
                out[name + suffix] = sum(values) / total
    moving = sum(block.get("moving_frames", 0) for key, block in objects.items() if key != "mean")
    return out | ({"coverage": total / moving} if moving else {})


def _flattened(prefix: str, value: Any) -> Iterator[tuple[str, float]]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flattened(f"{prefix}.{key}" if prefix else str(key), inner)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield prefix, value
