"""Where systems break, read off the curves of a suite that has been run.

    python scripts/breaking_of_suite.py SUITE_FOLDER --case cyclists --dial limbs
        --limit objects.all.E_R_rigid_fit=1 [--systems sdpl vdo] [--where surroundings=open]

As `simbench suite break` tells it, but at the points of the sweep: the mean over the seeds is taken
as straight between them, and the interval is that of seeds drawn again.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simbench.suites.breaking import Limit, breaking_of
from simbench.untrusted import read_json_object


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("suite", type=Path)
    parser.add_argument("--case", required=True)
    parser.add_argument("--dial", required=True)
    parser.add_argument("--limit", type=Limit.parse, required=True)
    parser.add_argument("--systems", nargs="+", default=["sdpl", "vdo"])
    parser.add_argument("--where", default="", metavar="NAME=VALUE",
                        help="which of the values of what else is swept")
    chosen = parser.parse_args(words)
    results = read_json_object(chosen.suite / "results.json", "run the suite first")
    case = next(each for each in results["suite"]["cases"] if each["name"] == chosen.case)
    x = next(values for name, values in case["sweep"] if name == chosen.dial)
    seeds = results["suite"]["seeds"]
    for system in chosen.systems:
        runs = [run for run in results["runs"] if run["case"] == chosen.case
                and run["system"] == system and _fits(run["point"], chosen.where)]
        values = {(run["point"][chosen.dial], run["seed"]):
                  run.get("metrics", {}).get(chosen.limit.metric.name, np.nan) for run in runs}
        table = np.array([[values[value, seed] for seed in seeds] for value in x])
        found = breaking_of(system, np.array(x, dtype=float), table, chosen.limit)
        print(found.statement(chosen.dial, chosen.limit, (x[0], x[-1]), len(seeds)))
    return 0


def _fits(point: Mapping[str, Any], where: str) -> bool:
    name, _, value = where.partition("=")
    return not where or str(point[name]) == value


if __name__ == "__main__":
    sys.exit(main())
