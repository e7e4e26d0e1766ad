"""What a suite's results say of the number of seeds."""

import numpy as np
import pytest

from simbench.report.suite_page import render_suite, summary_table
from simbench.statistics import seeds_needed
from simbench.suites.jobs import runs_of
from simbench.suites.results import results_of
from simbench.suites.spec import Case, Suite

SEEDS = tuple(range(8))
SUITE = Suite("s", 1, "", (Case("boxes", "SwingingBoxes-v0"),), ("a", "b"), SEEDS,
              ("camera.E_t", "camera.coverage"))
LEVEL = np.array([1.0, 1.3, 0.7, 1.1, 0.9, 1.2, 0.8, 1.0])
GAIN = np.array([0.02, 0.05, 0.04, 0.01, 0.03, 0.04, 0.02, 0.03])


def results(**options):
    runs = runs_of(SUITE)
    found = {}
    for run in runs:
        error = LEVEL[run.seed] * (1.0 + GAIN[run.seed] * (run.system == "b"))
        metrics = {"camera.E_t": float(error), "camera.coverage": 1.0}
        found[run.key] = {"meaning": {}, "record": {
            "case": run.case, "point": {}, "system": run.system, "seed": run.seed,
            "status": "done", "frames": 4, "lost_frames": int(run.seed == 3),
            "metrics": metrics}}
    return results_of(SUITE, runs, found, **options)


@pytest.mark.parametrize("resolution", [0.05, 0.01])
def test_the_seeds_for_a_resolution_are_told_for_means_and_for_pairs(resolution):
    found = results(resolution=resolution)
    assert found["resolution"] == resolution
    needed = found["summary"][0]["metrics"]["camera.E_t"]["seeds_needed"]
    assert needed == seeds_needed(LEVEL, resolution * LEVEL.mean())
    pair = next(each for each in found["against_first"] if each["metric"] == "camera.E_t")
    assert pair["seeds_needed"] == seeds_needed(GAIN, resolution)
    assert pair["seeds_needed"] < needed         # pairs share their sequences
    share = next(each for each in found["against_first"] if each["metric"] == "camera.coverage")
    assert "seeds_needed" not in share           # a share has no relative change


def test_lost_frames_are_counted_in_every_cell():
    assert [(each["lost_frames"], each["frames"]) for each in results()["summary"]] \
        == [(1, 32), (1, 32)]


def objects_of(system, seed, coverage):
    """Of a run in which something moves: the systems answer differently."""
    spoke = {"sdpl": seed == 0, "orb": False}[system]
    return {"camera.E_t": 0.1, "camera.coverage": 1.0, "objects.mean.coverage": coverage,
            "objects.mean.frames": 40 * coverage, "objects.mean.false_motions": float(spoke),
            "objects.mean.tracks_without_object": 0.0}


def test_who_estimates_no_object_has_no_share_of_them_and_who_lost_them_all_has_none():
    suite = Suite("s", 1, "", (Case("boxes", "SwingingBoxes-v0", sweep=(("flow", ("truth", "dis")),)
                                    ),), ("sdpl", "orb"), (0, 1),
                  ("camera.E_t", "objects.mean.coverage"))
    runs = runs_of(suite)
    found = {run.key: {"meaning": {}, "timing": {}, "record": {
        "key": run.key, "folder": run.folder, "case": run.case, "point": dict(run.point),
        "system": run.system, "seed": run.seed, "status": "done", "frames": 4, "lost_frames": 0,
        "metrics": objects_of(run.system, run.seed, 0.0)}} for run in runs}
    answer = results_of(suite, runs, found)
    assert answer["no_objects_from"] == ["orb"]
    shares = [each["metrics"].get("objects.mean.coverage") for each in answer["summary"]]
    assert [share and share["mean"] for share in shares] == [0.0, None, 0.0, None]
    assert {each["metric"] for each in answer["against_first"]} == {"camera.E_t"}
    assert all("objects.mean.coverage" in run["metrics"] for run in answer["runs"])   # for a gate
    table = summary_table(answer)
    column = next(i for i, name in enumerate(table.columns) if name == "objects.mean.coverage")
    assert [row[column] for row in table.rows] == ["0 [0, 0]", "–", "0 [0, 0]", "–"]
    assert table.notes[0].startswith("orb: no motion of an object in any run")
    page = render_suite(answer, {}, ())
    assert "orb: no motion of an object in any run" in page
    assert '<td>–</td>' in page.replace(' class="number"', "")
