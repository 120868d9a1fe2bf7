"""The install suite in a test namespace in memory: every verdict with its words."""

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from robotkube.errors import InputError
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.loops.install import InstallSuite
from robotkube.registry.suites.loops.installed.changing import SettingsChange
from robotkube.registry.suites.loops.installed.soak import Soak
from robotkube.registry.suites.ports.suites import Object, PodEnd, PodRun, Subject
from robotkube.testing.suites import ENTRY, MemoryTestNamespace, deployment, make_subject

RENDER = Jinja2Templates().render
CHANGE = SettingsChange("observer@sha256:1", RENDER, lambda: "secret")
ORDERLY = PodEnd("greeter-1", 1.0, 3.0, {"main": 0})


def judge(test_namespace: MemoryTestNamespace, subject: Subject | None = None) -> dict[str, Check]:
    suite = InstallSuite(RENDER, lambda: 7, Soak("observer@sha256:1", RENDER, lambda: "secret", 0), CHANGE)
    return {check.name: check for check in suite.run(subject or make_subject(), test_namespace)}


def verdicts(checks: Mapping[str, Check]) -> dict[str, bool]:
    return {name: check.passed for name, check in checks.items()}


def with_set(**more: Any) -> Mapping[str, Any]:
    first = {"name": "one", "values": {"placement": {"agent": "{{ agent }}"}}, **more}
    return {**ENTRY, "spec": {"suites": {"sets": [first, {"name": "two", "values": {}}]}}}


def test_a_chart_that_does_everything_right() -> None:
    test_namespace = MemoryTestNamespace(ends=[[ORDERLY]])
    checks = judge(test_namespace)
    assert verdicts(checks) == {
        "installs": True,
        "becomes-ready": True,
        "stops-within-its-grace": True,
        "leaves-nothing-behind": True,
        "upgrades": True,
    }
    assert "nothing to upgrade from" in checks["upgrades"].found
    assert checks["stops-within-its-grace"].found == "pod greeter-1 ended after 1 s of the 3 s it may take"
    assert test_namespace.objects == {}


def test_the_first_set_with_its_templates_filled_and_what_it_needs() -> None:
    seen: list[Any] = []

    def render(values: Mapping[str, Any], release: str) -> list[dict[str, Any]]:
        seen.append((values, release))
        volumes = [{"name": "b", "secret": {"secretName": "broker-account"}}]
        environment = [{"name": "P", "valueFrom": {"secretKeyRef": {"name": "database-account", "key": "password"}}}]
        rendered = deployment(release, volumes=volumes)
        rendered["spec"]["template"]["spec"]["containers"][0]["env"] = environment
        return [rendered]

    entry = with_set(prepare={"image": "ros", "command": ["make", 1]}, configMaps={"run": {"start": "{{ start_ns }}"}})
    test_namespace = MemoryTestNamespace()
    checks = judge(test_namespace, make_subject(render, entry, images={"ros": "r@sha256:1"}))
    assert verdicts(checks)["becomes-ready"]
    assert seen == [({"placement": {"agent": "cloud-0"}}, "greeter")]
    assert [name for name, _ in test_namespace.calls] == [
        "provide", "start_broker", "start_database", "run_pod", "apply", "delete",
    ]  # fmt: skip
    assert test_namespace.calls[3][1] == {
        "name": "prepare",
        "image": "r@sha256:1",
        "command": ("make", "1"),
        "files": {},
    }


@pytest.mark.parametrize(
    ("entry", "runs", "words"),
    [
        ({}, [], "the entry has no test values"),
        (with_set(prepare={"image": "ghost", "command": []}), [], "prepare.image 'ghost' is no image of the chart"),
        (with_set(prepare={"image": "ros"}), [PodRun("no such bag", 1)], "no such bag"),
        (with_set(values={"a": "{{ nobody }}"}), [], "nobody"),
    ],
)
def test_a_set_that_cannot_be_installed(entry: Mapping[str, Any], runs: list[PodRun], words: str) -> None:
    checks = judge(MemoryTestNamespace(runs=runs), make_subject(entry=entry, images={"ros": "r@sha256:1"}))
    assert verdicts(checks) == {"installs": False}
    assert words in checks["installs"].found
    assert checks["installs"].fix


def test_a_chart_that_the_api_server_or_helm_refuses() -> None:
    def refuse(objects: Sequence[Object]) -> None:
        raise InputError("API server: PATCH deployments/greeter: 422 spec.selector: Required value")

    checks = judge(MemoryTestNamespace(on_apply=refuse))
    assert verdicts(checks) == {"installs": False}
    assert "spec.selector: Required value" in checks["installs"].found


def test_a_chart_that_is_never_ready() -> None:
    problem = "Deployment greeter was not ready after 60 s\npod greeter-1: container main waits: CrashLoopBackOff"
    checks = judge(MemoryTestNamespace(readiness=[problem]))
    assert verdicts(checks) == {"installs": True, "becomes-ready": False}
    assert "CrashLoopBackOff" in checks["becomes-ready"].found
    assert "readiness probe" in checks["becomes-ready"].fix


def test_a_chart_that_ignores_sigterm() -> None:
    checks = judge(MemoryTestNamespace(ends=[[PodEnd("greeter-1", 3.2, 3.0, {"main": 137, "side": 0})]]))
    assert not checks["stops-within-its-grace"].passed
    assert checks["stops-within-its-grace"].found == (
        "pod greeter-1: container main did not end on SIGTERM within 3 s and was killed (exit code 137)"
    )
    assert "handle SIGTERM" in checks["stops-within-its-grace"].fix
    assert checks["leaves-nothing-behind"].passed


def test_a_pod_that_stays() -> None:
    checks = judge(
        MemoryTestNamespace(ends=[[PodEnd("greeter-1", 0.0, 3.0, {"main": None}, gone=False)]], left=["Pod greeter-1"])
    )
    assert "still there 20 s after its grace of 3 s" in checks["stops-within-its-grace"].found
    assert checks["leaves-nothing-behind"].found == "still there after the chart was deleted: Pod greeter-1"


def test_an_end_by_the_signal_itself_is_an_end() -> None:
    checks = judge(MemoryTestNamespace(ends=[[PodEnd("greeter-1", 0.1, 3.0, {"main": 143})]]))
    assert checks["stops-within-its-grace"].passed


def old() -> Subject:
    return make_subject(lambda values, release: [deployment(release), config_map("old")], version="0.1.0")


def config_map(name: str) -> dict[str, Any]:
    return {"apiVersion": "v1", "kind": "ConfigMap", "metadata": {"name": name}}


def test_an_upgrade_applies_the_new_over_the_old_and_deletes_what_is_no_more() -> None:
    test_namespace = MemoryTestNamespace()
    checks = judge(test_namespace, make_subject(replaced=old()))
    assert checks["upgrades"] == Check("upgrades", True, "from 0.1.0")
    assert [call for call in test_namespace.calls if call[0] in ("apply", "delete")] == [
        ("apply", ["greeter"]),
        ("delete", ["greeter"]),
        ("apply", ["greeter", "old"]),
        ("apply", ["greeter"]),
        ("delete", ["old"]),
    ]


def test_an_upgrade_after_which_nothing_gets_ready() -> None:
    checks = judge(
        MemoryTestNamespace(readiness=["", "", "container main waits: ImagePullBackOff"]), make_subject(replaced=old())
    )
    assert checks["upgrades"].found == "from 0.1.0: container main waits: ImagePullBackOff"
    assert not checks["upgrades"].passed


def test_an_upgrade_from_a_version_that_does_not_start_itself() -> None:
    checks = judge(MemoryTestNamespace(readiness=["", "no pod"]), make_subject(replaced=old()))
    assert "version 0.1.0, which it replaces, did not get ready itself: no pod" in checks["upgrades"].found


def test_an_upgrade_that_the_api_server_refuses() -> None:
    applied: list[int] = []

    def refuse(objects: Sequence[Object]) -> None:
        applied.append(len(objects))
        if len(applied) == 3:
            raise InputError("spec.selector: field is immutable")

    checks = judge(MemoryTestNamespace(on_apply=refuse), make_subject(replaced=old()))
    assert checks["upgrades"].found == "from 0.1.0: spec.selector: field is immutable"
    assert "selectors" in checks["upgrades"].fix


def test_it_needs_a_test_namespace() -> None:
    with pytest.raises(InputError, match="needs a test namespace"):
        InstallSuite(RENDER, lambda: 7, Soak("observer@sha256:1", RENDER, lambda: "secret", 0), CHANGE).run(
            make_subject(), None
        )
