"""The detector on tiny networks made here: their answers are known beforehand."""

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from slam.dynamics.detection import (
    COCO_CLASSES,
    BadDetector,
    DetectorConfig,
    OnnxDetector,
    best_boxes,
)

SMALL = DetectorConfig(input_px=64)
CAR, PERSON = COCO_CLASSES.index("car"), COCO_CLASSES.index("person")


def network(path: Path, answer: np.ndarray) -> Path:
    """Weights whose answer is this table, brightened by nothing of the image."""
    constants = {"table": answer.astype(np.float32), "w": np.zeros((1, 3, 1, 1), np.float32),
                 "shape": np.ones(answer.ndim, np.int64)}
    nodes = [helper.make_node("GlobalAveragePool", ["images"], ["mean"]),
             helper.make_node("Conv", ["mean", "w"], ["zero"]),
             helper.make_node("Reshape", ["zero", "shape"], ["flat"]),
             helper.make_node("Add", ["flat", "table"], ["output0"])]
    graph = helper.make_graph(
        nodes, "tiny", [helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, 64, 64])],
        [helper.make_tensor_value_info("output0", TensorProto.FLOAT, list(answer.shape))],
        [numpy_helper.from_array(value, name) for name, value in constants.items()])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.save(model, path)
    return path


def rows(*things: tuple[float, float, float, float, int, float]) -> np.ndarray:
    """(N, 84): centre, size, class and its score."""
    table = np.zeros((len(things), 84))
    for row, (u, v, w, h, label, score) in zip(table, things, strict=True):
        row[:4] = u, v, w, h
        row[4 + label] = score
    return table


THINGS = rows((20, 10, 8, 8, CAR, 0.9), (20.5, 10, 8, 8, CAR, 0.8),   # the same car twice
              (20, 10, 8, 8, PERSON, 0.7), (60, 30, 20, 10, CAR, 0.6), (5, 5, 4, 4, CAR, 0.1))


def layouts(kind: str) -> np.ndarray:
    if kind == "v8":
        return THINGS.T[None]
    if kind == "v5":
        objectness = np.full((len(THINGS), 1), 0.95)
        return np.hstack([THINGS[:, :4], objectness, THINGS[:, 4:]])[None]
    half = THINGS[:, 2:4] / 2
    return np.hstack([THINGS[:, :2] - half, THINGS[:, :2] + half, THINGS[:, 4:].max(1)[:, None],
                      THINGS[:, 4:].argmax(1)[:, None]])[None]


@pytest.mark.parametrize("kind", ["v8", "v5", "v10"])
def test_boxes_come_in_pixels_of_the_image(tmp_path, kind):
    detector = OnnxDetector(network(tmp_path / "tiny.onnx", layouts(kind)), SMALL)
    boxes = detector(np.zeros((60, 128, 3), np.uint8))    # shrunk to half: boxes grow twofold
    np.testing.assert_allclose(boxes.corners_px, [[32, 12, 48, 28], [32, 12, 48, 28],
                                                  [100, 50, 127, 59]], atol=1e-4)
    assert boxes.label.tolist() == [CAR, PERSON, CAR]
    assert (np.diff(boxes.score) <= 0).all()


@pytest.mark.parametrize("opset", [9, 11, 17, 21])
def test_networks_of_other_opsets_say_the_same(tmp_path, opset):
    weights = network(tmp_path / "tiny.onnx", layouts("v8"))
    image = np.zeros((60, 128, 3), np.uint8)
    wanted = OnnxDetector(weights, SMALL)(image)
    model = onnx.load(weights)
    model.opset_import[0].version = opset
    onnx.save(model, weights)
    found = OnnxDetector(weights, SMALL)(image)
    np.testing.assert_allclose(found.corners_px, wanted.corners_px)
    assert found.label.tolist() == wanted.label.tolist()


def test_an_operator_that_opencv_does_not_have_is_refused_in_a_line(tmp_path):
    weights = network(tmp_path / "tiny.onnx", layouts("v8"))
    model = onnx.load(weights)
    model.opset_import[0].version = 99
    model.graph.node[-1].op_type = "AddOfALaterOpset"
    onnx.save(model, weights)
    with pytest.raises(BadDetector, match="opset 12 to 17") as refused:
        OnnxDetector(weights, SMALL)
    assert "\n" not in str(refused.value)


def test_nothing_found_is_no_boxes(tmp_path):
    detector = OnnxDetector(network(tmp_path / "tiny.onnx", rows((5, 5, 4, 4, CAR, 0.1)).T[None]),
                            SMALL)
    assert detector(np.zeros((64, 64, 3), np.uint8)).corners_px.shape == (0, 4)


@pytest.mark.parametrize("shape", [(1, 30, 7), (1, 1000), (2, 84, 3), (1, 3, 8, 8)])
def test_another_output_is_refused_in_a_line(tmp_path, shape):
    path = network(tmp_path / "other.onnx", np.zeros(shape))
    with pytest.raises(BadDetector, match=r"output has the shape") as caught:
        OnnxDetector(path, SMALL)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_network_is_refused_in_a_line(tmp_path):
    with pytest.raises(BadDetector, match="no such file"):
        OnnxDetector(tmp_path / "missing.onnx", SMALL)
    (tmp_path / "junk.onnx").write_bytes(b"junk" * 99)
    with pytest.raises(BadDetector, match="cannot load") as caught:
        OnnxDetector(tmp_path / "junk.onnx", SMALL)
    assert "\n" not in str(caught.value)


def test_boxes_that_are_none_are_dropped_and_500_are_cut_to_the_best():
    corners = np.array([[0, 0, 9, 9], [np.nan, 0, 9, 9], [5, 5, 5, 9], [9, 9, 1, 1]], float)
    kept = best_boxes(corners, np.full(4, 0.9), np.zeros(4, np.int64), DetectorConfig())
    np.testing.assert_array_equal(kept.corners_px, corners[:1])
    starts = np.arange(500.0)[:, None] * 20
    many = np.hstack([starts, starts, starts + 9, starts + 9])
    score = np.linspace(0.4, 0.9, 500)
    kept = best_boxes(many, score, np.zeros(500, np.int64), DetectorConfig())
    np.testing.assert_allclose(kept.score, score[::-1][:100])
