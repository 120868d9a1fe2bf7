"""Test sets of a chart: their templates filled, their preparation, their installation in the test namespace.

The test namespace has what the chart finds in an agent's namespace, when it asks for it: the Secrets `broker-account`
and `database-account` (of a broker and a database started there), the volume claim `scratch`, and the set's ConfigMaps.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.documents.core.value_templates import Render, render_templates
from robotkube.registry.suites.core.namespace_contents import BROKER_SECRET, DATABASE_SECRET
from robotkube.registry.suites.core.requests import TestSet
from robotkube.registry.suites.ports.suites import Object, Subject, SuiteNamespace

READY_SECONDS_MAX = 90.0
READY_SHARE = 0.6  # of the time that is left: a chart that never gets ready shall leave time to report it
PREPARE_SECONDS_MAX = 60.0
SECRET_KEYS = frozenset({"secretName", "secretKeyRef", "secretRef", "secret"})


@dataclass(frozen=True)
class Installation:
    """A set that was installed: the objects, and the problem that was seen when it did not get ready (empty: it is
    ready)."""

    objects: Sequence[Object]
    problem: str = ""

    @property
    def ready(self) -> bool:
        """Return whether every workload got ready."""
        return not self.problem


def filled_sets(entry: Mapping[str, Any], agent: str, start_ns: int, render: Render) -> list[TestSet]:
    """The entry's test sets with templates filled (names `agent` and `start_ns`); DocumentError names a template that
    cannot be filled, InputError an entry without sets."""
    sets = ((entry.get("spec") or {}).get("suites") or {}).get("sets") or []
    if not sets:
        raise InputError("the entry has no test values; write spec.suites.sets with two sets")
    return [_test_set(render_templates(document, {"agent": agent, "start_ns": start_ns}, render)) for document in sets]


def _test_set(document: Mapping[str, Any]) -> TestSet:
    prepare = document.get("prepare") or {}
    return TestSet(
        name=str(document.get("name", "")),
        values=document.get("values") or {},
        prepare_image=str(prepare.get("image", "")),
        prepare_command=tuple(str(word) for word in prepare.get("command") or ()),
        config_maps={
            name: {key: str(value) for key, value in data.items()}
            for name, data in (document.get("configMaps") or {}).items()
        },
    )


def ready_seconds(test_namespace: SuiteNamespace) -> float:
    """How long a chart may take now to get ready in this test namespace, in seconds."""
    return min(READY_SECONDS_MAX, test_namespace.seconds_left * READY_SHARE)


def install(subject: Subject, test_namespace: SuiteNamespace, test_set: TestSet) -> Installation:
    """Prepare the test namespace for the set, install the chart with it (release name: the chart's name) and wait until
    it is ready. InputError when the chart cannot be rendered, prepared or made."""
    objects = subject.render(test_set.values, subject.artefact.chart)
    test_namespace.provide(test_set.config_maps)
    _start_services(objects, test_namespace)
    _prepare(subject, test_namespace, test_set)
    return apply(objects, test_namespace)


def apply(objects: Sequence[Object], test_namespace: SuiteNamespace) -> Installation:
    """Make or replace the objects and wait until their workloads are ready."""
    test_namespace.apply(objects)
    problems = [
        test_namespace.wait_ready("Deployment", str(item["metadata"]["name"]), ready_seconds(test_namespace))
        for item in objects
        if item.get("kind") == "Deployment"
    ]
    return Installation(objects, "\n".join(filter(None, problems)))


def _start_services(objects: Sequence[Object], test_namespace: SuiteNamespace) -> None:
    secrets = named_secrets(objects)
    if BROKER_SECRET in secrets:
        test_namespace.start_broker()
    if DATABASE_SECRET in secrets:
        test_namespace.start_database()


def _prepare(subject: Subject, test_namespace: SuiteNamespace, test_set: TestSet) -> None:
    if not test_set.prepare_image:
        return
    if test_set.prepare_image not in subject.images:
        known = ", ".join(sorted(subject.images)) or "none"
        raise InputError(
            f"set {test_set.name}: prepare.image {test_set.prepare_image!r} is no image of the chart; has {known}"
        )
    image = subject.images[test_set.prepare_image]
    run = test_namespace.run_pod("prepare", image, test_set.prepare_command, {}, PREPARE_SECONDS_MAX, volume_claim=True)
    if not run.succeeded:
        raise InputError(
            f"set {test_set.name}: prepare did not end well (exit code {run.exit_code}): {run.problem}\n{run.log}"
        )


def named_secrets(objects: Sequence[Object]) -> set[str]:
    """Names of the Secrets that the objects mount or have variables from."""
    return {name for item in objects for name in _secrets(item)}


def _secrets(value: Any) -> Iterator[str]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            if key == "secretName" and isinstance(inner, str):
                yield inner
            elif key in SECRET_KEYS and isinstance(inner, Mapping) and isinstance(inner.get("name"), str):
                yield inner["name"]
            yield from _secrets(inner)
    elif isinstance(value, (list, tuple)):
        for inner in value:
            yield from _secrets(inner)
