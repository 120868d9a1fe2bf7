"""For all tests: fixtures that stages share; each random test has the same examples every time, without a time limit
of their own; tests of the fast tier start no other program; long parameters do not stand in the names of tests."""

import gc
import logging
from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("tests.stages")

# Session fixtures exist once, so plugins hold them and no conftest.py of a folder.
pytest_plugins = (
    "tests.stages.examples",
    "tests.stages.tiers",
    "tests.stages.attacks",
    "tests.stages.kubernetes.fixtures",
    "tests.stages.forge.fixtures",
    "tests.stages.recording.fixtures",
)

NAME_CHARACTERS_MAX = 80
ALLOCATIONS_BETWEEN_TESTS, ALLOCATIONS_IN_A_TEST = 25_000, 100_000
"""Before a collection, instead of 700 anywhere: tests leave little garbage in circles behind, and syntax trees and
documents are no garbage. In a test that comes to the end of its stack, what a collection calls would fail."""

gc.disable()  # until all tests are collected: what is made meanwhile stays


def pytest_collection_finish() -> None:
    """Set aside what collecting has made: the garbage collector would go through it again and again."""
    gc.freeze()
    gc.set_threshold(ALLOCATIONS_IN_A_TEST)
    gc.enable()


def pytest_runtest_logfinish() -> None:
    """Collect between two tests, so that it seldom happens in one."""
    if gc.get_count()[0] > ALLOCATIONS_BETWEEN_TESTS:
        gc.collect(1)


@pytest.fixture(autouse=True)
def own_logging() -> Iterator[None]:
    """What a test does to the loggers, by running an entry point for example, ends with it."""
    root, own = logging.getLogger(), logging.getLogger("robotkube")
    handlers = list(root.handlers)
    levels = (root.level, own.level)
    yield
    root.handlers[:] = handlers
    for logger, level in zip((root, own), levels, strict=True):
        if logger.level != level:  # setting it makes every logger forget what it has worked out
            logger.setLevel(level)


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """A name instead of a text of many lines or a megabyte; pytest numbers those that are the same."""
    if isinstance(val, str | bytes) and len(val) > NAME_CHARACTERS_MAX:
        return f"{argname} of {len(val)}"
    return None
