"""The manager in memory."""

from tests.stages.delivery.fixtures import stage  # noqa: F401 - fixtures
