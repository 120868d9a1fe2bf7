"""How many examples a random test tries: the same ones each time, without a time limit of their own. Random tests have
the marker `random`."""

from __future__ import annotations

import os

import pytest
from hypothesis import HealthCheck, is_hypothesis_test, settings

from ci.test.groups import ALL_EXAMPLES
from ci.test.groups import EXAMPLES as VARIABLE

EXAMPLES = int(os.environ.get(VARIABLE, str(ALL_EXAMPLES)))

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


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their markers
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks what is drawn by Hypothesis, and all tests of modules that take EXAMPLES from here."""
    for item in items:
        module = item.getparent(pytest.Module)
        drawn = is_hypothesis_test(getattr(item, "obj", None)) or (module and hasattr(module.obj, "EXAMPLES"))
        if drawn and not item.get_closest_marker("random"):
            item.add_marker(pytest.mark.random)
