"""Settings shared by all tests."""

from __future__ import annotations

import os

# Before NumPy loads: one thread gives equal bytes everywhere, and these arrays are small.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from hypothesis import HealthCheck, settings

# No time limit on an example: the machine is shared. Drawn by a fixed seed, so that a suite that
# passed passes again; `--hypothesis-profile=explore` searches anew each time.
settings.register_profile("default", deadline=None, derandomize=True, max_examples=100,
                          suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("explore", deadline=None, max_examples=2000)
settings.load_profile("default")
