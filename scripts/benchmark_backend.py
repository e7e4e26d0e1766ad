"""What partial and global batch make of tracking: errors against truth, and time.

    python scripts/benchmark_backend.py --scene SwingingBoxes-v0 --frames 60 --seeds 0 1 2
    python scripts/benchmark_backend.py --texture 0.1 --flow dis --beside sdpl-batch-no-lines
    python scripts/benchmark_backend.py --growth 75 150 300
    python scripts/benchmark_backend.py --flat 3000 --size 160x120 --figure docs/images/flat.png
    python scripts/benchmark_backend.py --flat 200 --set backend.anchors.static_count=800 \
        --set backend.anchors.object_count=200 --set backend.anchors.static_lines=200

Each run is scored three times: tracking alone, what `process` returned with the partial batch, and
after the global one, so that the ratios are paired. Object drift is the error of an object's motion
over ten frames, seen from the camera. --flat runs tracking and window alone, on frames that are
played forth and back, and prints what they cost, in processor time, from the first to the last;
--growth asks for the global batch after so many of them.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import t as student

from simbench.inputs import Feed, InputChoice
from simbench.metrics.motion import motion_errors
from simbench.metrics.trajectory import ate_errors, frame_pairs, rpe_errors, time_pairs
from simbench.render import make_renderer
from simbench.settings import with_settings
from simbench.simulate import SimulatedSequence
from simbench.types import Trajectories
from simbench.world import make_world
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.systems.registry import default_config, make
from slam.systems.sdpl import SdplSlam
from slam.systems.sdpl_batch import SdplBatch
from slam.types import Frame, FrameEstimate, SlamResult

FLOWS = {"pairwise": InputChoice(flow="noisy", flow_noise_kind="pairwise", flow_sigma_px=0.3),
         "localisation": InputChoice(flow="noisy", flow_noise_kind="localisation",
                                     flow_sigma_px=0.3),
         "dis": InputChoice(flow="dis")}
DRIFT_FRAMES = 10
LEAST_MOTION = 1e-3      # m, or rad: an object that moves less in a frame stands still


@dataclass(frozen=True)
class Run:
    """One sequence, tracked and refined."""

    tracked: dict[str, float]
    partial: dict[str, float]
    refined: dict[str, float]
    anchors_ms: float
    partial_ms: float
    batch_s: float


def run(scene: str, seed: int, frames: int, flow: str, texture: float,
        system_name: str = "sdpl-batch", settings: Sequence[str] = ()) -> Run:
    """A simulated sequence tracked alone, and with both batches."""
    world = make_world(scene, seed, {"texture": texture})
    renderer = make_renderer("mujoco", world)
    sequence = SimulatedSequence(world, renderer, frames)
    choice = FLOWS[flow]
    feed = Feed(sequence, InputChoice(
        flow=choice.flow, flow_noise_kind=choice.flow_noise_kind,
        flow_sigma_px=choice.flow_sigma_px, masks="truth", depth="sensor", sensor="gaussian"), seed)
    alone = SdplSlam(sequence.intrinsics)
    system = make(system_name, sequence.intrinsics,
                  with_settings(default_config(system_name), settings))
    assert isinstance(system, SdplBatch)
    owner: dict[tuple[int, int], int] = {}
    anchors, partial = [], []
    for k in range(frames):
        frame = feed.frame(k)
        alone.process(frame)
        estimate = system.process(frame)
        names = feed.true_object_of_label(k)
        owner |= {(track, k): names[motion.instance_id]
                  for track, motion in estimate.objects.items() if motion.instance_id in names}
        anchors.append(estimate.timings_ms.get("anchors", 0.0))
        partial.append(estimate.timings_ms.get("partial batch", 0.0))
    start = time.perf_counter()
    refined = system.finish()
    batch_s = time.perf_counter() - start
    truth = sequence.truth.trajectories
    scores = [camera_scores(r, truth) | object_scores(r, owner, truth)
              for r in (alone.finish(), system.tracker.finish(), refined)]
    renderer.close()
    return Run(*scores, float(np.mean(anchors[8:])), float(np.mean(partial[8:])), batch_s)


def camera_scores(result: SlamResult, truth: Trajectories) -> dict[str, float]:
    """ATE and RPE in mm."""
    T, T_true = result.T_world_camera, truth.T_world_camera[:len(result.T_world_camera)]
    second = rpe_errors(T, T_true, time_pairs(result.stamps_s, 1.0))[0]
    return {"ATE": 1e3 * float(np.sqrt(np.mean(ate_errors(T, T_true) ** 2))),
            "RPE 1 s": 1e3 * float(second.mean()) if len(second) else np.nan,
            "RPE 1 frame": 1e3 * float(rpe_errors(T, T_true, frame_pairs(len(T), 1))[0].mean())}


def object_scores(result: SlamResult, owner: dict[tuple[int, int], int],
                  truth: Trajectories) -> dict[str, float]:
    """Errors of one motion, and of ten chained, in mm and degrees, seen from the camera."""
    single, chained = [], []
    for track, motions in result.objects.items():
        H = dict(zip(motions.frames.tolist(), motions.H_world, strict=True))
        for k, one in H.items():
            true_id = owner.get((track, k))
            if true_id not in truth.objects:
                continue
            span = range(k, k + DRIFT_FRAMES)
            if _moves(truth, true_id, k):
                single.append(_object_error(result, truth, true_id, k, [one]))
            if all(j in H and owner.get((track, j)) == true_id and _moves(truth, true_id, j)
                   for j in span):
                chained.append(_object_error(result, truth, true_id, k, [H[j] for j in span]))
    first = np.mean(single, axis=0) if single else np.full(2, np.nan)
    ten = np.mean(chained, axis=0) if chained else np.full(2, np.nan)
    return {"object E_t": 1e3 * float(first[0]), "object E_R (deg)": float(first[1]),
            "object drift": 1e3 * float(ten[0]), "object drift (deg)": float(ten[1])}


def _moves(truth: Trajectories, true_id: int, k: int) -> bool:
    poses = truth.objects[true_id]
    if not (poses.valid[k] and poses.valid[k - 1]):
        return False
    M = se3.inverse(poses.T_world_object[k - 1]) @ poses.T_world_object[k]
    return bool(np.linalg.norm(M[:3, 3]) > LEAST_MOTION
                or se3.rotation_angle(M[:3, :3]) > LEAST_MOTION)


def _object_error(result: SlamResult, truth: Trajectories, true_id: int, k: int,
                  motions: Sequence[Array]) -> tuple[float, float]:
    total = np.eye(4)
    for H in motions:
        total = H @ total
    A = truth.T_world_camera[k - 1] @ se3.inverse(result.T_world_camera[k - 1])
    L = truth.objects[true_id].T_world_object
    estimated = se3.inverse(L[k - 1]) @ A @ total @ se3.inverse(A) @ L[k - 1]
    t, r = motion_errors(estimated[None],
                         (se3.inverse(L[k - 1]) @ L[k - 1 + len(motions)])[None])
    return float(t[0]), float(r[0])


@dataclass(frozen=True)
class Course:
    """What each frame of a long run costs."""

    tracking_ms: Array      # (K,) processor time of all threads
    window_ms: Array        # (K,) landmarks found again, and the partial batch
    fixed_ms: Array         # (K,) a fixed piece of work at that time: what the machine was worth
    memory_mb: Array        # (K,) resident
    landmarks: tuple[int, int, int, int]   # points: static, on objects; lines: the same


def played(scene: str, seed: int, count: int, size: tuple[int, int] | None, drawn: int = 60
           ) -> Iterator[Frame]:
    """`count` frames: `drawn` ones, forth and back, with flow from the images."""
    world = make_world(scene, seed, size=size)
    renderer = make_renderer("mujoco", world)
    feed = Feed(SimulatedSequence(world, renderer, drawn),
                InputChoice(flow="dis", masks="truth", depth="sensor", sensor="gaussian"), seed)
    frames = [feed.frame(k) for k in range(min(drawn, count))]
    renderer.close()
    turn = 2 * drawn - 2
    for k in range(count):
        at = k % turn
        yield replace(frames[min(at, turn - at)], index=k, stamp_s=k / 30.0)


def growth(scene: str, seed: int, counts: Sequence[int], settings: Sequence[str]) -> list[float]:
    """Processor time (s) of the global batch, asked for after so many frames of one run."""
    config = with_settings(default_config("sdpl-batch"), settings)
    frames = played(scene, seed, max(counts), None)
    first = next(frames)
    system = make("sdpl-batch", first.intrinsics, config)
    spent: dict[int, float] = {}
    for frame in chain([first], frames):
        system.process(frame)
        if frame.index + 1 in counts:
            if not spent:
                system.finish()                   # compiled, and the machine's caches warm
            start = time.process_time()
            system.finish()
            spent[frame.index + 1] = time.process_time() - start
    return [spent[count] for count in counts]


def course(scene: str, seed: int, count: int, size: tuple[int, int] | None,
           settings: Sequence[str]) -> Course:
    """Tracking and window alone over a long run."""
    frames = played(scene, seed, count, size)
    first = next(frames)
    config = with_settings(default_config("sdpl-partial"), settings)
    system = make("sdpl-partial", first.intrinsics, config)
    assert isinstance(system, SdplBatch)
    whole, tracking, fixed, memory = (np.zeros(count) for _ in range(4))
    matrices = np.random.default_rng(0).standard_normal((3000, 6, 6))
    track = system.tracker.process

    def timed(frame: Frame) -> FrameEstimate:
        start = time.process_time()
        estimate = track(frame)
        tracking[k] = time.process_time() - start
        return estimate

    system.tracker.process = timed           # type: ignore[method-assign]
    for k, frame in enumerate(chain([first], frames)):
        start = time.process_time()
        system.process(frame)
        whole[k] = time.process_time() - start
        np.linalg.inv(matrices)
        fixed[k] = time.process_time() - start - whole[k]
        memory[k] = _resident_mb()
    held = [seen.alive.body for seen in (system._window.points, system._window.lines)]
    points, lines = (np.bincount(body > 0, minlength=2).tolist() for body in held)
    return Course(1e3 * tracking, 1e3 * (whole - tracking), 1e3 * fixed, memory,
                  (*points, *lines))


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2.0**20


def print_course(found: Course, figure: Path | None) -> None:
    """Medians of each tenth, and the exponent by which the window's time grows."""
    tenths = np.array_split(np.arange(len(found.window_ms)), 10)
    print("landmarks at the end: {} static points, {} on objects; {} static lines, {} on objects"
          .format(*found.landmarks))
    print("frames        tracking ms   window ms   fixed work ms   memory MB")
    rows = np.array([(*(np.median(times[t]) for times in
                        (found.tracking_ms, found.window_ms, found.fixed_ms)),
                      found.memory_mb[t[-1]]) for t in tenths])
    for t, row in zip(tenths, rows, strict=True):
        print(f"{t[0]:5d} to {t[-1]:5d}{row[0]:11.1f}{row[1]:12.1f}{row[2]:16.2f}{row[3]:12.0f}")
    middle = [np.mean(t) for t in tenths]
    growth = np.polyfit(np.log(middle), np.log(rows[:, 1] / rows[:, 2]), 1)[0]
    print(f"mean of all: window {found.window_ms[8:].mean():.1f} ms; over the fixed work its time "
          f"grows with frames to the power {growth:.3f}, memory by "
          f"{np.polyfit(middle[2:], rows[2:, 3], 1)[0]:.4f} MB a frame")
    if figure is not None:
        draw_course(found, figure)


def draw_course(found: Course, path: Path) -> None:
    """Time and memory over the frames."""
    plot = Figure(figsize=(7, 4.5), layout="constrained")
    upper, lower = plot.subplots(2, 1, sharex=True)
    frames = np.arange(len(found.window_ms))
    for name, times in (("tracking", found.tracking_ms), ("window", found.window_ms),
                        ("a fixed piece of work", found.fixed_ms)):
        smooth = np.convolve(times, np.full(25, 0.04), mode="same")
        upper.plot(frames[12:-12], smooth[12:-12], lw=0.8, label=name)
    upper.set_ylabel("processor time, ms")
    upper.set_ylim(bottom=0)
    upper.legend()
    lower.plot(frames, found.memory_mb, lw=0.8)
    lower.set_ylabel("memory, MB")
    lower.set_ylim(bottom=0)
    lower.set_xlabel("frame")
    plot.savefig(path, dpi=110)


def table(runs: Sequence[Run]) -> str:
    """Errors of both batches over those of tracking."""
    head = f"{'':20s}{'':8s}{'tracked':>10s}{'refined':>10s}{'ratio':>8s}   95 %"
    return "\n".join([head, *_rows([(r.tracked, r.tracked) for r in runs], runs)])


def beside_table(runs: Sequence[Run], others: Sequence[Run]) -> str:
    """Errors of the runs over those of others on the same sequences."""
    return "\n".join(_rows([(r.partial, r.refined) for r in others], runs))


def _rows(before: Sequence[tuple[dict[str, float], dict[str, float]]], runs: Sequence[Run]
          ) -> list[str]:
    """By measure and batch: both means, and the paired ratio with its 95 % interval.

    Args:
        before: for each run what its partial and its global batch are set against.
    """
    after = [(r.partial, r.refined) for r in runs]
    lines = []
    for key, (side, name) in product(runs[0].tracked, enumerate(("partial", "global"))):
        old, new = (np.array([each[side][key] for each in both]) for both in (before, after))
        lines.append(f"{key:20s}{name:8s}{old.mean():10.4f}{new.mean():10.4f}{_ratio(old, new)}")
    return lines


def _ratio(before: Array, after: Array) -> str:
    """Geometric mean of after over before, with Student's 95 % interval."""
    ratio = np.log(after / before)
    half = (student.ppf(0.975, len(ratio) - 1) * ratio.std(ddof=1) / np.sqrt(len(ratio))
            if len(ratio) > 1 else np.nan)
    return (f"{np.exp(ratio.mean()):8.2f}   {np.exp(ratio.mean() - half):.2f} to "
            f"{np.exp(ratio.mean() + half):.2f}")


def main() -> None:
    """Print the tables asked for."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="SwingingBoxes-v0")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--flow", nargs="+", choices=sorted(FLOWS), default=sorted(FLOWS))
    parser.add_argument("--texture", type=float, default=1.0)
    parser.add_argument("--system", default="sdpl-batch", help="a preset with a batch")
    parser.add_argument("--beside", help="another preset with a batch, on the same sequences")
    parser.add_argument("--set", dest="settings", action="append", default=[],
                        metavar="STAGE.FIELD=VALUE", help="a setting of the system")
    parser.add_argument("--flat", type=int, help="frames of one long run of the window instead")
    parser.add_argument("--size", help="WIDTHxHEIGHT of the long run; else the scene's own")
    parser.add_argument("--figure", type=Path, help="where to draw the long run")
    parser.add_argument("--growth", type=int, nargs="+",
                        help="frames after which to time the global batch")
    options = parser.parse_args()
    if options.flat:
        width, height = map(int, options.size.split("x")) if options.size else (0, 0)
        print_course(course(options.scene, options.seeds[0], options.flat,
                            (width, height) if options.size else None,
                            options.settings), options.figure)
        return
    if options.growth:
        times = growth(options.scene, options.seeds[0], options.growth, options.settings)
        for n, spent in zip(options.growth, times, strict=True):
            print(f"{n:5d} frames: global batch {spent:.2f} s of processor time")
        slope = np.polyfit(np.log(options.growth), np.log(times), 1)[0]
        print(f"time of the batch grows with frames to the power {slope:.2f}")
        return
    for flow in options.flow:
        runs = [run(options.scene, seed, options.frames, flow, options.texture, options.system,
                    options.settings)
                for seed in options.seeds]
        print(f"\n{options.scene}, {options.frames} frames, seeds {options.seeds}, flow {flow}: "
              f"mm; batch {np.median([r.batch_s for r in runs]):.1f} s, anchors "
              f"{np.median([r.anchors_ms for r in runs]):.0f}, partial batch "
              f"{np.median([r.partial_ms for r in runs]):.0f} ms a frame")
        print(table(runs), flush=True)
        if options.beside:
            others = [run(options.scene, seed, options.frames, flow, options.texture,
                          options.beside, options.settings) for seed in options.seeds]
            print(f"{options.beside}, {options.system}, and the ratio of this to that:")
            print(beside_table(runs, others), flush=True)


if __name__ == "__main__":
    main()
