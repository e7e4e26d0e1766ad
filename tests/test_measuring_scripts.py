"""The scripts behind docs/results.md still run and print their tables."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module   # dataclasses look their module up by name
    spec.loader.exec_module(module)
    return module


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def test_the_table_of_errors_holds_a_row_for_the_system(capsys: pytest.CaptureFixture[str]):
    script("measure_tracking").main(["--scenes", "SwingingBoxes-v0", "--seeds", "1", "--frames",
                                     "3", "--systems", "vdo", "--conditions", "exact"])
    lines = [cells(line) for line in capsys.readouterr().out.splitlines() if line[:1] == "|"]
    row = dict(zip(lines[0], lines[2], strict=True))
    assert row["input"] == "exact"
    assert row["system"] == "vdo"
    assert 0 < float(row["camera E_t mm"]) < 1


def test_the_table_of_bounds_holds_camera_and_objects(capsys: pytest.CaptureFixture[str]):
    script("measure_bound").main(["--seeds", "1", "--frames", "3"])
    lines = [cells(line) for line in capsys.readouterr().out.splitlines() if line[:1] == "|"]
    rows = {(row[0], row[1].split()[0]): row for row in lines[2:]}
    for of, motions in (("camera", 2), ("objects", None)):
        row = rows["all", of]
        assert motions is None or int(row[2]) == motions
        cell_ratio, pixel_ratio = (float(row[i].split(",")[0]) for i in (5, 6))
        # More correspondences leave a lower bound, so a larger ratio; both are of order one.
        assert 0.1 < cell_ratio <= pixel_ratio * 1.001 < 30


@pytest.mark.parametrize("name", ["benchmark_tracking", "measure_determinism", "measure_real",
                                  "check_kitti_truth", "measure_suites", "measure_loop"])
def test_a_script_loads(name: str):
    assert script(name).main.__name__ == "main"


def test_memory_is_read_and_no_context_stays_open(capsys: pytest.CaptureFixture[str]):
    script("measure_memory").main(["--steps", "20", "--scenes", "SwingingBoxes-v0"])
    header, _, row = (cells(line) for line in capsys.readouterr().out.splitlines())
    read = dict(zip(header, row, strict=True))
    assert int(read["resets"]) >= 1
    assert float(read["MB at first"]) > 10
    assert int(read["contexts open"]) == 0


def test_the_table_of_nees_holds_camera_and_objects(capsys: pytest.CaptureFixture[str]):
    script("measure_nees").main(["--seeds", "1", "--frames", "4", "--flow", "noisy"])
    row = cells(capsys.readouterr().out.splitlines()[2])
    assert row[0] == "SwingingBoxes-v0"
    assert 0 < float(row[1]) < 30
    assert 0 < float(row[4]) < 60


def test_loops_are_counted_where_there_are_none(capsys: pytest.CaptureFixture[str]):
    measured = script("measure_false_loops")
    measured.CASES["Loop-v0"] = measured.Case((304, 92), 3, 10.0, None, {"camera_speed": 2.0})
    measured.main(["--scenes", "Loop-v0", "--seeds", "1"])
    header, _, row = (cells(line) for line in capsys.readouterr().out.splitlines())
    read = dict(zip(header, row, strict=True))
    assert (read["runs"], read["closed"], read["false"], read["ratio"]) == ("1", "0", "0", "")
    pairs = measured.Total(ate_m=[(0.08, 0.04), (0.06, 0.015)])
    assert measured._gain(pairs).split(" | ")[2].startswith("0.3536 (0.25")


def test_forms_of_the_batch_are_held_against_ours_seed_by_seed(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))        # it takes its scores from another script
    forms = script("compare_formulations")
    runs = [{forms.OURS: {"ATE": 2.0 * scale}, "other": {"ATE": scale}} for scale in (1.0, 7.0)]
    assert forms._ratio(runs, "other", "ATE") == "0.50 (0.50 to 0.50)"
    assert forms._ratio(runs[:1], "other", "ATE") == "0.50"
    assert forms._ratio(runs, "other", "batch s") == ""


def test_breaking_points_are_read_off_a_suites_curves(tmp_path: Path,
                                                      capsys: pytest.CaptureFixture[str]):
    def run(value: float, seed: int, place: str, error: float) -> dict:
        return {"case": "street", "system": "sdpl", "seed": seed, "status": "done",
                "point": {"texture": value, "surroundings": place},
                "metrics": {"camera.E_t": error}}

    runs = [run(value, seed, place, 0.01 * (1 - value) if place == "open" else 0.0)
            for value in (1.0, 0.5, 0.0) for seed in (0, 1) for place in ("open", "houses")]
    (tmp_path / "results.json").write_text(json.dumps({"runs": runs, "suite": {
        "seeds": [0, 1], "cases": [{"name": "street", "sweep": [["texture", [1.0, 0.5, 0.0]]]}]}}))
    words = [str(tmp_path), "--case", "street", "--dial", "texture", "--systems", "sdpl",
             "--limit", "camera.E_t=0.004", "--where"]
    assert script("breaking_of_suite").main([*words, "surroundings=open"]) == 0
    assert "holds until texture 0.6 [0.6, 0.6]" in capsys.readouterr().out
    assert script("breaking_of_suite").main([*words, "surroundings=houses"]) == 0
    assert "holds from texture 1 to 0, in 100 %" in capsys.readouterr().out
