"""Gates: what passes, what fails, what cannot be compared, and the pytest plugin."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from simbench.baseline import Baseline, BlessedRun, outcome_of, read_baseline
from simbench.cli import main
from simbench.errors import BadFile, UserError
from simbench.gate import judge
from simbench.metric_names import METRICS
from standing_system import SYSTEM

NAMES = ("camera.E_t", "camera.coverage")
CELLS = ("boxes", "street", "images")


def outcome(E_t=None, coverage=1.0, seeds=range(5), system="sdpl", **changes) -> Baseline:
    """A suite of three cells; E_t is a function of (cell, seed)."""
    E_t = E_t or typical
    run = BlessedRun("", {}, system, 0, {"scene": "Boxes-v0", "dials": {}, "frames": 9}, "done",
                     "ab", {})
    runs = [replace(run, case=cell, seed=seed,
                    values={"camera.E_t": E_t(cell, seed), "camera.coverage": coverage})
            for cell in CELLS for seed in seeds]
    return Baseline("smoke version 1", tuple(METRICS[n] for n in NAMES),
                    tuple(replace(r, **changes) for r in runs))


def typical(cell, seed):
    return 1e-3 * (1 + CELLS.index(cell)) * (1 + 0.3 * np.sin(7.0 * seed))


def test_the_same_numbers_pass():
    verdict = judge(outcome(), outcome())
    assert verdict.passed
    assert not verdict.improvements
    assert verdict.compared == 2 * (1 + 3)


def test_a_tenth_more_is_caught_and_named():
    rng = np.random.default_rng(0)
    verdict = judge(outcome(), outcome(lambda c, s: typical(c, s) * rng.normal(1.10, 0.03)))
    assert not verdict.passed
    worst = verdict.regressions[0]
    assert (worst.metric.name, worst.where, worst.system) == ("camera.E_t", "all sequences", "sdpl")
    text = str(worst)
    for part in ("mm, was", "+10", "[+", "over 15 sequences", "2 % tolerated", "worst on"):
        assert part in text


def test_one_bad_cell_is_caught_though_the_others_hold():
    verdict = judge(outcome(), outcome(
        lambda c, s: typical(c, s) * (1.3 + 0.02 * s if c == "street" else 1.0)))
    assert [change.where for change in verdict.regressions if change.where != "all sequences"] \
        == ["street"]


@pytest.mark.parametrize("seed", range(10))
def test_noise_without_a_change_passes(seed):
    rng = np.random.default_rng(seed)
    assert judge(outcome(), outcome(lambda c, s: typical(c, s) * rng.normal(1.0, 0.03))).passed


def test_better_is_told_and_less_coverage_is_worse():
    verdict = judge(outcome(), outcome(lambda c, s: 0.8 * typical(c, s), coverage=0.9))
    assert {change.metric.name for change in verdict.improvements} == {"camera.E_t"}
    assert {change.metric.name for change in verdict.regressions} == {"camera.coverage"}


def test_a_lost_run_or_value_fails_the_gate():
    now = outcome()
    lost = replace(now.runs[3], status="lost", values={"camera.coverage": 0.0})
    verdict = judge(outcome(), replace(now, runs=(*now.runs[:3], lost, *now.runs[4:])))
    assert not verdict.passed
    assert verdict.lost == ("boxes sdpl seed 3: lost",)


def test_other_bytes_are_told_and_do_not_fail():
    verdict = judge(outcome(), outcome(given_sha256="cd"))
    assert verdict.passed
    assert len(verdict.other_bytes) == 15


@pytest.mark.parametrize(("now", "message"), [
    (outcome(seeds=range(4)), "the baseline has boxes sdpl seed 4, and this has not"),
    (outcome(seeds=range(6)), "seed 5 is not in the baseline"),
    (outcome(system="vdo"), "the baseline has boxes sdpl seed 0"),
    (outcome(asked={"scene": "Boxes-v1", "dials": {}, "frames": 9}), "scene is 'Boxes-v1'"),
    (outcome(asked={"scene": "Boxes-v0", "dials": {"light": 2}, "frames": 9}), "dials is"),
    (replace(outcome(), name="smoke version 2"), "the baseline is of smoke version 1"),
])
def test_what_is_not_the_same_is_not_compared(now, message):
    with pytest.raises(UserError, match=message):
        judge(outcome(), now)


@pytest.mark.parametrize("text", [
    "", "{", "[]", "{}", '{"schema": 1}', '{"schema": 1, "name": "x", "metrics": {}, "runs": 5}',
    '{"schema": 1, "name": "x", "metrics": {"camera.E_t": {"better": "red", "tolerance": 0}}, '
    '"runs": []}', '{"schema": 1, "name": "x", "metrics": {"camera.E_t": {"better": "lower", '
    '"relative": true, "tolerance": NaN}}, "runs": []}', "[" * 100_000,
    '{"schema": 1, "name": "x", "metrics": {}, "runs": [{"case": "a", "point": {}, "system": "s", '
    '"seed": 1e309, "asked": {}, "status": "done", "given_sha256": "0", "values": {}}]}'])
def test_a_broken_baseline_is_one_line(tmp_path, text):
    path = tmp_path / "baseline.json"
    path.write_text(text)
    with pytest.raises(BadFile, match=r"baseline\.json"):
        read_baseline(path)


@pytest.mark.parametrize("wrong", [
    {"seed": "0"}, {"seed": 1e300}, {"metrics": {"camera.E_t": "small"}}, {"metrics": []},
    {"asked": "all"}, {"case": None}, {"sequence": 5}, {"point": [1]}])
def test_broken_results_of_a_suite_are_one_line(tmp_path, wrong):
    run = {"case": "a", "point": {}, "system": "s", "seed": 0, "asked": {}, "status": "done",
           "sequence": {}, "metrics": {"camera.E_t": 0.1}}
    suite = {"name": "x", "version": 1, "metrics": ["camera.E_t"]}
    path = tmp_path / "results.json"
    path.write_text(json.dumps({"suite": suite, "runs": [run]}))
    assert outcome_of(tmp_path).runs[0].values == {"camera.E_t": 0.1}
    path.write_text(json.dumps({"suite": suite, "runs": [run | wrong]}))
    with pytest.raises(BadFile, match=r"results\.json: not the results of a suite"):
        outcome_of(tmp_path)


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A stranger's repository with a SLAM and a gate of it, and how to run its tests."""
    root = tmp_path_factory.mktemp("project")
    (root / "my_slam.py").write_text(SYSTEM)
    (root / "suite.yaml").write_text(
        "{schema: 1, name: ours, systems: [sdpl], seeds: 0-1, cases: "
        "{boxes: {scene: SwingingBoxes-v0, frames: 3, size: 64x48}}}")
    (root / "test_slam.py").write_text('''
import pytest

@pytest.mark.simbench(system="my_slam.py:make", suite="suite.yaml", baseline="baseline.json")
def test_my_slam_is_no_worse(simbench):
    simbench.gate()
''')

    def run_tests(*options):
        return subprocess.run(
            [sys.executable, "-m", "pytest", "-p", "simbench_pytest", "-p", "no:cacheprovider",
             "--rootdir", ".", "--strict-markers", "-q", *options],
            cwd=root, capture_output=True, text=True, check=False)

    return root, run_tests


def test_a_strangers_repository_gates_its_slam(project):
    root, run_tests = project
    unblessed = run_tests()
    assert unblessed.returncode == 1
    assert "write it with `pytest --simbench-bless`" in unblessed.stdout
    blessed = run_tests("--simbench-bless")
    assert blessed.returncode == 0, blessed.stdout
    baseline = json.loads((root / "baseline.json").read_text())
    assert {run["system"] for run in baseline["runs"]} == {"my_slam.py:make"}
    for run in baseline["runs"]:
        run["values"]["camera.E_t"] *= 0.5       # as if it had been twice as good
    (root / "baseline.json").write_text(json.dumps(baseline))
    worse = run_tests()
    assert worse.returncode == 1
    assert "WORSE: camera.E_t of my_slam.py:make on all sequences" in worse.stdout
    assert "+100 %" in worse.stdout


@pytest.mark.parametrize("text", [None, "{"])
def test_a_baseline_that_cannot_be_read_is_told_once_and_before_the_suite_runs(
        project, tmp_path, text):
    root, run_tests = project
    path = tmp_path / "baseline.json"
    if text is not None:
        path.write_text(text)
    (root / "test_no_baseline.py").write_text(f'''
import pytest

@pytest.mark.simbench(system="no_such_file.py:make", suite="suite.yaml", baseline={str(path)!r})
def test_it(simbench):
    simbench.gate()
''')
    # Without pytest's closing summary: on a CI machine that repeats every message in full.
    failed = run_tests("test_no_baseline.py", "-rN")
    (root / "test_no_baseline.py").unlink()
    assert failed.returncode == 1
    assert failed.stdout.count(f"simbench: {path}") == 1
    assert "no_such_file" not in failed.stdout
    assert "During handling" not in failed.stdout


def test_bless_and_gate_as_typed(project, tmp_path, capsys):
    root, _ = project
    run, baseline = tmp_path / "run", tmp_path / "baseline.json"
    assert main(["run", "SwingingBoxes-v0", "--system", f"{root / 'my_slam.py'}:make", "--frames",
                 "3", "--size", "64x48", "--out", str(run)]) == 0
    assert main(["gate", str(run), "--baseline", str(baseline)]) == 2
    assert "simbench bless" in capsys.readouterr().err
    assert main(["bless", str(run), "--baseline", str(baseline)]) == 0
    assert main(["gate", str(run), "--baseline", str(baseline)]) == 0
    metrics = json.loads((run / "metrics.json").read_text())
    metrics["camera"]["E_t"] *= 1.1
    (run / "metrics.json").write_text(json.dumps(metrics))
    assert main(["gate", str(run), "--baseline", str(baseline)]) == 1
    out = capsys.readouterr().out
    assert "WORSE: camera.E_t" in out
    assert "gate failed: 1 of" in out
    assert main(["gate", str(tmp_path), "--baseline", str(baseline)]) == 2
    assert "holds neither a run nor a suite" in capsys.readouterr().err
