"""`make reference`: docs/reference/metrics.md from the metrics that the application manager declares."""

from __future__ import annotations

from ci.docs import markdown
from ci.folders import PROJECT
from robotkube.delivery.manager.adapters.prometheus import reference

PAGE = PROJECT / "docs" / "reference" / "metrics.md"
HEAD = """# Metrics of the application manager

Written by `make reference` from the code; a test says when this page is not current. The manager serves them at
`/metrics` of its ports (`health`, 8081, is the one for Prometheus:
[ports](settings.md#ports-of-manager-gate-and-suite-runner)) in Prometheus' text form, in base units. Labels take values
of closed lists only, so that no task, plan or agent makes a series of its own. The process's own
(`process_resident_memory_bytes`, ...) come with them.

"""


def page() -> str:
    """The whole page."""
    return markdown.wrapped(f"{HEAD}{reference()}")
