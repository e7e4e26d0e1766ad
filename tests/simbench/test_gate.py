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


GOOD_BASELINE = {
    "schema": 1, "name": "x", "metrics": {"camera.E_t": {
        "unit": "m", "better": "lower", "relative": True, "tolerance": 0.02}},
    "runs": [{"case": "a", "point": {}, "system": "s", "seed": 1, "asked": {}, "status": "done",
              "given_sha256": "0", "values": {"camera.E_t": 0.1}}]}


@pytest.mark.parametrize(("change", "message"), [
    (lambda b: b.update(runs=[]), "runs: none"),
    (lambda b: b.update(runs=2 * b["runs"]), "one stands there twice"),
    (lambda b: b.update(runs=7), "runs is 7, wanted a list"),
    (lambda b: b.pop("runs"), "'runs' is missing"),
    (lambda b: b["runs"][0]["values"].update({"camera.E_t": -1}), "camera.E_t is -1, wanted"),
    (lambda b: b["metrics"]["camera.E_t"].update(tolerance=-1), "tolerance of camera.E_t is -1"),
    (lambda b: b["metrics"]["camera.E_t"].update(better="loer"), "'loer', wanted lower or higher"),
    (lambda b: b["metrics"].update({"camera.Et": {}}), "did you mean 'camera.E_t'")])
def test_a_baseline_edited_by_hand_is_refused_with_what_is_wrong(tmp_path, change, message):
    path, edited = tmp_path / "baseline.json", json.loads(json.dumps(GOOD_BASELINE))
    path.write_text(json.dumps(edited))
    read_baseline(path)
    change(edited)
    path.write_text(json.dumps(edited))
    with pytest.raises(BadFile, match=message) as raised:
        read_baseline(path)
    assert str(path) in str(raised.value)
    assert "Error" not in str(raised.value)


def test_a_gate_that_could_compare_nothing_does_not_pass():
    nothing = outcome(values={})
    with pytest.raises(UserError, match="nothing of smoke version 1 can be compared"):
        judge(nothing, nothing)
    with pytest.raises(UserError, match="nothing of"):
        judge(replace(outcome(), metrics=()), outcome())


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


@pytest.mark.parametrize(("marker", "message"), [
    ("sytem='my_slam.py:make'", "no option 'sytem'; did you mean 'system'?"),
    ("'my_slam.py:make'", "'my_slam.py:make' is which of system, suite"),
    ("system=7", "name a system, as in"),
    ("system='my_slam.py:make'", "name a baseline, as in"),
    ("system='my_slam.py:make', baseline='b.json', frames='two'", "frames is 'two', wanted"),
    ("system='my_slam.py:make', baseline='b.json', workers=0", "workers is 0, wanted"),
    ("system='my_slam.py:make', baseline='b.json', size=(64, 48)", "size is (64, 48), wanted")])
def test_a_marker_that_is_wrong_is_one_line(project, marker, message):
    root, run_tests = project
    (root / "test_marker.py").write_text(f"""
import pytest

@pytest.mark.simbench({marker})
def test_it(simbench):
    simbench.gate()
""")
    failed = run_tests("test_marker.py", "-rN")
    (root / "test_marker.py").unlink()
    assert failed.returncode == 1
    told = [line for line in failed.stdout.splitlines() if line.startswith("simbench: ")]
    assert len(told) == 1, failed.stdout
    assert message in told[0]
    assert "Error" not in failed.stdout.replace("1 error", "")


def test_a_suite_that_cannot_run_is_one_line_in_a_test_too(project):
    root, run_tests = project
    (root / "test_suite.py").write_text("""
def test_it(simbench):
    simbench.suite(system='sdlp')
""")
    failed = run_tests("test_suite.py", "-rN")
    (root / "test_suite.py").unlink()
    assert "simbench: no system 'sdlp'; did you mean 'sdpl'?" in failed.stdout
    assert "UnknownName" not in failed.stdout


def test_what_measured_nothing_is_not_blessed(project, tmp_path, capsys):
    root, _ = project
    out = tmp_path / "one"
    assert main(["suite", str(root / "suite.yaml"), "--frames", "1", "--seeds", "0", "--workers",
                 "1", "--out", str(out)]) == 0
    capsys.readouterr()
    assert main(["bless", str(out), "--baseline", str(tmp_path / "b.json")]) == 2
    assert "was measured: there is nothing to hold others against" in capsys.readouterr().err
    assert not (tmp_path / "b.json").exists()


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
