"""The platform that audits are tried on, made once; each test that manipulates it gets a copy."""

from tests.stages.delivery.fixtures import clean, platform  # noqa: F401 - fixtures
