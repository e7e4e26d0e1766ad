"""What a system is given: flow, masks, boxes and depth that are true, noisy or estimated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from simbench.detections import Detections
from simbench.errors import UserError
from simbench.input_choice import CHOICES, InputChoice, Rendered, resolve_choice
from simbench.metrics.efficiency import GaussianNoise
from simbench.sensors.depth import GaussianDepth, apply_depth_noise, clean_depth
from simbench.sensors.flow import FlowNoise, NoiseField, draw_noise, flow_noise
from simbench.sensors.hsv import hsv_masks
from simbench.sensors.masks import majority_objects, mask_noise, shuffle_labels
from simbench.sensors.rgb import apply_rgb_noise
from simbench.sensors.spec import find_sensor
from simbench.sensors.streams import Stage, generator
from simbench.sequence import Sequence, SequenceTruth
from slam.geometry.arrays import Array
from slam.types import Boxes2D, FlowField, Frame, Intrinsics

__all__ = ["CHOICES", "Feed", "InputChoice", "resolve_choice"]


class Feed:
    """The frames that a system sees of a sequence, and whose label is whose."""

    def __init__(self, sequence: Sequence, choice: InputChoice, seed: int = 0,
                 frames: int | None = None) -> None:
        """
        Args:
            seed: of all noise and shuffling; equal seeds give equal bytes.
            frames: only the first so many.
        Raises:
            UserError: the sequence cannot give what is chosen.
        """
        if frames is not None and frames < 1:
            raise UserError(f"--frames {frames}: wanted 1 or more")
        if seed < 0:
            raise UserError(f"--seed {seed}: wanted 0 or more")
        self.sequence = sequence
        self.choice = resolve_choice(choice, sequence)
        self.seed = seed
        self.sensor = find_sensor(choice.sensor or "ideal", choice.sensor_settings)
        self.flow_noise = _flow_noise(self.sensor.flow, choice)
        self._detections = Detections(sequence, self.choice, self.sensor.boxes, seed)
        self._rendered = sequence if isinstance(sequence, Rendered) else None
        if self.sensor.exposure_s > 0 and self._rendered is None:
            raise UserError(f"--sensor {self.sensor.name}: motion blur must be rendered, and "
                            f"{sequence.name} is on disk; generate it with this sensor")
        self._dense_stereo = True
        self._length = len(sequence) if frames is None else min(frames, len(sequence))
        self._objects: dict[int, dict[int, int]] = {}
        self._recorded: dict[int, Frame] = {}
        self._noise: dict[int, NoiseField] = {}

    @property
    def intrinsics(self) -> Intrinsics:
        return self.sequence.intrinsics

    @property
    def gaussian_noise(self) -> GaussianNoise | None:
        """The noise of flow and depth, where both have white Gaussian noise of known size."""
        flow, depth = self.flow_noise, self.sensor.depth
        known = (self.choice.flow == "noisy" and flow.sigma_px > 0 and flow.shape == "isotropic"
                 and flow.correlation_px == 0 and self.choice.depth == "sensor"
                 and isinstance(depth, GaussianDepth) and depth.sigma_m_at_1m > 0)
        if not known or not isinstance(depth, GaussianDepth):
            return None
        # σ_z = s z² is s in 1/z.
        return GaussianNoise(flow.sigma_px, depth.sigma_m_at_1m)

    def __len__(self) -> int:
        return self._length

    def leave_stereo_to(self, system: object) -> None:
        """Give a system that says `matches_stereo` the pairs alone where depth is from stereo."""
        self._dense_stereo = not getattr(system, "matches_stereo", False)

    def frame(self, k: int) -> Frame:
        """Frame k as the system sees it; frame 0 has no flow.

        Raises:
            BadFrame: its files cannot be read.
            IndexError: k is not within the feed.
        """
        if not 0 <= k < self._length:
            raise IndexError(f"frame {k} of {self._length}")
        rgb = self._rgb(k)
        labels, self._objects[k] = self._masks(rgb, k)
        right = self._right(k) if "stereo" in self.sequence.holds else None
        return Frame(
            index=k, stamp_s=float(self.sequence.stamps_s[k]), rgb=rgb,
            depth_m=clean_depth(self._depth(rgb, right, k)), intrinsics=self.intrinsics,
            instance_id=labels, boxes=self._boxes(rgb, k),
            flow=None if k == 0 else self._flow(k), right=right)

    def true_object_of_label(self, k: int) -> dict[int, int]:
        """Mask label in frame k → true instance id; labels that stand on no object are absent.

        Raises:
            BadFrame: the frame's files cannot be read.
        """
        if k not in self._objects:
            self._objects[k] = self._masks(self._rgb(k), k)[1]
        return dict(self._objects[k])

    @property
    def _truth(self) -> SequenceTruth:
        if self.sequence.truth is None:
            raise UserError(f"{self.sequence.name} has no truth")
        return self.sequence.truth

    def _record(self, k: int) -> Frame:
        return _kept(self._recorded, k, lambda: self.sequence.frame(k))

    def _picture(self, k: int) -> Array:
        """The image before the sensor; a rendered sequence need not make the rest of its frame."""
        return self._record(k).rgb if self._rendered is None else self._rendered.rgb(k)

    def _rgb(self, k: int) -> Array:
        if self.sensor.exposure_s > 0 and self._rendered is not None:
            rgb = self._rendered.render_blurred(k, self.sensor.exposure_s,
                                                self.sensor.exposure_subframes)
        else:
            rgb = self._picture(k)
        if self.sensor.rgb is None:
            return rgb
        return apply_rgb_noise(rgb, self.sensor.rgb, generator(self.seed, Stage.RGB, k))

    def _right(self, k: int) -> Array | None:
        right = self._record(k).right
        if right is None or self.sensor.rgb is None:
            return right
        return apply_rgb_noise(right, self.sensor.rgb, generator(self.seed, Stage.RGB_RIGHT, k))

    def _depth(self, rgb: Array, right: Array | None, k: int) -> Array:
        kind = self.choice.depth
        if kind == "given":
            return self._record(k).depth_m
        if kind == "stereo":
            if not self._dense_stereo:
                return np.zeros(rgb.shape[:2], np.float32)
            return _stereo_depth(rgb, right, self.intrinsics)
        depth_m = self._truth.frame(k).depth_m
        if kind == "truth":
            return depth_m
        return apply_depth_noise(depth_m, self.intrinsics, self.sensor.depth,
                                 generator(self.seed, Stage.DEPTH, k))

    def _masks(self, rgb: Array, k: int) -> tuple[Array | None, dict[int, int]]:
        """(H, W) int32 labels, and the true object of each."""
        kind = self.choice.masks
        if kind == "none":
            return None, {}
        true = None if self.sequence.truth is None else self.sequence.truth.true_instances(k)
        if kind in ("truth", "noisy"):
            masks = true
        else:
            masks = self._record(k).instance_id if kind == "given" else hsv_masks(rgb)
        if masks is None:
            return None, {}
        if kind == "noisy":
            masks = mask_noise(masks, self.sensor.masks, generator(self.seed, Stage.MASKS, k))
        if self.choice.shuffle_labels:
            masks, _ = shuffle_labels(masks, generator(self.seed, Stage.LABELS, k))
        return masks, {} if true is None else majority_objects(masks, true)

    def _boxes(self, rgb: Array, k: int) -> Boxes2D | None:
        if self.choice.boxes == "given":
            return self._record(k).boxes
        return self._detections(rgb, k)

    def _flow(self, k: int) -> FlowField | None:
        kind = self.choice.flow
        if kind == "dis":
            return None
        if kind == "given":
            return self._record(k).flow
        flow = self._truth.flow(k - 1, k)
        if kind == "truth":
            return FlowField(flow.flow_px, flow.valid & ~flow.leaving)
        if self.flow_noise.kind == "pairwise":
            return flow_noise(flow, self.flow_noise, self.seed, k, self._noise_field(k, k - 1))
        return flow_noise(flow, self.flow_noise, self.seed, k, self._noise_field(k - 1, k - 1),
                          self._noise_field(k, k))

    def _noise_field(self, key: int, image: int) -> NoiseField:
        """The noise drawn for frame `key`, shaped by the image of frame `image`."""
        rgb = self._picture(image) if self.flow_noise.shape == "structure" else None
        size = (self.intrinsics.height, self.intrinsics.width)
        return _kept(self._noise, key,
                     lambda: draw_noise(self.flow_noise, self.seed, key, size, rgb))


def _flow_noise(noise: FlowNoise, choice: InputChoice) -> FlowNoise:
    sigma = noise.sigma_px if choice.flow_sigma_px is None else choice.flow_sigma_px
    return replace(noise, sigma_px=sigma, kind=choice.flow_noise_kind or noise.kind,
                   shape=choice.flow_noise_shape or noise.shape)


def _stereo_depth(left: Array, right: Array | None, intrinsics: Intrinsics) -> Array:
    from slam.frontend.stereo import depth_from_stereo  # noqa: PLC0415 (only where it is used)
    if right is None or intrinsics.baseline_m is None:
        return np.zeros(left.shape[:2], np.float32)
    return depth_from_stereo(left, right, intrinsics)


_Kept = TypeVar("_Kept")


def _kept(store: dict[int, _Kept], k: int, make: Callable[[], _Kept]) -> _Kept:
    """What `make` gives for frame k; the last two frames' are kept, as flow joins two frames."""
    if k not in store:
        value = make()
        for old in [key for key in store if abs(key - k) > 1]:
            del store[old]
        store[k] = value
    return store[k]
