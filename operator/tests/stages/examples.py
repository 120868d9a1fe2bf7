"""How many examples a random test tries: the same ones each time, without a time limit of their own."""

from __future__ import annotations

import os

from hypothesis import HealthCheck, settings

ALL = 200
EXAMPLES = int(os.environ.get("ROBOTKUBE_EXAMPLES", str(ALL)))  # fewer in `make test-fast`: ci/test.py

# a limit per example fails on a busy machine
settings.register_profile(
    "project",
    max_examples=EXAMPLES,
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("project")
