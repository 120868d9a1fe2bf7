"""Steadiness of an installed chart: its pods stay as they are while a suite looks at them, or say what changed."""

from __future__ import annotations

from collections.abc import Sequence

from robotkube.registry.suites.core.pod_descriptions import describe_pod, last_lines, troubled
from robotkube.registry.suites.core.soaked_pods import unsteady
from robotkube.registry.suites.ports.suites import Object, SuiteNamespace


def changes_since(before: Sequence[Object], test_namespace: SuiteNamespace) -> str:
    """What did not stay as it was when the pods were `before`, with the last lines of the logs; empty when all did."""
    after = test_namespace.pods()
    problems = unsteady(before, after)
    return "\n".join([*problems, *log_lines(after, test_namespace)]) if problems else ""


def log_lines(pods: Sequence[Object], test_namespace: SuiteNamespace) -> list[str]:
    """What the pods' containers ended with, then what they logged last; of pods in trouble alone, when there are
    any."""
    shown = [pod for pod in pods if troubled(pod)] or pods
    states = [line for pod in shown for line in describe_pod(pod)]
    return states + [line for pod in shown for line in last_lines(test_namespace.logs(pod["metadata"]["name"]))]
