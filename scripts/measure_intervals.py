"""How often a bootstrap interval of 95 % holds the true mean, for few seeds.

    python scripts/measure_intervals.py

Values are log-normal with a spread of 40 %, about that of errors over seeds.
"""

from __future__ import annotations

import numpy as np

from simbench.statistics import mean_interval

_SPREAD = 0.4
_TRIES = 600


def main() -> None:
    rng = np.random.default_rng(0)
    true = np.exp(0.5 * _SPREAD**2)
    print("| seeds | intervals of 95 % that hold the true mean |\n|---|---|")
    for seeds in (3, 5, 10, 20):
        found = [mean_interval(rng.lognormal(0.0, _SPREAD, seeds)) for _ in range(_TRIES)]
        held = np.mean([i.low is not None and i.high is not None and i.low <= true <= i.high
                        for i in found])
        print(f"| {seeds} | {100 * held:.0f} % |")


if __name__ == "__main__":
    main()
