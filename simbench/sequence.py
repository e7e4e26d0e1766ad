"""A sequence: frames in order, and the truth that belongs to them."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Protocol, runtime_checkable

from simbench.errors import BadFile
from simbench.types import FlowTruth, FrameTruth, SceneLayout, Trajectories, VisibleEdges
from simbench.untrusted import check_links
from slam.geometry.arrays import Array
from slam.types import Frame, Intrinsics


class SequenceTruth(Protocol):
    """What is truly so. Only poses are known of a real recording; all of a simulated one."""

    @property
    def trajectories(self) -> Trajectories: ...
    @property
    def layout(self) -> SceneLayout | None:
        """Parts, objects and edges; None for real recordings."""
    @property
    def has_images(self) -> bool:
        """Whether `frame`, `flow`, `edges`, `part_boxes` are there (else they raise UserError)."""

    def frame(self, k: int) -> FrameTruth: ...
    def flow(self, i: int, j: int) -> FlowTruth: ...
    def edges(self, k: int) -> VisibleEdges: ...
    def part_boxes(self) -> Array:
        """(P, 2, 3) m, lowest and highest corner of each part's surface in the part's frame; NaN
        where nothing of it is drawn."""
    def true_instances(self, k: int) -> Array | None:
        """(H, W) int32 true object id per pixel, or None where it is not known."""


@runtime_checkable
class Sequence(Protocol):
    """Frames as recorded. `holds` ⊆ {"flow", "masks", "boxes", "depth", "stereo"}."""

    @property
    def name(self) -> str: ...
    @property
    def intrinsics(self) -> Intrinsics: ...
    @property
    def stamps_s(self) -> Array:
        """(K,) seconds, increasing."""
    @property
    def truth(self) -> SequenceTruth | None: ...
    @property
    def holds(self) -> frozenset[str]: ...

    def __len__(self) -> int: ...
    def frame(self, k: int) -> Frame:
        """The frame as recorded. Raises BadFrame when its files cannot be read."""
    def fingerprint(self) -> str:
        """SHA-256 of what identifies the content."""


class IteratesFrames:
    """`for frame in sequence`, for any class with `frame` and `__len__`."""

    def __iter__(self: Sequence) -> Iterator[Frame]:
        return (self.frame(k) for k in range(len(self)))


_KINDS = ("our own (sequence.json), TUM RGB-D (rgb.txt, depth.txt), KITTI odometry (calib.txt, "
          "image_0 or image_2) or VDO (times.txt, image_0, and semantic/ or settings.yaml)")
_RESULTS = {"metrics.json": "a run", "suite.json": "a suite's runs"}    # easily mistaken for one


# Imported when a folder asks for them: readers build on this module, storage on zarr.
_READERS = {"simbench": ("simbench_folder", "SimbenchFolder"), "vdo": ("vdo", "VdoFolder"),
            "kitti": ("kitti", "KittiOdometryFolder"), "tum": ("tum", "TumFolder")}


def kind_of_folder(folder: Path) -> str | None:
    """"simbench", "vdo", "kitti" or "tum", by the files in it; None when it is none of these."""
    def has(*names: str) -> bool:
        return all((folder / name).exists() for name in names)

    if has("sequence.json"):
        return "simbench"
    if has("times.txt", "image_0") and (has("semantic") or has("settings.yaml")):
        return "vdo"
    if has("calib.txt") and (has("image_0") or has("image_2")):
        return "kitti"
    if has("rgb.txt", "depth.txt"):
        return "tum"
    if has("times.txt") and (has("image_0") or has("image_2")):
        return "kitti"   # calib.txt is missing: its reader says what to give
    return None


def open_sequence(path: str | Path, calibration: str | Path | None = None) -> Sequence:
    """Open a folder as a sequence; its kind is recognised by its files.

    Args:
        path: our own sequence, a TUM RGB-D, a KITTI odometry or a VDO-layout folder, or the URL
            of one in object storage (`s3://…`; needs fsspec), which is fetched into a cache.
        calibration: a calibration.yaml that stands in for (or overrides) the folder's own.
    Raises:
        BadFile: no such folder, an unknown layout, no calibration, or a malformed file.
    """
    folder = import_module("simbench.remote").local_folder(path)
    if not folder.is_dir():
        what = "is a file, not a folder" if folder.exists() else "no such folder"
        raise BadFile(f"{folder}: {what}; give the folder of a sequence")
    check_links(folder)
    if (folder / "unfinished.json").exists():
        raise BadFile(f"{folder}: this sequence is not finished; finish it with "
                      "`simbench generate ... --resume`")
    kind = kind_of_folder(folder)
    if kind is None:
        for name, what in _RESULTS.items():
            if (folder / name).is_file():
                raise BadFile(f"{folder}: holds {what}, no sequence; give the folder of a sequence")
        raise BadFile(f"{folder}: not a sequence of a known kind; wanted {_KINDS}")
    given = None if calibration is None else Path(calibration)
    module, reader = _READERS[kind]
    opened: Sequence = getattr(import_module(f"simbench.datasets.{module}"), reader).open(
        folder, given)
    return opened
