"""The feed: every choice gives what it says, falls back as documented, and repeats itself."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simbench.errors import BadFrame, UnknownName, UserError
from simbench.inputs import CHOICES, Feed, InputChoice
from simbench.render import make_renderer
from simbench.sensors import hsv_masks
from simbench.sequence import open_sequence
from simbench.simulate import SimulatedSequence
from simbench.world import make_world
from slam.dynamics.detection import COCO_CLASSES
from slam.types import FlowField, Frame, Intrinsics

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


@pytest.fixture(scope="module")
def simulated():
    world = make_world("SwingingBoxes-v0", seed=0, size=(160, 120))
    renderer = make_renderer("mujoco", world)
    yield SimulatedSequence(world, renderer, 6)
    renderer.close()


class Recording:
    """Frames in memory, as a real recording gives them: no truth."""

    name = "recording"
    truth = None

    def __init__(self, *held: str, broken: int | None = None) -> None:
        self.holds = frozenset(held)
        self.broken = broken
        self.intrinsics = Intrinsics(20.0, 20.0, 15.5, 11.5, 32, 24, 0.1)
        self.stamps_s = np.arange(4) / 10.0

    def __len__(self) -> int:
        return 4

    def frame(self, k: int) -> Frame:
        if k == self.broken:
            raise BadFrame("image 2.png is truncated")
        rgb = np.random.default_rng(0).integers(0, 255, (24, 32 + 8, 3), dtype=np.uint8)
        depth = np.full((24, 32), 2.0, np.float32)
        depth[0, :4] = np.nan, np.inf, -1.0, -np.inf
        masks = np.zeros((24, 32), np.int32)
        masks[:5], masks[10:15] = 3, 7
        flow = FlowField(np.full((24, 32, 2), 1.0, np.float32))
        return Frame(k, float(self.stamps_s[k]), rgb[:, :32], depth, self.intrinsics,
                     masks if "masks" in self.holds else None,
                     flow=flow if "flow" in self.holds and k else None,
                     right=rgb[:, 4:36] if "stereo" in self.holds else None)

    def fingerprint(self) -> str:
        return "0"


def exact_flow(sequence, k):
    truth = sequence.truth.flow(k - 1, k)
    return truth.flow_px, truth.valid & ~truth.leaving


def test_defaults_are_what_the_sequence_holds(simulated):
    feed = Feed(simulated, InputChoice())
    frame = feed.frame(2)
    flow, valid = exact_flow(simulated, 2)
    np.testing.assert_array_equal(frame.flow.flow_px, flow)
    np.testing.assert_array_equal(frame.flow.valid, valid)
    np.testing.assert_array_equal(frame.depth_m, simulated.truth.frame(2).depth_m)
    assert frame.boxes is None
    assert len(feed) == 6
    assert feed.frame(0).flow is None
    recorded = Feed(Recording("depth"), InputChoice())
    assert (recorded.choice.flow, recorded.choice.masks) == ("dis", "none")
    assert recorded.frame(1).flow is None
    assert recorded.frame(1).instance_id is None
    assert Feed(Recording("stereo"), InputChoice()).choice.depth == "stereo"


def test_labels_lead_back_to_the_true_objects(simulated):
    feed = Feed(simulated, InputChoice(masks="truth"))
    maps = []
    for k in range(6):
        true = simulated.truth.true_instances(k)
        labels, true_of = feed.frame(k).instance_id, feed.true_object_of_label(k)
        maps.append(tuple(sorted(true_of.items())))
        table = np.array([true_of.get(label, 0) for label in range(labels.max() + 1)])
        np.testing.assert_array_equal(table[labels], true)
    assert len(set(maps)) > 1                       # shuffled from frame to frame
    assert Feed(simulated, InputChoice(masks="truth")).true_object_of_label(3) == dict(maps[3])
    plain = Feed(simulated, InputChoice(masks="truth", shuffle_labels=False))
    np.testing.assert_array_equal(plain.frame(1).instance_id, simulated.truth.true_instances(1))


def test_noisy_flow_is_truth_plus_the_chosen_noise(simulated):
    choice = InputChoice(flow="noisy", flow_sigma_px=0.7, flow_noise_kind="localisation")
    field = Feed(simulated, choice, seed=4).frame(3).flow
    flow, valid = exact_flow(simulated, 3)
    clear = valid & ~simulated.truth.flow(2, 3).occluded
    assert np.std((field.flow_px - flow)[clear]) == pytest.approx(0.7, rel=0.05)
    np.testing.assert_array_equal(field.valid, valid)
    np.testing.assert_allclose(field.sigma_px, 0.7, rtol=1e-5)


def test_localisation_noise_of_a_frame_serves_both_of_its_flows(simulated):
    """Forgetting and drawing again gives the same n_k: frames may be asked for in any order."""
    choice = InputChoice(flow="noisy", flow_noise_kind="localisation")
    onward = Feed(simulated, choice, seed=1)
    flows = [onward.frame(k).flow for k in range(1, 6)]
    for k in (5, 2, 3):
        again = Feed(simulated, choice, seed=1).frame(k).flow
        np.testing.assert_array_equal(again.flow_px, flows[k - 1].flow_px)


def test_a_change_of_one_stage_changes_no_other(simulated):
    base = InputChoice(flow="noisy", masks="noisy", depth="sensor", sensor="kinect")
    one = Feed(simulated, base, seed=2).frame(2)
    for other, same in (
            (replace(base, flow="truth"), ("rgb", "depth_m", "instance_id")),
            (replace(base, masks="truth"), ("rgb", "depth_m")),
            (replace(base, sensor="gaussian"), ("instance_id",)),
            (replace(base, flow_noise_kind="localisation"), ("rgb", "depth_m", "instance_id"))):
        two = Feed(simulated, other, seed=2).frame(2)
        for name in same:
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    unmasked = Feed(simulated, replace(base, masks="none"), seed=2).frame(2)
    np.testing.assert_array_equal(one.flow.flow_px, unmasked.flow.flow_px)


def test_equal_seeds_give_equal_bytes(simulated):
    choice = InputChoice(flow="noisy", masks="noisy", depth="sensor", sensor="realsense",
                         flow_noise_shape="structure")

    def frame_bytes(seed: int) -> list[bytes]:
        frame = Feed(simulated, choice, seed).frame(2)
        return [frame.rgb.tobytes(), frame.depth_m.tobytes(), frame.flow.flow_px.tobytes()]

    assert frame_bytes(1) == frame_bytes(1)
    assert all(a != b for a, b in zip(frame_bytes(1), frame_bytes(2), strict=True))


def test_truth_stays_as_it_is(simulated):
    truth = simulated.truth.frame(2)
    before = truth.depth_m.copy(), truth.instance_id.copy(), simulated.rgb(2).copy()
    frame = Feed(simulated, InputChoice(flow="noisy", masks="noisy", sensor="kinect")).frame(2)
    assert not np.array_equal(frame.depth_m, before[0])
    assert not np.array_equal(frame.rgb, before[2])
    for now, then in zip((truth.depth_m, truth.instance_id, simulated.rgb(2)), before, strict=True):
        np.testing.assert_array_equal(now, then)
    with pytest.raises(ValueError, match="read-only"):
        frame.depth_m[0, 0] = 1.0


def test_sensor_settings_reach_the_depth(simulated):
    choice = InputChoice(sensor="gaussian", sensor_settings={"depth.sigma_m_at_1m": 0.01})
    frame = Feed(simulated, choice).frame(1)
    true = simulated.truth.frame(1).depth_m
    seen = true > 0
    error = (frame.depth_m[seen] - true[seen]) / true[seen] ** 2
    assert error.std() == pytest.approx(0.01, rel=0.03)


def test_motion_blur_is_rendered(simulated):
    sharp = Feed(simulated, InputChoice(sensor="realsense")).frame(3)
    blurred = Feed(simulated, InputChoice(sensor="handheld")).frame(3)
    assert not np.array_equal(sharp.rgb, blurred.rgb)
    np.testing.assert_array_equal(sharp.depth_m, blurred.depth_m)
    assert sharp.stamp_s == blurred.stamp_s


class OnDisk(Recording):
    """What a folder of ours is to the feed: pictures as they are, and exact truth."""

    def __init__(self, simulated) -> None:
        super().__init__("depth", "masks")
        self.truth = simulated.truth


def test_motion_blur_cannot_be_made_from_files(simulated):
    with pytest.raises(UserError, match=r"--sensor handheld.*must be rendered"):
        Feed(OnDisk(simulated), InputChoice(sensor="handheld"))


def test_an_unreadable_first_mask_does_not_end_the_run():
    class Broken:
        has_images = False

        def true_instances(self, k):
            raise BadFrame("mask is truncated")

    recording = Recording("depth", "masks")
    recording.truth = Broken()
    feed = Feed(recording, InputChoice(masks="truth"))
    with pytest.raises(BadFrame):
        feed.frame(0)


def test_boxes_stand_around_what_a_detector_knows():
    world = make_world("Street-v0", seed=0, size=(160, 120))
    renderer = make_renderer("mujoco", world)
    street = SimulatedSequence(world, renderer, 3)
    boxes = Feed(street, InputChoice()).frame(1).boxes      # the default of a rendered scene
    true = street.truth.true_instances(1)
    expected = set()
    for instance in np.unique(true[true > 0]):
        v, u = np.nonzero(true == instance)
        expected.add((u.min(), v.min(), u.max(), v.max()))
    assert expected
    assert {tuple(row) for row in boxes.corners_px.astype(int)} == expected
    assert set(boxes.label.tolist()) == {COCO_CLASSES.index("car")}
    noisy = [Feed(street, InputChoice(boxes="noisy"), seed).frame(1).boxes for seed in (1, 1, 2)]
    np.testing.assert_array_equal(noisy[0].corners_px, noisy[1].corners_px)
    assert noisy[0].corners_px.tobytes() != noisy[2].corners_px.tobytes()
    renderer.close()


def test_no_detector_knows_swinging_boxes(simulated, caplog):
    assert Feed(simulated, InputChoice(boxes="truth")).frame(1).boxes is None
    Feed(simulated, InputChoice(boxes="noisy"))
    assert "class that detectors know" in caplog.text


def test_a_detector_needs_its_weights_and_weights_a_detector(tmp_path):
    with pytest.raises(UserError, match="--detector FILE"):
        InputChoice(boxes="detector")
    with pytest.raises(UserError, match="--boxes none"):
        InputChoice(boxes="none", detector="a.onnx")
    with pytest.raises(UserError, match=r"missing\.onnx: no such file"):
        Feed(Recording("depth"), InputChoice(detector=str(tmp_path / "missing.onnx")))


def test_only_so_many_frames(simulated):
    feed = Feed(simulated, InputChoice(), frames=2)
    assert len(feed) == 2
    with pytest.raises(IndexError):
        feed.frame(2)
    assert len(Feed(simulated, InputChoice(), frames=99)) == 6


@pytest.mark.parametrize(("asked", "given"), [("flow", "dis"), ("masks", "none"),
                                              ("boxes", "none")])
def test_given_falls_back_and_says_so(asked, given, caplog):
    feed = Feed(Recording("depth"), InputChoice(**{asked: "given"}))
    assert getattr(feed.choice, asked) == given
    assert asked in caplog.text
    assert given in caplog.text


def test_recorded_masks_are_shuffled_and_flow_is_passed_on():
    feed = Feed(Recording("depth", "masks", "flow"), InputChoice())
    frames = [feed.frame(k) for k in range(4)]
    assert all(set(np.unique(frame.instance_id)) == {0, 1, 2} for frame in frames)
    assert feed.true_object_of_label(1) == {}       # nobody knows
    assert frames[0].flow is None
    assert (frames[1].flow.flow_px == 1.0).all()


def test_depth_that_is_none_is_cleaned():
    depth = Feed(Recording("depth"), InputChoice()).frame(0).depth_m
    np.testing.assert_array_equal(depth[0, :5], [0, 0, 0, 0, 2])


def test_stereo_depth_comes_from_the_images():
    recording = Recording("stereo", "depth")
    depth = Feed(recording, InputChoice(depth="stereo")).frame(1).depth_m
    expected = 20.0 * 0.1 / 4.0      # the right image is the left one moved by 4 px
    assert np.median(depth[depth > 0]) == pytest.approx(expected, rel=0.02)


def test_a_broken_frame_is_passed_on():
    feed = Feed(Recording("depth", "masks", broken=2), InputChoice())
    with pytest.raises(BadFrame, match="truncated"):
        feed.frame(2)
    with pytest.raises(BadFrame, match="truncated"):
        feed.true_object_of_label(2)
    assert feed.frame(3).index == 3


@pytest.mark.parametrize(("choice", "about"), [
    ({"flow": "truth"}, "--flow truth"), ({"flow": "noisy"}, "--flow noisy"),
    ({"masks": "truth"}, "--masks truth"), ({"boxes": "truth"}, "--boxes truth"),
    ({"depth": "truth"}, "--depth truth"), ({"depth": "sensor"}, "--depth sensor"),
    ({"sensor": "kinect"}, "--sensor kinect"), ({"depth": "stereo"}, "--depth stereo"),
    ({"sensor": "eye"}, "eye"),
])
def test_impossible_choices_are_one_line_errors(choice, about):
    with pytest.raises(UserError) as caught:
        Feed(Recording("depth"), InputChoice(**choice))
    assert about in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_impossible_choices(simulated):
    with pytest.raises(UserError, match="--frames 0"):
        Feed(simulated, InputChoice(), frames=0)
    with pytest.raises(UserError, match="--seed -1"):
        Feed(simulated, InputChoice(), seed=-1)
    with pytest.raises(UserError, match="--depth given"):
        Feed(Recording("stereo"), InputChoice(depth="given"))
    with pytest.raises(UserError, match="right images"):
        Feed(simulated, InputChoice(depth="stereo"))
    with pytest.raises(UnknownName, match="sensor"):
        Feed(simulated, InputChoice(sensor="kinekt"))
    for option in CHOICES:
        with pytest.raises(UserError, match=f"--{option} wrong"):
            InputChoice(**{option: "wrong"})


def test_colour_masks_find_the_swinging_boxes():
    world = make_world("SwingingBoxes-v0", seed=0)
    renderer = make_renderer("mujoco", world)
    sequence = SimulatedSequence(world, renderer, 1)
    true = sequence.truth.true_instances(0)
    overlaps = []
    for sensor in (None, "kinect"):
        feed = Feed(sequence, InputChoice(masks="hsv", sensor=sensor))
        labels, true_of = feed.frame(0).instance_id, feed.true_object_of_label(0)
        assert sorted(true_of.values()) == [1, 2, 3, 4]
        for label, instance in true_of.items():
            a, b = labels == label, true == instance
            overlaps.append((a & b).sum() / (a | b).sum())
    renderer.close()
    assert np.mean(overlaps) > 0.8
    assert min(overlaps) > 0.6


def test_colour_masks_of_grey_images_are_empty():
    for level in (0, 128, 255):
        assert not hsv_masks(np.full((60, 80, 3), level, np.uint8)).any()


def test_a_hue_across_red_is_one_object():
    """Hue is a circle: reds on both sides of 0 belong together, blue does not."""
    rgb = np.full((120, 160, 3), 90, np.uint8)
    rgb[20:60, 20:40], rgb[20:60, 40:60] = (200, 10, 0), (200, 0, 14)
    rgb[20:60, 100:140] = (0, 20, 200)
    labels = hsv_masks(rgb)
    assert labels[40, 30] == labels[40, 50] > 0
    assert labels[40, 120] > 0
    assert labels[40, 120] != labels[40, 30]
    assert labels.max() == 2


@pytest.mark.skipif(not DATA.is_dir(), reason=f"no real recordings at {DATA}")
@pytest.mark.parametrize("name", ["kitti_tracking_0003", "kitti_odometry_06", "tum_fr1_rpy"])
def test_real_recordings_pass_through(name):
    feed = Feed(open_sequence(DATA / name), InputChoice(), frames=2)
    for k in range(2):
        frame = feed.frame(k)
        assert np.isfinite(frame.depth_m).all()
        assert (frame.depth_m > 0).mean() > 0.1
    if name == "kitti_tracking_0003":
        assert feed.true_object_of_label(1)
        assert set(feed.true_object_of_label(1)) == set(np.unique(frame.instance_id)) - {0}
