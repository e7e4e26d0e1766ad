"""The table of errors, as rows of text for the terminal and the page alike."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

NONE = "–"


@dataclass(frozen=True, slots=True)
class ErrorTable:
    """A heading with units, and rows of text; an absent value is a dash."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]


def error_table(metrics: Mapping[str, Any]) -> ErrorTable:
    """Camera and each object: E_t, E_R, the same without drift, and coverage."""
    unit, scale = _unit(metrics)
    columns = ("", f"E_t ({unit})", "E_R (°)", f"E_t local ({unit})", "E_R local (°)",
               "coverage (%)")
    rows = tuple((name, shown_number(block.get("E_t"), scale), shown_number(block.get("E_R")),
                  shown_number(block.get("E_t_local"), scale), shown_number(block.get("E_R_local")),
                  _percent(block.get("coverage"))) for name, block in _blocks(metrics))
    return _without_empty_columns(columns, rows, tuple(_notes(metrics, unit, scale)))


def trajectory_table(metrics: Mapping[str, Any]) -> ErrorTable:
    """The camera's ATE and RPE over each Δ, root mean squares."""
    unit, scale = _unit(metrics)
    columns = ["", f"ATE ({unit})"]
    for over in ("1 frame", "10 frames", "1 s"):
        columns += [f"RPE {over} ({unit})", f"RPE {over} (°)"]
    rows = []
    for name, block in _blocks(metrics):
        if "ate" not in block:
            continue
        row = [name, shown_number(block["ate"]["rmse"], scale)]
        for key in ("1f", "10f", "1s"):
            rpe = block.get("rpe", {}).get(key, {})
            row += [shown_number(rpe.get("t_rmse"), scale), shown_number(rpe.get("r_rmse_deg"))]
        rows.append(tuple(row))
    return _without_empty_columns(tuple(columns), tuple(rows), ())


def _unit(metrics: Mapping[str, Any]) -> tuple[str, float]:
    """Millimetres where the first E_t, mostly the camera's, is below 2 cm, else metres."""
    small = next((b["E_t"] for _, b in _blocks(metrics) if "E_t" in b), 0.0) < 0.02
    return ("mm", 1e3) if small else ("m", 1.0)


def _without_empty_columns(columns: tuple[str, ...], rows: tuple[tuple[str, ...], ...],
                           notes: tuple[str, ...]) -> ErrorTable:
    kept = [i for i in range(len(columns)) if i == 0 or any(row[i] != NONE for row in rows)]
    if len(kept) == 1:     # names alone say nothing
        return ErrorTable((), (), notes)
    return ErrorTable(tuple(columns[i] for i in kept),
                      tuple(tuple(row[i] for i in kept) for row in rows), notes)


def _blocks(metrics: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    no_object_motion = _has_no_object_motion(metrics)
    for suffix, label in (("", ""), ("_batch", " after finish")):
        if suffix and _same(metrics):
            return
        if f"camera{suffix}" in metrics:
            yield f"camera{label}", metrics[f"camera{suffix}"]
        objects = metrics.get(f"objects{suffix}", {})
        if no_object_motion:
            if not suffix:     # a row for each, before and after `finish`, would say the same
                yield "all objects", {"coverage": 0.0}
            continue
        for key, block in objects.items():
            if key != "mean" and block.get("moving_frames"):
                yield _object_name(key, block) + label, block
        if "coverage" in objects.get("mean", {}) and len(objects) > 2:
            yield f"all objects{label}", objects["mean"]


def _has_no_object_motion(metrics: Mapping[str, Any]) -> bool:
    """Objects move, and the system estimated no motion at all, of these or of anything else."""
    blocks = [metrics.get(key, {}) for key in ("objects", "objects_batch")]
    means = [objects.get("mean", {}) for objects in blocks]
    given = (*(block.get("frames") for objects in blocks for block in objects.values()),
             *(mean.get("false_motions") for mean in means),
             *(mean.get("tracks_without_object") for mean in means))
    return _true_motions(metrics) > 0 and not any(given)


def _true_motions(metrics: Mapping[str, Any]) -> int:
    return sum(block.get("moving_frames", 0) for block in metrics.get("objects", {}).values())


def _same(metrics: Mapping[str, Any]) -> bool:
    """`finish` refined nothing: a second set of equal rows would say nothing."""
    one, other = (metrics.get(key, {}) for key in ("camera", "camera_batch"))
    return all(abs(one.get(key, 0.0) - other.get(key, 0.0)) < 1e-12 for key in ("E_t", "E_R")) \
        and one.get("ate") == other.get("ate")


def _object_name(key: str, block: Mapping[str, Any]) -> str:
    text = block.get("name") or f"object {key}"
    return text if block.get("rigid", True) else f"{text}, not rigid"


def _notes(metrics: Mapping[str, Any], unit: str, scale: float) -> Iterator[str]:
    objects = metrics.get("objects", {})
    no_object_motion = _has_no_object_motion(metrics)
    if no_object_motion:
        yield f"No motion of an object was estimated (true motions: {_true_motions(metrics)})."
    floors = [(name, block["truth_smoothness_floor"])
              for name, block in [("camera", metrics.get("camera", {})),
                                  *((_object_name(k, b), b) for k, b in objects.items()
                                    if not no_object_motion)]
              if "truth_smoothness_floor" in block]
    if floors:
        listed = ", ".join(f"{name} {shown_number(floor['E_t'], scale)} {unit} / "
                           f"{shown_number(floor['E_R'])}°" for name, floor in floors)
        yield ("A straight line through the true motions themselves, with no vision at all, "
               f"scores {listed}. E below that may come of smoothing; the RPE over 10 frames "
               "tells.")
    still = [_object_name(k, b) for k, b in objects.items()
             if k != "mean" and not b.get("moving_frames", 1)]
    if still:
        more = f" and {len(still) - 6} more" if len(still) > 6 else ""
        yield f"Never seen to move, so without errors: {', '.join(still[:6])}{more}."
    fits = [f"{_object_name(k, b)} {shown_number(b['E_t_rigid_fit'], scale)} {unit} / "
            f"{shown_number(b['E_R_rigid_fit'])}°"
            for k, b in objects.items() if "E_t_rigid_fit" in b]
    if fits:
        yield ("Against the rigid motion that best fits their visible points, not that of their "
               f"root: {', '.join(fits)}.")
    mean = objects.get("mean", {})
    counts = [f"{mean[key]} {text}" for key, text in (
        ("id_switches", "identity switches"),
        ("false_motions", "motions given to objects at rest"),
        ("tracks_without_object", "tracks on no object")) if mean.get(key)]
    if counts:
        yield f"Counted besides: {', '.join(counts)}."


def shown_number(value: float | None, scale: float = 1.0) -> str:
    """Three significant digits (two below a thousandth), never in powers of ten above 1e-6."""
    if value is None:
        return NONE
    value *= scale
    if value == 0.0:
        return "0"
    if abs(value) < 1e-6:
        return "<1e-6"
    if abs(value) >= 1000:
        return f"{value:.0f}"
    exponent = int(f"{abs(value):.2e}".split("e")[1])
    digits = (1 if exponent < -3 else 2) - exponent
    return f"{value:.{max(0, digits)}f}"


def _percent(value: float | None) -> str:
    return NONE if value is None else f"{100 * value:.3g}"
