"""A sequence on disk: what its folder holds, and writing it so that a file is whole or not there.

    rgb/ depth/ rgb.txt depth.txt associations.txt groundtruth.txt    exactly as TUM RGB-D has them
    instance/          16-bit PNG, true object ids; right/ where stereo was asked for
    truth.zarr         depth before the sensor, parts, poses, states, edges
    calibration.yaml   camera, PNG units per metre, baseline
    sequence.json      settings, versions, SHA-256 of every file; written last
    unfinished.json    the settings while frames are being written; gone at the end
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import zarr
from zarr.codecs import ZstdCodec

from simbench.trajectory_files import tum_lines
from simbench.types import FrameTruth, SceneLayout
from slam.geometry.arrays import Array
from slam.types import Intrinsics

SCHEMA = 1
MANIFEST, UNFINISHED, TRUTH = "sequence.json", "unfinished.json", "truth.zarr"
TEMPORARY = ".partial"                     # zarr's own suffix for what it has not renamed yet
PICTURES = ("rgb", "depth", "instance")
PER_FRAME_TRUTH = ("depth_m", "part_id", "object_pixels")

# PNG units per metre: TUM's 5000 reaches 13.1 m, the others 32 m, 65 m, 131 m, 256 m and 655 m.
DEPTH_SCALES = (5000.0, 2000.0, 1000.0, 500.0, 256.0, 100.0)
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 2]   # 3 takes 1.4 times as long for 2 % less
_ZSTD = ZstdCodec(level=3)


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file under a temporary name and rename it: it is whole or it is not there."""
    temporary = path.with_name(path.name + TEMPORARY)
    try:
        temporary.write_bytes(data)
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        # Writing, unlike opening, does not say which file it failed on.
        raise OSError(error.errno, error.strerror, str(path)) from error


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write a mapping as JSON, the same bytes for equal values."""
    write_bytes(path, (json.dumps(value, indent=1, sort_keys=True) + "\n").encode())


def write_png(path: Path, image: Array) -> None:
    """Write (H, W) uint8 or uint16, or (H, W, 3) uint8 RGB."""
    pixels = image[..., ::-1] if image.ndim == 3 else image
    _, data = cv2.imencode(".png", np.ascontiguousarray(pixels), _PNG)
    write_bytes(path, data.tobytes())


def depth_scale_for(reach_m: float) -> float:
    """The finest PNG units per metre with which depths up to `reach_m` fit in 16 bits."""
    return next((s for s in DEPTH_SCALES if reach_m * s < 65534), DEPTH_SCALES[-1])


def encode_depth(depth_m: Array, units_per_metre: float) -> Array:
    """(H, W) uint16; depths that 16 bits cannot hold become 0, no measurement, as in TUM."""
    units = np.rint(depth_m.astype(np.float64) * units_per_metre)
    return np.where(units < 65535, units, 0).astype(np.uint16)


def image_path(folder: Path, kind: str, k: int) -> Path:
    """Where the picture of frame k lies, kind being rgb, depth, instance or right."""
    return folder / kind / f"{k:06d}.png"


def truth_chunk_path(folder: Path, array: str, k: int) -> Path:
    """The one file that holds frame k of a per-frame array of truth.zarr."""
    dimensions = {"depth_m": 3, "part_id": 3, "object_pixels": 2}[array]
    return folder.joinpath(TRUTH, array, "c", str(k), *["0"] * (dimensions - 1))


def frame_is_there(folder: Path, k: int, stereo: bool) -> bool:
    """Whether every file of frame k has been written; each is whole when it exists."""
    pictures = (*PICTURES, "right") if stereo else PICTURES
    return (all(image_path(folder, kind, k).exists() for kind in pictures)
            and all(truth_chunk_path(folder, name, k).exists() for name in PER_FRAME_TRUTH))


def remove_temporaries(folder: Path) -> None:
    """Remove what a killed run had not renamed yet."""
    for path in folder.rglob("*" + TEMPORARY):
        path.unlink()


def write_lists(folder: Path, stamps_s: Array, T_world_camera: Array | None,
                known: Array | None = None) -> None:
    """rgb.txt, depth.txt, associations.txt and groundtruth.txt as TUM has them.

    Args:
        T_world_camera: (K, 4, 4); None writes no groundtruth.txt.
        known: (K,) bool, which poses to write; all of them if None.
    """
    names = {kind: [f"{kind}/{k:06d}.png" for k in range(len(stamps_s))]
             for kind in ("rgb", "depth")}
    stamps = [f"{stamp:.6f}" for stamp in stamps_s]
    for kind, files in names.items():
        rows = "".join(f"{t} {name}\n" for t, name in zip(stamps, files, strict=True))
        write_bytes(folder / f"{kind}.txt", ("# timestamp filename\n" + rows).encode())
    pairs = "".join(f"{t} {rgb} {t} {depth}\n" for t, rgb, depth in
                    zip(stamps, names["rgb"], names["depth"], strict=True))
    write_bytes(folder / "associations.txt", pairs.encode())
    if T_world_camera is None:
        return
    rows_known = slice(None) if known is None else known
    truth = "# timestamp tx ty tz qx qy qz qw\n" + tum_lines(
        stamps_s[rows_known], T_world_camera[rows_known])
    write_bytes(folder / "groundtruth.txt", truth.encode())


def write_calibration(folder: Path, intrinsics: Intrinsics, depth_scale: float,
                      baseline_m: float | None) -> None:
    """calibration.yaml of a pinhole camera without distortion."""
    i = intrinsics
    text = (f"width: {i.width}\nheight: {i.height}\n"
            f"fx: {i.fx!r}\nfy: {i.fy!r}\ncx: {i.cx!r}\ncy: {i.cy!r}\n"
            "distortion: [0.0, 0.0, 0.0, 0.0, 0.0]   # k1 k2 p1 p2 k3\n"
            f"depth_scale: {depth_scale!r}   # PNG units per metre\n")
    if baseline_m is not None:
        text += f"baseline_m: {baseline_m!r}\n"
    write_bytes(folder / "calibration.yaml", text.encode())


def write_fixed_truth(folder: Path, layout: SceneLayout, stamps_s: Array, T_world_camera: Array,
                      T_world_part: Array, states: Array) -> None:
    """truth.zarr with all that needs no rendering, and per-frame arrays ready to be filled."""
    group = zarr.open_group(folder / TRUTH, mode="a")
    fixed: dict[str, Array] = {
        "stamps_s": stamps_s, "T_world_camera": T_world_camera, "T_world_part": T_world_part,
        "state": states, "instance_of_part": layout.instance_of_part,
        "edge_part_id": layout.edges.part_id, "edge_endpoints_part": layout.edges.endpoints_part}
    with zarr.config.set({"array.write_empty_chunks": True}):
        for name, values in fixed.items():
            array = group.create_array(
                name, shape=values.shape, dtype=values.dtype, fill_value=0, overwrite=True,
                chunks=tuple(max(1, n) for n in values.shape), compressors=[_ZSTD])
            if values.size:
                array[...] = values
    frames, i = len(stamps_s), layout.intrinsics
    for name, shape, dtype in (("depth_m", (i.height, i.width), "float32"),
                               ("part_id", (i.height, i.width), "int16"),
                               ("object_pixels", (len(layout.objects),), "int32")):
        if name not in group:
            group.create_array(name, shape=(frames, *shape), dtype=dtype, fill_value=0,
                               chunks=(1, *(max(1, n) for n in shape)), compressors=[_ZSTD])


def write_frame_truth(folder: Path, truth: FrameTruth, layout: SceneLayout) -> None:
    """Depth, parts and how many pixels show each object, of one frame, one chunk each."""
    counts = np.bincount(truth.instance_id.ravel(),
                         minlength=1 + max((o.instance_id for o in layout.objects), default=0))
    values = {"depth_m": truth.depth_m, "part_id": truth.part_id,
              "object_pixels": counts[[o.instance_id for o in layout.objects]]
              if layout.objects else np.zeros(0)}
    with zarr.config.set({"array.write_empty_chunks": True}):
        group = zarr.open_group(folder / TRUTH, mode="r+")
        for name, value in values.items():
            array = group[name]
            assert isinstance(array, zarr.Array)
            array[truth.index] = value


def file_hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every file but the manifests, by its path in the folder."""
    return {path.relative_to(folder).as_posix(): file_sha256(path)
            for path in sorted(folder.rglob("*"))
            if path.is_file() and path not in (folder / MANIFEST, folder / UNFINISHED)}


def file_sha256(path: Path) -> str:
    """SHA-256 of one file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
