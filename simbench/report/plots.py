"""The report's figures: paths, positions over time, errors over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from simbench.metrics.camera import gauge
from simbench.metrics.motion import moved_to_world
from simbench.metrics.objects import ObjectErrors
from simbench.report.content import ReportContent
from simbench.report.svg import INK, Drawing
from slam.geometry.arrays import Array

ESTIMATE = "#0a84c6"
LOST_SHADE = "#d1495b"
PALETTE = ("#009e73", "#e69f00", "#cc79a7", "#56b4e9", "#d55e00", "#8a7fd1", "#7f7f7f")
_AXES = "xyz"


@dataclass(frozen=True, slots=True)
class Plot:
    """One figure with the words that go with it."""

    svg: str
    title: str
    caption: str
    alt: str


@dataclass(frozen=True, slots=True)
class Path3D:
    """An estimated path beside the true one, both in the true world; NaN where unknown."""

    name: str
    time_s: Array       # (K,) since the first frame
    true: Array         # (K, 3) m
    estimated: Array    # (K, 3) m


def camera_path(content: ReportContent) -> Path3D | None:
    """The camera, laid on the truth at the first frame. Without truth: the estimate alone."""
    known = content.camera.pose_known
    if not np.any(known):
        return None
    T = content.camera.T_world_camera
    true = np.full((len(T), 3), np.nan)
    if content.truth is not None:
        S = gauge(content.camera, content.truth)
        T = T if S is None else S @ T
        valid = content.truth.camera_valid
        true[valid] = content.truth.T_world_camera[valid, :3, 3]
    return Path3D("camera", content.stamps_s - content.stamps_s[0], true,
                  np.where(known[:, None], T[:, :3, 3], np.nan))


def object_path(content: ReportContent, true_id: int) -> Path3D | None:
    """The scored motions of an object chained from its true pose where each chain begins."""
    truth = content.truth
    if truth is None:
        return None
    errors, S = content.object_errors[true_id], gauge(content.camera, truth)
    if not len(errors.frame) or S is None:
        return None
    poses = truth.objects[true_id]
    estimated = np.full((len(content.stamps_s), 3), np.nan)
    H = moved_to_world(S, content.motions.H_world[errors.row])
    L, last = np.eye(4), -1
    for k, motion in zip(errors.frame.tolist(), H, strict=True):
        if k - 1 != last:
            L = poses.T_world_object[k - 1]
            estimated[k - 1] = L[:3, 3]
        L, last = motion @ L, k
        estimated[k] = L[:3, 3]
    true = np.where(poses.valid[:, None], poses.T_world_object[:, :3, 3], np.nan)
    return Path3D(errors.name or f"object {true_id}",
                  content.stamps_s - content.stamps_s[0], true, estimated)


def path_plots(path: Path3D, how: str) -> list[Plot]:
    """The path seen along the axis in which it moves least, and each coordinate over time."""
    both = np.concatenate([path.true, path.estimated])
    reach = np.nanmax(both, axis=0) - np.nanmin(both, axis=0)
    across, up = sorted(np.argsort(reach)[-2:].tolist())
    has_truth = bool(np.any(np.isfinite(path.true)))
    to_scale = bool(reach[[across, up]].min() > 0.1 * reach[[across, up]].max())
    scale = "axes to scale" if to_scale else "axes not to scale"
    compared = "estimated (blue) against true (dashed)" if has_truth else "estimated"
    return [
        Plot(_plane(path, across, up, has_truth, to_scale), f"{path.name}: path",
             f"{_AXES[across]}–{_AXES[up]} plane of the world in metres, {scale}; {compared}. "
             f"{how}",
             f"Path of {path.name} in the {_AXES[across]}-{_AXES[up]} plane, {compared}"),
        Plot(_over_time(path, has_truth), f"{path.name}: position over time",
             f"x, y, z in metres over time in seconds; {compared}.",
             f"x, y and z of {path.name} over time, {compared}")]


def _plane(path: Path3D, across: int, up: int, has_truth: bool, to_scale: bool) -> str:
    drawing = Drawing(4.4, 3.2)
    with drawing as figure:
        axes = figure.add_subplot()
        if has_truth:
            axes.plot(path.true[:, across], path.true[:, up], color=INK, linestyle=(0, (4, 2)),
                      linewidth=1.0, label="true", zorder=3)
        axes.plot(path.estimated[:, across], path.estimated[:, up], color=ESTIMATE,
                  linewidth=2.2, label="estimated")
        first = path.estimated[np.flatnonzero(np.isfinite(path.estimated[:, 0]))[0]]
        axes.plot(first[across], first[up], "o", color=ESTIMATE, markersize=5,
                  label="start", markeredgecolor="none")
        if to_scale:
            axes.set_aspect("equal", adjustable="datalim")
        else:
            _at_least_in_both(axes, 1e-2)
        axes.set_xlabel(f"{_AXES[across]} (m)")
        axes.set_ylabel(f"{_AXES[up]} (m)")
        axes.legend(loc="best")
    return drawing.svg


def _over_time(path: Path3D, has_truth: bool) -> str:
    drawing = Drawing(4.4, 3.2)
    with drawing as figure:
        rows: Sequence[Axes] = figure.subplots(3, 1, sharex=True)
        for i, axes in enumerate(rows):
            if has_truth:
                axes.plot(path.time_s, path.true[:, i], color=INK, linestyle=(0, (4, 2)),
                          linewidth=1.0, zorder=3)
            axes.plot(path.time_s, path.estimated[:, i], color=ESTIMATE, linewidth=2.2)
            axes.set_ylabel(f"{_AXES[i]} (m)")
            axes.locator_params(axis="y", nbins=4)
            _at_least(axes, 1e-3)
        rows[-1].set_xlabel("time (s)")
        figure.align_ylabels()
    return drawing.svg


def _at_least_in_both(axes: Axes, reach: float) -> None:
    left, right = axes.get_xlim()
    if right - left < reach:
        middle = 0.5 * (left + right)
        axes.set_xlim(middle - reach / 2, middle + reach / 2)
    _at_least(axes, reach)


def _at_least(axes: Axes, height: float) -> None:
    """No zoom into numbers that do not change."""
    low, high = axes.get_ylim()
    if high - low < height:
        middle = 0.5 * (low + high)
        axes.set_ylim(middle - height / 2, middle + height / 2)


def error_plots(content: ReportContent) -> list[Plot]:
    """E_t and E_R of every frame: the camera, then the objects."""
    if content.truth is None or content.camera_errors is None:
        return []
    plots = []
    camera = content.camera_errors
    if len(camera.frame):
        floor = content.metrics.get("camera", {}).get("truth_smoothness_floor", {})
        series = [("camera", ESTIMATE, camera.frame, camera.t_m, camera.r_deg)]
        plots.append(_error_plot(content, series, "camera: error of each motion", floor))
    objects = [(i, e) for i, e in content.object_errors.items() if len(e.frame)]
    if objects:
        series = [(_label(i, e), PALETTE[n % len(PALETTE)], e.frame, e.t_m, e.r_deg)
                  for n, (i, e) in enumerate(objects)]
        plots.append(_error_plot(content, series, "objects: error of each motion", {}))
    return plots


def _label(true_id: int, errors: ObjectErrors) -> str:
    return errors.name or f"object {true_id}"


_Series = tuple[str, str, Array, Array, Array]


def _error_plot(content: ReportContent, series: list[_Series], title: str,
                floor: dict[str, Any]) -> Plot:
    time_s = content.stamps_s - content.stamps_s[0]
    small = max(float(np.max(t_m)) for _, _, _, t_m, _ in series) < 0.1
    unit, scale = ("mm", 1e3) if small else ("m", 1.0)
    drawing = Drawing(4.4, 3.2)
    with drawing as figure:
        upper, lower = figure.subplots(2, 1, sharex=True)
        for name, colour, frame, t_m, r_deg in series:
            for axes, values in ((upper, t_m * scale), (lower, r_deg)):
                gaps = np.full(len(time_s), np.nan)
                gaps[frame] = values
                axes.plot(time_s, gaps, color=colour, label=name.replace("$", r"\$"),
                          marker=".", markersize=2.5,
                          linewidth=1.0)
        for axes, key, factor, errors in (
                (upper, "E_t", scale, [t_m for _, _, _, t_m, _ in series]),
                (lower, "E_R", 1.0, [r_deg for _, _, _, _, r_deg in series])):
            if key in floor:
                axes.axhline(floor[key] * factor, color=INK, linewidth=0.8,
                             linestyle=(0, (1, 2)), label="floor of the truth")
            _scale_errors(axes, np.concatenate(errors))
            _shade_lost(axes, content, time_s)
        upper.set_ylabel(f"$E_t$ ({unit})")
        lower.set_ylabel("$E_R$ (°)")
        lower.set_xlabel("time (s)")
        if len(series) > 1 or floor:
            figure.legend(*upper.get_legend_handles_labels(), loc="outside upper center",
                          ncols=min(4, len(series) + bool(floor)))
    lost = " Red bands: frames without a camera pose." if not content.camera.pose_known.all() \
        else ""
    return Plot(drawing.svg, title,
                f"E_t in {unit} above, E_R in degrees below, over time in seconds.{lost}",
                f"{title}: translation error in {unit} and rotation error in degrees over time")


def _scale_errors(axes: Axes, values: Array) -> None:
    """From zero; by powers of ten where a few errors would flatten all others."""
    typical = float(np.median(values))
    if typical > 0.0 and values.max() > 30.0 * typical:
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0)


def _shade_lost(axes: Axes, content: ReportContent, time_s: Array) -> None:
    half = 0.5 * float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.5
    for t in time_s[~content.camera.pose_known]:
        axes.axvspan(t - half, t + half, color=LOST_SHADE, alpha=0.25, linewidth=0)


def all_path_plots(content: ReportContent) -> list[Plot]:
    """Camera first, then each object with scored motions."""
    plots: list[Plot] = []
    camera = camera_path(content)
    if camera is not None:
        plots += path_plots(camera, "Both start together." if content.truth else "")
    for true_id in content.object_errors:
        path = object_path(content, true_id)
        if path is not None:
            plots += path_plots(path, "Motions chained from the true pose where they begin.")
    return plots


