"""The manager in memory, asked by commands, and the platform that is audited."""

from tests.stages.delivery.fixtures import clean, platform, stage  # noqa: F401 - fixtures
