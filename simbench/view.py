"""Look at a sequence: in the Rerun viewer, or as one sheet of pictures."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from simbench.datasets.rows import read_numbers
from simbench.errors import UserError
from simbench.sequence import Sequence
from simbench.storage import write_bytes, write_png
from simbench.trajectory_files import read_tum_trajectory
from slam.geometry.arrays import Array
from slam.types import Frame

_ROWS = 6                # frames on a contact sheet
_CELL_WIDTH_PX = 320
_SUFFIXES = (".png", ".jpg")
_GREYED = 0.45           # how much of the image shows through a mask


def write_contact_sheet(sequence: Sequence, path: Path) -> None:
    """A PNG or JPEG: a row for each of up to six frames, with colour, depth, masks and flow.

    Masks and flow are the recording's own, else the true ones; columns without either are absent.
    Raises:
        UserError: the path ends in neither .png nor .jpg, or its folder is missing.
        BadFrame: one of the frames cannot be read.
    """
    _check_place(path)
    picks = np.unique(np.linspace(0, len(sequence) - 1, _ROWS).round().astype(int))
    rows = [[_titled(name, _shrunk(picture)) for name, picture in
             pictures(sequence, sequence.frame(int(k))).items()] for k in picks]
    width = max(len(row) for row in rows)
    blank = np.full_like(rows[0][0], 255)
    sheet = np.vstack([np.hstack(row + [blank] * (width - len(row))) for row in rows])
    if path.suffix.lower() == ".png":
        write_png(path, sheet)
        return
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(sheet[..., ::-1]))
    write_bytes(path, data.tobytes())


def _check_place(path: Path) -> None:
    if path.suffix.lower() not in _SUFFIXES:
        raise UserError(f"--contact-sheet {path}: its name must end in {' or '.join(_SUFFIXES)}")
    if not path.parent.is_dir():
        raise UserError(f"--contact-sheet {path}: there is no folder {path.parent}; make it first")


def pictures(sequence: Sequence, frame: Frame) -> dict[str, Array]:
    """(H, W, 3) uint8 pictures of a frame by what they show."""
    k = frame.index
    out = {f"frame {k}, {frame.stamp_s - sequence.stamps_s[0]:.2f} s": frame.rgb}
    measured = frame.depth_m[frame.depth_m > 0]
    if measured.size:
        far_m = float(np.quantile(measured, 0.9))
        out[f"depth, 0 to {far_m:.1f} m"] = depth_picture(frame.depth_m, far_m)
    if frame.right is not None:
        out["right"] = frame.right
    labels = frame.instance_id
    if labels is None and sequence.truth is not None:
        labels = sequence.truth.true_instances(k)
    if labels is not None:
        out["masks"] = mask_picture(frame.rgb, labels)
    flow_px = _flow_px(sequence, frame)
    if flow_px is not None:
        longest = float(np.quantile(np.linalg.norm(flow_px, axis=-1), 0.98))
        out[f"flow to here, {longest:.1f} px"] = flow_picture(flow_px, max(longest, 1e-3))
    return out


def depth_picture(depth_m: Array, far_m: float) -> Array:
    """(H, W, 3) uint8, near is red, far is blue; black where nothing was measured."""
    near_first = np.clip(255.0 * (1.0 - depth_m / far_m), 0, 255).astype(np.uint8)
    colour = cv2.applyColorMap(near_first, cv2.COLORMAP_TURBO)[..., ::-1]
    return np.where((depth_m > 0)[..., None], colour, np.uint8(0))


def mask_picture(rgb: Array, labels: Array) -> Array:
    """(H, W, 3) uint8: the image in grey, each label in a colour of its own."""
    grey = cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2GRAY)[..., None]
    hue = (labels * 67 % 180).astype(np.uint8)   # steps of 134°: neighbours differ widely
    full = np.full_like(hue, 255)
    colour = cv2.cvtColor(np.stack([hue, full, full], axis=-1), cv2.COLOR_HSV2RGB)
    mixed = (_GREYED * grey + (1.0 - _GREYED) * colour).astype(np.uint8)
    return np.where((labels > 0)[..., None], mixed, np.repeat(grey, 3, axis=-1))


def flow_picture(flow_px: Array, longest_px: float) -> Array:
    """(H, W, 3) uint8: direction as hue, length as saturation."""
    hue = (np.degrees(np.arctan2(flow_px[..., 1], flow_px[..., 0])) % 360.0 / 2.0).astype(np.uint8)
    length = np.linalg.norm(flow_px, axis=-1)
    saturation = np.clip(255.0 * length / longest_px, 0, 255).astype(np.uint8)
    return np.asarray(cv2.cvtColor(np.stack([hue, saturation, np.full_like(hue, 255)], axis=-1),
                                   cv2.COLOR_HSV2RGB))


def _flow_px(sequence: Sequence, frame: Frame) -> Array | None:
    if frame.flow is not None:
        return frame.flow.flow_px
    if frame.index > 0 and sequence.truth is not None and sequence.truth.has_images:
        return sequence.truth.flow(frame.index - 1, frame.index).flow_px
    return None


def _shrunk(picture: Array) -> Array:
    height = round(picture.shape[0] * _CELL_WIDTH_PX / picture.shape[1])
    return cv2.resize(np.ascontiguousarray(picture), (_CELL_WIDTH_PX, height),
                      interpolation=cv2.INTER_AREA)


def _titled(title: str, picture: Array) -> Array:
    strip = np.full((18, picture.shape[1], 3), 255, np.uint8)
    cv2.putText(strip, title, (3, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack([strip, picture])


def log_to_rerun(sequence: Sequence, save: Path | None = None) -> None:
    """Show colour, depth, masks and true poses in the Rerun viewer, or save them to a file.

    Raises:
        UserError: Rerun is not installed.
        BadFrame: a frame cannot be read.
    """
    rr = _started_rerun(save)
    i = sequence.intrinsics
    rr.log("world", rr.ViewCoordinates.RDF, static=True)
    rr.log("world/camera", rr.Pinhole(image_from_camera=i.matrix, width=i.width, height=i.height),
           static=True)
    for frame in (sequence.frame(k) for k in range(len(sequence))):
        rr.set_time("frame", sequence=frame.index)
        rr.set_time("stamp", duration=frame.stamp_s - float(sequence.stamps_s[0]))
        rr.log("world/camera/rgb", rr.Image(frame.rgb))
        rr.log("world/camera/depth", rr.DepthImage(frame.depth_m, meter=1.0))
        if frame.instance_id is not None:
            rr.log("world/camera/masks", rr.SegmentationImage(frame.instance_id.astype(np.uint16)))
        _log_poses(rr, sequence, frame.index)


def _log_poses(rr: Any, sequence: Sequence, k: int) -> None:
    if sequence.truth is None:
        return
    truth = sequence.truth.trajectories
    if truth.camera_valid[k]:
        T = truth.T_world_camera
        rr.log("world/camera", rr.Transform3D(translation=T[k, :3, 3], mat3x3=T[k, :3, :3]))
        rr.log("world/path", rr.LineStrips3D([T[:k + 1][truth.camera_valid[:k + 1], :3, 3]]))
    for number, poses in truth.objects.items():
        if poses.valid[k]:
            T_object = poses.T_world_object[k]
            rr.log(_object_path(poses.name or str(number)), rr.Transform3D(
                translation=T_object[:3, 3], mat3x3=T_object[:3, :3]))


def log_run_to_rerun(folder: Path, save: Path | None = None) -> None:
    """Show the estimated paths of a run's folder, camera and objects, in the Rerun viewer.

    Raises:
        UserError: Rerun is not installed.
        BadFile: trajectory.txt or objects.txt is missing or has a broken row.
    """
    stamps_s, T = read_tum_trajectory(folder / "trajectory.txt")
    objects = read_numbers(folder / "objects.txt", 9, "t track tx ty tz qx qy qz qw")
    rr = _started_rerun(save)
    rr.log("world", rr.ViewCoordinates.RDF, static=True)
    for k, stamp in enumerate(stamps_s):
        rr.set_time("stamp", duration=float(stamp - stamps_s[0]))
        rr.log("world/camera", rr.Transform3D(translation=T[k, :3, 3], mat3x3=T[k, :3, :3]))
        rr.log("world/path", rr.LineStrips3D([T[:k + 1, :3, 3]]))
        so_far = objects[objects[:, 0] <= stamp]
        for track in np.unique(so_far[:, 1]):
            rr.log(_object_path(f"track {int(track)}"),
                   rr.LineStrips3D([so_far[so_far[:, 1] == track, 2:5]]))


def _started_rerun(save: Path | None) -> Any:
    """The rerun module with a recording begun: in a viewer, or to a file. Raises UserError."""
    if importlib.util.find_spec("rerun") is None:
        raise UserError('Rerun is not installed; `pip install "simbench-slam[view]"`, or give '
                        "--contact-sheet FILE.png")
    import rerun as rr  # noqa: PLC0415 (an optional extra)
    rr.init("simbench", spawn=save is None)
    if save is not None:
        rr.save(str(save))
    return rr


def _object_path(name: str) -> str:
    return "world/objects/" + name.replace(" ", "_")
