"""Settings of the back-end, complete with defaults."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from slam.config import SdplConfig


@dataclass(frozen=True, slots=True)
class AnchorConfig:
    """Points and lines that are found again in each frame by the picture of their first one."""

    static_count: int = 300
    object_count: int = 60            # on each object
    lines: bool = True                # False: points only
    static_lines: int = 60
    object_lines: int = 10            # on each object
    line_samples: int = 6             # patches on a line
    every: int = 10                   # frames between detections of new landmarks
    misses: int = 3                   # frames in a row without a sighting that end a landmark
    min_support: float = 0.95         # share of a patch that must lie on one surface
    max_depth_change: float = 0.1     # relative: farther off, something else is seen there


@dataclass(frozen=True, slots=True)
class BundleConfig:
    """Robust Levenberg-Marquardt over the camera's poses in a body and the body's landmarks."""

    kernel_width: float = 3.0         # of Cauchy's kernel, in standard deviations
    rounds: int = 2                   # renewals of the measured noise
    iterations: int = 8               # Levenberg-Marquardt steps a round, at most
    tolerance: float = 1e-4           # relative decrease of the objective that ends a round
    misfit_chi2: float = 5.0          # a landmark with most sightings above is left out (χ²₃)
    min_sightings: int = 2            # fewer: a landmark ties nothing together
    max_sightings: int = 60           # of a landmark in the global batch; time is their square
    # Of eq. (5), where each body is a static world: px and inverse depth, or metres as printed.
    line_form: Literal["well_conditioned", "paper"] = "well_conditioned"
    covariances: bool = False         # state those of the steps and motions that come out


@dataclass(frozen=True, slots=True)
class WindowConfig:
    """The partial batch over the last frames, renewed with every frame."""

    enabled: bool = True
    frames: int = 8
    object_every: int = 2             # frames from one renewal of an object to the next: by turns
    iterations: int = 1               # Levenberg-Marquardt steps a frame: it starts near
    noise_memory: float = 0.8         # weight of the earlier frames in the measured noise
    # Of what has left the window, each time a frame leaves: it was told with poses that err, too.
    prior_weight: float = 0.8
    # Alignments on pictures err alike (lighting that moves with the view, filtered texture), so
    # that many of them hold less than their noise claims; a window is too short to measure it.
    # Steps tracked on given flow, which has noise of its own, weigh by this factor against them.
    given_flow_weight: float = 15.0


@dataclass(frozen=True, slots=True)
class ChainConfig:
    """The paper's own formulation of the global batch: what its soft ties are worth."""

    line_form: Literal["well_conditioned", "paper"] = "well_conditioned"   # of eq. (5) and (6)
    # Of points, and of eq. (5) well conditioned: as the sensor measures, px and 1/m, or as the
    # paper does. Lines in its own form are always in metres.
    measured_in: Literal["pixels", "metres"] = "pixels"
    motion_sigma_m: float = 1e-4      # of a moved point or line: what rigidity leaves unexplained
    direction_sigma: float = 1e-4     # of 1 − cos of two directions, as printed: 0.8°
    # Objects keep their velocity but for these, as in tracking: by the square of the time between
    # frames their motion changes from one to the next.
    acceleration_m_s2: float = 2.0
    angular_acceleration_rad_s2: float = 2.0
    kernel_width: float = 3.0         # of Cauchy's kernel, in standard deviations


@dataclass(frozen=True, slots=True)
class BackendConfig:
    formulation: Literal["object_centric", "paper"] = "object_centric"   # of the global batch
    chain: ChainConfig = field(default_factory=ChainConfig)
    anchors: AnchorConfig = field(default_factory=AnchorConfig)
    window: WindowConfig = field(default_factory=WindowConfig)
    bundle: BundleConfig = field(default_factory=BundleConfig)
    global_batch: bool = True         # refine the whole run when it ends


@dataclass(frozen=True, slots=True)
class SdplBatchConfig(SdplConfig):
    """Everything SDPL-SLAM can be told: its tracking, and its back-end."""

    backend: BackendConfig = field(default_factory=BackendConfig)
