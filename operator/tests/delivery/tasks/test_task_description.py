"""Reading tasks: every field, every refusal in words; the reference page says the same."""

from __future__ import annotations

import re
from typing import Any

import pytest
import yaml

from robotkube.delivery.tasks.core.task_description import (
    PROBLEM_CHARACTERS_MAX,
    PROBLEMS_MAX,
    REASON_TEXTS,
    SETTLED_REASONS,
    TaskDescription,
    TaskPlacement,
    read_task,
)
from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.times import time_ns
from robotkube.foundation.kubernetes.core.annotations import RENEWED_ANNOTATION
from tests.stages.delivery.tasks.random_tasks import good
from tests.stages.paths import REPOSITORY

PAGE = REPOSITORY / "docs/reference/task-description.md"


def read(**spec: Any) -> TaskDescription:
    """The good task with some fields otherwise; None leaves one out."""
    document = good()
    changed = {**document["spec"], **spec}
    document["spec"] = {key: value for key, value in changed.items() if value is not None}
    return read_task(document)


def test_what_a_task_leaves_out_has_a_stated_meaning() -> None:
    left_out = dict.fromkeys(("priority", "lease", "conflictPolicy", "queue", "placement", "requirements"))
    task = read(**left_out)
    assert (task.priority, task.lease_seconds, task.expires_ns) == (100, None, None)
    assert (task.conflict_policy, task.queue_seconds_max, task.offload_to) == ("Reject", 600, ("cloud",))
    assert (task.placement, task.requirements, task.parent) == (TaskPlacement(), (), "")


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ({"provides": "a/b"}, "needs exactly one of `application` and `provides`"),
        ({"application": None}, "needs exactly one of `application` and `provides`"),
        ({"priority": True}, "spec.priority: must be a whole number from 0 to 1000"),
        ({"priority": 10**400}, "spec.priority: must be a whole number from 0 to 1000"),
        ({"lease": {"seconds": 4}}, "spec.lease.seconds: must be a whole number from 5 to 86400"),
        ({"offloadTo": ["cloud"]}, "spec.offloadTo: only with conflictPolicy Offload; remove it"),
        ({"conflictPolicy": "Reject"}, "spec.queue: only with conflictPolicy Postpone; remove it"),
        ({"conflictPolicy": ["Reject"]}, "must be one of Reject, Postpone, Offload, Preempt"),
        ({"placement": {"agents": ["vehicle-07"]}}, "vehicle-07 is named neither by the parameters nor by the event"),
        ({"placement": {"roles": ["a"] * 33}}, "spec.placement.roles: 33 entries, at most 32"),
        ({"placement": {"antiAffinity": ["a/b/c"]}}, "spec.placement.antiAffinity[0]"),
        ({"requirements": [{"guarantee": "latency", "unit": "ms"}]}, "needs exactly one of atMost, atLeast"),
        ({"requirements": [{"guarantee": "latency", "atMost": 10**400, "unit": "ms"}]}, "atMost: must be a number"),
        ({"requirements": [{"guarantee": "x", "atLeast": float("nan"), "unit": "ms"}]}, "atLeast: must be a number"),
        ({"chain": {"parent": "nobody"}}, "spec.chain.parent"),
        ({"parameters": {"x": "y" * 20_000}}, "at most 16384"),
        ({"colour": "red"}, "spec.colour: unknown key; remove it"),
    ],
)
def test_what_cannot_be_read_is_named_with_the_fix(spec: dict[str, Any], words: str) -> None:
    with pytest.raises(DocumentError) as refusal:
        read(**spec)
    assert words in str(refusal.value)


def test_agents_of_the_event_and_of_the_parameters_may_be_named() -> None:
    document = good()
    document["metadata"]["annotations"] = {"robotkube.io/agents": "vehicle-05"}
    document["spec"]["placement"] = {"agents": ["vehicle-05", "vehicle-00"]}
    assert read_task(document).placement.agents == ("vehicle-05", "vehicle-00")


@pytest.mark.parametrize(
    "text", ["yesterday", "2026-02-30T00:00:00Z", "2026-11-21", "2026-11-21T10:00:00", "\x00", "x" * 10**6]
)
def test_a_renewal_that_is_no_time_is_refused(text: str) -> None:
    document = good()
    document["metadata"]["annotations"] = {RENEWED_ANNOTATION: text}
    with pytest.raises(DocumentError, match="must be an RFC 3339 time"):
        read_task(document)


def test_the_lease_counts_from_the_later_of_creation_and_renewal() -> None:
    document = good()
    document["metadata"]["annotations"] = {RENEWED_ANNOTATION: "2026-11-21T11:00:10+01:00"}
    assert read_task(document).expires_ns == time_ns("2026-11-21T10:01:10Z")


def test_a_refusal_is_short_whatever_the_task() -> None:
    spec = {f"key-{number}-{'x' * 5000}": number for number in range(1000)}
    with pytest.raises(DocumentError) as refusal:
        read(**spec)
    assert len(refusal.value.problems) == PROBLEMS_MAX
    assert max(map(len, refusal.value.problems)) <= PROBLEM_CHARACTERS_MAX


def test_the_page_lists_every_reason_with_its_sentence() -> None:
    rows = re.findall(r"^\| ([A-Za-z, ]+) \| [A-Za-z, ]+ \| ([A-Za-z]+) \| (.+) \|$", PAGE.read_text(), re.MULTILINE)
    listed = {(condition, reason, text) for names, reason, text in rows for condition in names.split(", ")}
    assert listed - {("condition", "reason", "it says")} == {
        (c, reason, text) for c, texts in REASON_TEXTS.items() for reason, text in texts.items()
    }
    assert all(reason in REASON_TEXTS["Accepted"] for reason in SETTLED_REASONS)


def test_the_example_of_the_page_can_be_read() -> None:
    example = re.search(r"```yaml\n(.+?)```", PAGE.read_text(), re.DOTALL)
    assert example
    document = yaml.safe_load(example[1])
    document["metadata"]["creationTimestamp"] = "2026-11-21T10:00:00Z"
    task = read_task(document)
    assert (task.provides, task.conflict_policy, task.queue_seconds_max) == ("perception/detection", "Postpone", 120)
