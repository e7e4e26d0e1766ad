"""The page itself: the content, the figures and the template become one HTML text."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from importlib import metadata
from typing import Any

import jinja2
import yaml
from markupsafe import Markup, escape

from simbench.report.content import ReportContent
from simbench.report.filmstrip import Picture
from simbench.report.map_plot import map_plots
from simbench.report.plots import all_path_plots, error_plots
from simbench.report.table import error_table, shown_number, trajectory_table


def render_report(content: ReportContent) -> str:
    """The report as one self-contained HTML page: no script, nothing fetched."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("simbench.report", "templates"),
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters["indices"] = indices
    metrics = content.metrics
    return environment.get_template("report.html.j2").render(
        system=metrics.get("system", "estimate"),
        sequence=metrics.get("sequence", {}),
        tiles=_tiles(metrics, content),
        tables=[t for t in (error_table(metrics), trajectory_table(metrics)) if t.rows],
        pictures=[_shown(p) for p in content.pictures],
        errors=error_plots(content),
        paths=all_path_plots(content),
        maps=map_plots(content.map),
        stages=_stages(metrics.get("timing", {})),
        timing=metrics.get("timing", {}),
        extras=_extras(metrics),
        config=yaml.safe_dump(dict(content.config), sort_keys=False, allow_unicode=True)
        if content.config else "",
        log=list(content.log), version=_version())


def indices(text: str) -> Markup:
    """E_t and E_R with a true index."""
    safe = str(escape(text))
    for name in ("t", "R"):
        safe = safe.replace(f"E_{name}", f"E<sub>{name}</sub>")
    return Markup(safe)


def _shown(picture: Picture) -> dict[str, Any]:
    return {"uri": "data:image/jpeg;base64," + base64.b64encode(picture.jpeg).decode("ascii"),
            "width": picture.width, "height": picture.height, "caption": picture.caption,
            "alt": f"Frame {picture.index} with the points, lines and masks the system used"}


def _tiles(metrics: Mapping[str, Any], content: ReportContent) -> list[tuple[str, str, str]]:
    """The few numbers to see first: (label, value, unit)."""
    tiles: list[tuple[str, str, str]] = []
    camera, mean = metrics.get("camera", {}), metrics.get("objects", {}).get("mean", {})
    for label, block in (("Camera", camera), ("Objects", mean)):
        if "E_t" in block:
            length, unit = _length(block["E_t"])
            tiles.append((f"{label} E_t", length, unit))
            tiles.append((f"{label} E_R", shown_number(block["E_R"]), "°"))
    if "coverage" in camera:
        tiles.append(("Camera coverage", f"{100 * camera['coverage']:.3g}", "%"))
    if "coverage" in mean:
        tiles.append(("Objects coverage", f"{100 * mean['coverage']:.3g}", "%"))
    timing = metrics.get("timing", {})
    if "ms_per_frame_median" in timing:
        tiles.append(("Median frame", f"{timing['ms_per_frame_median']:.1f}", "ms"))
    lost = int((~content.camera.pose_known).sum())
    if lost:
        tiles.append(("Frames without pose", str(lost), f"of {len(content.stamps_s)}"))
    return tiles


def _length(metres: float) -> tuple[str, str]:
    return (shown_number(1e3 * metres), "mm") if metres < 0.02 else (shown_number(metres), "m")


def _stages(timing: Mapping[str, Any]) -> list[tuple[str, float, float]]:
    """(stage, mean milliseconds, share of the longest in percent), in the order they run."""
    stages = timing.get("stages_ms", {})
    longest = max(stages.values(), default=0.0)
    return [(name, ms, 100.0 * ms / longest if longest else 0.0) for name, ms in stages.items()]


def _extras(metrics: Mapping[str, Any]) -> list[tuple[str, str]]:
    lines, flow = metrics.get("lines", {}), metrics.get("flow", {})
    consistency = metrics.get("consistency", {})
    found = []
    if "static_tracklet_length" in lines:
        found.append(("Mean life of a static line",
                      f"{lines['static_tracklet_length']:.1f} frames"))
    if "epe" in flow:
        found.append(("End-point error of the flow given", f"{flow['epe']:.3g} px"))
    if "closed" in metrics.get("loops", {}):
        found.append(("Closed loops", _loops(metrics["loops"])))
    for of, whose in (("camera", "camera's"), ("objects", "objects'")):
        if f"nees_{of}" in consistency:
            found.append((f"NEES of the {whose} motions",
                          f"{consistency[f'nees_{of}']:.2f}; right: "
                          f"{consistency[f'nees_{of}_low']:.2f} to "
                          f"{consistency[f'nees_{of}_high']:.2f}"))
        if f"efficiency_{of}" in consistency:
            found.append((f"Efficiency of the {whose} motions",
                          f"{consistency[f'efficiency_{of}']:.0%} of the Cramér–Rao bound"))
    return found


def _loops(loops: Mapping[str, Any]) -> str:
    """How many, where, and whether they are true."""
    at = [f"frame {each['frame']} at frame {each['seen_before']}'s place"
          + (f", {each['error_m']:.3f} m and {each['error_deg']:.2f}° off" if "error_m" in each
             else "") for each in loops["at"]]
    false = f", {loops['false']} of them false" if loops.get("false") else ""
    return f"{loops['closed']}{false}" + (f" ({'; '.join(at)})" if at else "")


def _version() -> str:
    try:
        return metadata.version("simbench-slam")
    except metadata.PackageNotFoundError:
        return "from a checkout"
