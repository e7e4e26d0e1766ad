"""ORB-SLAM3 as a system: its vocabulary as DBoW2 reads it, and a run where its wheel is."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from simbench.cli import main
from simbench.errors import UserError
from simbench.load_system import load_system
from slam.dpl.vocabulary import Vocabulary
from slam.types import Intrinsics

EXAMPLE = Path(__file__).parents[2] / "examples" / "orbslam3_system.py"


def example():
    spec = importlib.util.spec_from_file_location("orbslam3_example", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def word_by_text(text: str, descriptor: np.ndarray) -> int:
    """The word of a descriptor (32,), as DBoW2 finds it: leaves are numbered in their order."""
    children, bits, word_of = {}, {}, {}
    for number, line in enumerate(text.splitlines()[1:], start=1):
        parent, leaf, *rest = line.split()
        children.setdefault(int(parent), []).append(number)
        bits[number] = np.unpackbits(np.array(rest[:32], np.uint8))
        if int(leaf):
            word_of[number] = len(word_of)
    at = 0
    while at not in word_of:
        at = min(children[at], key=lambda n: int((bits[n] != np.unpackbits(descriptor)).sum()))
    return word_of[at]


def test_the_vocabulary_as_text_finds_the_same_words():
    rng = np.random.default_rng(3)
    branching, levels = 3, 3
    nodes = sum(branching ** level for level in range(1, levels + 1))
    vocabulary = Vocabulary(rng.integers(0, 2 ** 63, (nodes, 4), dtype=np.uint64), branching,
                            rng.uniform(0.5, 2.0, branching ** levels))
    text = example().vocabulary_text(vocabulary)
    assert text.splitlines()[0] == "3 3 0 0"
    assert not text.endswith("\n")         # DBoW2 would read one node more
    descriptors = rng.integers(0, 256, (50, 32), dtype=np.uint8)
    assert [word_by_text(text, each) for each in descriptors] \
        == vocabulary.words_of(descriptors).tolist()
    weights = [float(line.split()[-1]) for line in text.splitlines()[1:] if line.split()[1] == "1"]
    np.testing.assert_allclose(weights, vocabulary.idf, rtol=1e-5)


def test_without_the_wheel_one_line_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyorbslam3", None)
    with pytest.raises(UserError, match=r"pip install -e '\.\[orbslam3\]'"):
        load_system(f"{EXAMPLE}:make", Intrinsics(50.0, 50.0, 31.5, 23.5, 64, 48))


def test_it_runs_and_is_scored(tmp_path):
    pytest.importorskip("pyorbslam3")
    out = tmp_path / "run"
    assert main(["run", "SwingingBoxes-v0", "--system", f"{EXAMPLE}:make", "--frames", "8",
                 "--size", "320x240", "--out", str(out)]) == 0
    assert "coverage" in (out / "metrics.json").read_text()
