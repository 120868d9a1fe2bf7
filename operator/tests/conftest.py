"""For all tests: modules beside this file can be imported by name; each random test has the same 200 examples every
time, without a time limit of their own; long parameters do not stand in the names of tests."""

import logging
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

sys.path.insert(0, str(Path(__file__).parent))

NAME_CHARACTERS_MAX = 80

# a limit per example fails on a busy machine
settings.register_profile(
    "project",
    max_examples=200,
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("project")


@pytest.fixture(autouse=True)
def own_logging() -> Iterator[None]:
    """What a test does to the loggers, by running an entry point for example, ends with it."""
    root, own = logging.getLogger(), logging.getLogger("robotkube")
    handlers, levels = list(root.handlers), (root.level, own.level)
    yield
    root.handlers[:] = handlers
    root.setLevel(levels[0])
    own.setLevel(levels[1])


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """A name instead of a text of many lines or a megabyte; pytest numbers those that are the same."""
    if isinstance(val, str | bytes) and len(val) > NAME_CHARACTERS_MAX:
        return f"{argname} of {len(val)}"
    return None
