"""The manager in memory, asked by commands."""

from tests.stages.delivery.fixtures import stage  # noqa: F401 - fixtures
