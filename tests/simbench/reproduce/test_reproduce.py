"""A table from the command line, and what is computed between its runs and its page."""

import csv
import html
import json
import re

import numpy as np
import pytest

from simbench.cli import main
from simbench.reproduce.compare import compare, correlate
from simbench.reproduce.files import markdown
from simbench.reproduce.measured import Measured, short_name
from simbench.reproduce.page import render
from simbench.reproduce.run_table import suite_of
from simbench.reproduce.side_by_side import reproduction
from simbench.reproduce.table import load_table
from simbench.statistics import rank_correlation
from simbench.suites.jobs import runs_of

FEW = ("--size", "160x120", "--reports", "none")


def rows_of(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_a_table_stands_beside_what_was_run(tmp_path, in_this_process, capsys):
    out = tmp_path / "table"
    command = ["reproduce", "sdpl-table2", "--systems", "vdo,sdpl", "--seeds", "0-1", "--frames",
               "6", *FEW, "--out", str(out)]
    assert main(command) == 0
    assert "printed: SDPL-SLAM / VDO-SLAM" in capsys.readouterr().out
    rows = rows_of(out / "sdpl-table2.csv")
    printed = [row for row in rows if row["source"] == "printed"]
    assert len(printed) == 8 * 4
    ours = {(row["row"], row["quantity"], row["system"]): row for row in rows
            if row["source"] == "measured"}
    runs = [json.loads((out / f"runs/full/sdpl/seed{seed}/metrics.json").read_text())
            for seed in (0, 1)]
    found = ours["full sequence: camera", "E_t", "sdpl"]
    assert float(found["value"]) == pytest.approx(np.mean([r["camera"]["E_t"] for r in runs]))
    assert float(found["low"]) <= float(found["value"]) <= float(found["high"])
    box = ours.get(("full sequence: box mean", "E_t", "sdpl"))
    assert box is None or float(box["value"]) > 0
    text = (out / "sdpl-table2.md").read_text()
    assert "| 500 frames: top left |" in text
    assert "0.036" in text
    page = (out / "sdpl-table2.html").read_text()
    assert "Oxford Multimotion" in page
    lost = sum(run["lost_frames"] for run in json.loads((out / "results.json").read_text())["runs"]
               if (run["case"], run["system"]) == ("full", "sdpl"))
    assert f"<td>{lost} of 12</td>" in "".join(page.split("\n")).replace("> ", ">")
    files = [(out / f"sdpl-table2.{kind}").read_bytes() for kind in ("html", "md", "csv")]
    assert main([*command, "--resume"]) == 0
    assert files == [(out / f"sdpl-table2.{kind}").read_bytes() for kind in ("html", "md", "csv")]


def test_a_camera_that_stands_still_shows_its_deviation(tmp_path, in_this_process):
    out = tmp_path / "figure"
    assert main(["reproduce", "dpl-figure10", "--systems", "orb", "--seeds", "0", "--frames", "4",
                 "--size", "160x120", "--reports", "none", "--out", str(out)]) == 0
    rows = [row for row in rows_of(out / "dpl-figure10.csv") if row["source"] == "measured"]
    poses = np.loadtxt(out / "runs/visit/orb/seed0/trajectory.txt")
    largest = [float(row["value"]) for row in rows if row["quantity"] == "largest deviation"]
    # The first camera is the estimate's world: its axes are those of the figure.
    np.testing.assert_allclose(largest, np.abs(poses[:, 1:4] - poses[0, 1:4]).max(axis=0),
                               atol=1e-9)
    assert (out / "dpl-figure10.html").read_text().count("<svg") == 3


def test_wrong_options_are_one_line(tmp_path, capsys):
    for words, message in ((["nothing"], "there are dpl-figure10"),
                           (["dpl-table1", "--systems", "dlp"], "did you mean 'dpl'"),
                           (["dpl-table1", "--seeds", "x"], "wanted numbers and ranges"),
                           (["dpl-table1", "--dask", "tcp://a:1", "--workers", "2"], "--workers"),
                           (["dpl-table1", "--frames", "0"], "--frames")):
        assert main(["reproduce", *words, "--out", str(tmp_path / "out")]) == 2
        told = capsys.readouterr().err.strip().splitlines()
        assert message in told[-1]


@pytest.fixture
def drives(tmp_path):
    """Table I of SDPL-SLAM with values that are chosen: gains that grow with the tracklets."""
    table = load_table("sdpl-table1")
    runs = runs_of(suite_of(table, seeds=(0, 1)))
    records = []
    for run in runs:
        i = [row.case for row in table.rows].index(run.case)
        gain = {"vdo": 1.0, "sdpl": 1.0 - 0.02 * i, "sdpl-no-flow-opt": 1.0}[run.system]
        lost = run.system == "sdpl" and i == 12 and run.seed == 1
        metrics = {} if lost else {"camera": {"E_t": 0.01 * (1 + run.seed) * gain},
                                   "lines": {"static_tracklet_length": 2.0 + i}}
        folder = tmp_path / run.folder
        folder.mkdir(parents=True)
        (folder / "metrics.json").write_text(json.dumps(metrics))
        records.append({"status": "lost" if lost else "done", "frames": 5,
                        "lost_frames": 5 if lost else 1})
    return table, Measured(table, runs, records, tmp_path)


def test_ratios_are_of_pairs_and_a_lost_run_makes_none(drives):
    table, measured = drives
    found = compare(table, table.comparisons[0], measured)
    assert found.rows[0].printed == pytest.approx(0.050 / 0.051)
    assert found.rows[5].ours.mean == pytest.approx(0.9)
    assert found.rows[5].ours.low == pytest.approx(0.9)      # pairs do not spread at all
    assert found.rows[5].ours.seeds_needed == 2
    assert found.rows[12].ours.n == 1
    assert found.all_rows.ours.n == 1                        # the seed that has every row
    counted = measured.counted("d0004", "sdpl")
    assert (counted.lost_runs, counted.lost_frames, counted.frames) == (1, 6, 10)
    assert compare(table, table.comparisons[1], measured).rows[0].ours is None    # no objects


def test_gains_that_grow_with_the_tracklets_correlate(drives):
    table, measured = drives
    found = correlate(table, table.correlation, measured)
    assert found.rho_ours.mean == pytest.approx(1.0)
    assert found.rho_ours.n == 13
    # Of the printed numbers, by scipy: their correlation is no certain one.
    assert found.rho_printed.mean == pytest.approx(0.52, abs=0.005)
    assert found.rho_printed.low < 0 < found.rho_printed.high


def test_the_page_states_the_correlation_with_its_interval(drives):
    table, measured = drives
    found = reproduction(table, suite_of(table, seeds=(0, 1)), measured)
    for text in (markdown(found), html.unescape(render(found))):
        assert re.search(r"Printed: ρ = \+0\.52 \[-0\.\d\d, \+0\.\d\d\], 13 sequences", text)
        assert "Ours: ρ = +1.00 [+1.00, +1.00], 13 sequences" in text
        assert "between static line tracklet length and gain in camera E" in text


def test_each_box_stands_in_its_own_row(tmp_path):
    table = load_table("sdpl-table2")
    runs = runs_of(suite_of(table, seeds=(0, 1)))
    for run in runs:
        boxes = {str(n): {"E_t": 0.01 * n + 0.001 * run.seed, "E_R": 0.1 * n} for n in range(1, 5)}
        folder = tmp_path / run.folder
        folder.mkdir(parents=True)
        (folder / "metrics.json").write_text(json.dumps({
            "camera": {"E_t": 0.005, "E_R": 0.05},
            "objects": boxes | {"mean": {"E_t": 0.025, "E_R": 0.25}}}))
    measured = Measured(table, runs, [{"status": "done"}] * len(runs), tmp_path)
    (side,) = (s for s in reproduction(table, suite_of(table, seeds=(0, 1)), measured).sides
               if s.title.startswith("E_t"))
    rows = {name: cells for name, *cells in side.rows}
    at = len(side.printed) + side.ours.index("sdpl")
    for n, place in enumerate(("top right", "bottom right", "top left", "bottom left"), start=1):
        assert rows[f"500 frames: {place}"][at].startswith(f"0.0{n}05")
    assert rows["500 frames: top left"][:2] == ["0.036", "0.031"]
    assert rows["500 frames: box mean"][at].startswith("0.025")
    assert rows["full sequence: camera"][:2] == ["0.038", "0.022"]


def test_no_correlation_of_few_or_equal_values():
    assert rank_correlation([1, 2, 3], [1, 2, 3]) is None
    assert rank_correlation([1, 1, 1, 1], [1, 2, 3, 4]) is None
    falling = rank_correlation([1, 2, 3, 4, 5], [5, 4, 3, 2, 1])
    assert (falling.mean, falling.high) == pytest.approx((-1.0, -1.0))


def test_a_system_from_a_file_goes_by_the_files_name():
    assert short_name("examples/orbslam3_system.py:make") == "orbslam3_system"
    assert short_name("package.module:make") == "package.module:make"
    assert short_name("sdpl") == "sdpl"
