"""Test namespaces of one's own: which rights they take, what is copied, and runs in them until their end."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.evidence.core.statements import Artefact, Check, SuiteResult
from robotkube.registry.evidence.core.verification_policy import SuiteRule
from robotkube.registry.suites.core.own_namespaces import (
    KINDS,
    copies,
    is_left_behind,
    lacking,
    namespace_document,
    needed_rights,
)
from robotkube.registry.suites.loops.cluster_namespace import SuiteNamespaceSettings
from robotkube.registry.suites.loops.own_namespace_runs import STOPPED, OwnNamespaceRuns
from robotkube.registry.suites.ports.suites import Object, Subject, SuiteNamespace

IMAGE = f"host/greeter@sha256:{'1' * 64}"
RULE = SuiteRule("install", "1", 60)
SETS = [{"name": "first", "values": {}}]
MINUTE_NS = 60_000_000_000


class Namespaces:
    """The port OwnNamespaces in memory; `refused` are the words to every pod."""

    def __init__(self, refused: str = "", stays: bool = False) -> None:
        self.refused = refused
        self.stays = stays
        self.made: list[str] = []
        self.removed: list[str] = []
        self.left = ["robotkube-try-old"]

    def missing_rights(self, namespace: str) -> Sequence[str]:
        return []

    def remove_left_behind(self) -> Sequence[str]:
        return self.left

    def make(self, namespace: str, seconds: float) -> None:
        self.made.append(namespace)

    def refusal(self, namespace: str, pod: Object) -> str:
        assert pod["spec"]["containers"][0]["image"] == IMAGE
        return self.refused

    def objects(self, namespace: str) -> Any:
        return Nothing()

    def remove(self, namespace: str) -> None:
        self.removed.append(namespace)

    def is_gone(self, namespace: str) -> bool:
        return not self.stays


class Nothing:
    """The port NamespaceObjects of an empty namespace."""

    def list(self, kind: str) -> tuple[Sequence[Object], str]:
        return [], "1"

    def get(self, kind: str, name: str) -> None:
        return None

    def delete(self, kind: str, name: str, grace_seconds: int | None = None) -> None:
        return None


class ScriptedSuite:
    """A suite that does what a test says."""

    name = "install"
    version = "1"
    needs_namespace = True

    def __init__(self, act: Callable[[SuiteNamespace], None] = lambda namespace: None) -> None:
        self.act = act

    def run(self, subject: Subject, test_namespace: SuiteNamespace | None) -> Sequence[Check]:
        assert test_namespace is not None
        self.act(test_namespace)
        return [Check("a", True)]


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def subject(objects: Sequence[Object] = (), sets: Sequence[Mapping[str, Any]] = SETS) -> Callable[[str], Subject]:
    def made(namespace: str) -> Subject:
        entry = {"spec": {"suites": {"sets": list(sets)}}}
        artefact = Artefact("greeter", "1.0.0", f"sha256:{'2' * 64}", "linux/amd64")
        return Subject(artefact, entry, {}, b"", {"greeter": IMAGE}, lambda values, release: list(objects))

    return made


def settings(namespace: str, domain_id: int) -> SuiteNamespaceSettings:
    return SuiteNamespaceSettings(namespace, domain_id, "cloud-0", "ros:1", "mosquitto:1")


def runs(namespaces: Namespaces, clock: Clock | None = None, told: list[str] | None = None) -> OwnNamespaceRuns:
    said = [] if told is None else told
    render = Jinja2Templates().render
    return OwnNamespaceRuns(namespaces, settings, render, "1a2b", clock or Clock(), lambda: 0, said.append)


def test_rights_are_named_one_by_one() -> None:
    words = [str(right) for right in needed_rights("robotkube-try-x", "robotkube-suite-0")]
    assert len(set(words)) == len(words)
    assert "create namespaces in the cluster" in words
    assert "list networkpolicies.networking.k8s.io in namespace robotkube-suite-0" in words
    assert "watch deployments.apps in namespace robotkube-try-x" in words
    [log] = [right.attributes for right in needed_rights("a", "b") if right.resource == "pods/log"]
    assert (log["resource"], log["subresource"], log["verb"]) == ("pods", "log", "get")


def test_copies_have_what_the_platforms_have_and_nothing_that_gives_others_rights() -> None:
    kinds = {kind.kind: kind for kind in KINDS}
    metadata = {"namespace": "robotkube-suite-0", "uid": "u", "resourceVersion": "7", "ownerReferences": [{}]}
    quota = {"metadata": {"name": "q", **metadata}, "spec": {"hard": {"pods": "12"}}, "status": {"used": {}}}
    [copy] = copies(kinds["ResourceQuota"], [quota], "mine")
    assert copy == {
        "apiVersion": "v1",
        "kind": "ResourceQuota",
        "metadata": {"name": "q", "namespace": "mine"},
        "spec": {"hard": {"pods": "12"}},
    }
    reader = {
        "metadata": {"name": "configuration-reader", **metadata},
        "roleRef": {"kind": "Role", "name": "configuration-reader"},
        "subjects": [{"kind": "ServiceAccount", "name": "application", "namespace": "robotkube-suite-0"}],
    }
    runner = {**reader, "metadata": {"name": "suite-runner", **metadata}}
    [binding] = copies(kinds["RoleBinding"], [reader, runner], "mine")
    assert binding["subjects"] == [{"kind": "ServiceAccount", "name": "application", "namespace": "mine"}]
    assert list(copies(kinds["ServiceAccount"], [{"metadata": {"name": "default"}}], "mine")) == []


@pytest.mark.parametrize(("now_ns", "lives", "left"), [(0, True, False), (0, False, True), (2 * MINUTE_NS, True, True)])
def test_what_is_left_behind(now_ns: int, lives: bool, left: bool) -> None:
    document = namespace_document("robotkube-try-1", "machine/7", MINUTE_NS)
    asked: list[str] = []
    assert is_left_behind(document, now_ns, lambda maker: not asked.append(maker) and lives) == left
    assert asked in ([], ["machine/7"])
    other = {**document, "metadata": {**document["metadata"], "name": "vehicle-00"}}
    assert not is_left_behind(other, 2 * MINUTE_NS, lambda maker: False)


def test_what_a_copy_does_not_have_is_said() -> None:
    volumes = [{"persistentVolumeClaim": {"claimName": "scratch"}}]
    item = {"kind": "Deployment", "spec": {"template": {"spec": {"volumes": volumes}}}}
    assert "volume claim scratch" in lacking(set(), [item])
    assert "needs a database" in lacking({"database-account"}, [])
    assert lacking({"broker-account"}, [{"kind": "ConfigMap", "data": {}}]) == ""


def test_a_run_has_a_namespace_that_is_removed_in_the_end() -> None:
    namespaces = Namespaces()
    lines: list[str] = []
    seen: list[tuple[str, int, float]] = []

    def act(namespace: SuiteNamespace) -> None:
        seen.append((namespace.namespace, namespace.domain_id, namespace.seconds_left))

    with runs(namespaces, told=lines) as made:
        for _ in range(2):
            result = made.run(RULE, ScriptedSuite(act), subject())
            assert isinstance(result, SuiteResult)
            assert result.outcome == "passed"
        assert not namespaces.removed
    assert seen == [("robotkube-try-1a2b-1", 89, 60.0)] * 2
    assert namespaces.made == namespaces.removed == ["robotkube-try-1a2b-1"]
    assert lines == ["removed what an earlier try left behind: namespace robotkube-try-old"]


def test_two_runs_at_once_have_namespaces_of_their_own() -> None:
    namespaces = Namespaces()
    both = threading.Barrier(2, timeout=10)
    with runs(namespaces) as made:
        others = threading.Thread(target=made.run, args=(RULE, ScriptedSuite(lambda namespace: _wait(both)), subject()))
        others.start()
        made.run(RULE, ScriptedSuite(lambda namespace: _wait(both)), subject())
        others.join(10)
    assert sorted(namespaces.removed) == ["robotkube-try-1a2b-0", "robotkube-try-1a2b-1"]


def _wait(barrier: threading.Barrier) -> None:
    barrier.wait()


def test_what_admission_refuses_is_said_in_its_words() -> None:
    namespaces = Namespaces("only images of chart versions that are verified")
    with runs(namespaces) as made:
        answer = made.run(RULE, ScriptedSuite(), subject())
    assert answer == (
        f"the cluster lets {IMAGE} not run in a namespace of yours: only images of chart versions that are verified; "
        "submit the chart: the platform's own test namespaces take it"
    )
    assert namespaces.removed == namespaces.made


def test_a_chart_that_needs_what_is_not_there_makes_no_namespace() -> None:
    namespaces = Namespaces()
    volumes = [{"persistentVolumeClaim": {"claimName": "scratch"}}]
    item = {"kind": "Deployment", "spec": {"template": {"spec": {"volumes": volumes}}}}
    prepared = [{**SETS[0], "prepare": {"image": "ros", "command": ["x"]}}]
    with runs(namespaces) as made:
        assert "volume claim scratch" in str(made.run(RULE, ScriptedSuite(), subject([item])))
        assert "prepared on a volume claim" in str(made.run(RULE, ScriptedSuite(), subject(sets=prepared)))
    assert namespaces.made == []


def test_nothing_begins_when_the_time_is_over_or_it_was_stopped() -> None:
    clock = Clock()
    with runs(Namespaces(), clock) as made:
        clock.now = 90.0
        assert "the 100 s that a try takes at most were over" in str(made.run(RULE, ScriptedSuite(), subject()))
        made.stop()
        assert made.run(RULE, ScriptedSuite(), subject()) == STOPPED


def test_a_run_that_the_time_of_all_cuts_off_is_none() -> None:
    clock = Clock()

    def act(namespace: SuiteNamespace) -> None:
        clock.now = 101.0
        namespace.wait_ready("Pod", "late", 60)

    with runs(Namespaces(), clock) as made:
        clock.now = 55.0
        answer = made.run(RULE, ScriptedSuite(act), subject())
    assert answer == "the 100 s that a try takes at most were over after 46 s of it; try this chart alone"


def test_what_runs_ends_soon_after_it_was_stopped() -> None:
    namespaces = Namespaces()
    results: list[SuiteResult | str] = []
    waiting = threading.Event()

    def act(namespace: SuiteNamespace) -> None:
        waiting.set()
        namespace.wait_ready("Pod", "never", 60)

    with runs(namespaces) as made:
        thread = threading.Thread(target=lambda: results.append(made.run(RULE, ScriptedSuite(act), subject())))
        thread.start()
        assert waiting.wait(10)
        made.stop()
        thread.join(10)
    [result] = results
    assert isinstance(result, SuiteResult)
    assert (result.outcome, result.checks[0].found) == ("unfinished", STOPPED)
    assert namespaces.removed == namespaces.made


def test_trouble_of_the_cluster_is_no_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    namespaces = Namespaces()

    def refused(namespace: str, seconds: float) -> None:
        raise UnavailableError("API server: nobody answers")

    monkeypatch.setattr(namespaces, "make", refused)
    with runs(namespaces) as made:
        result = made.run(RULE, ScriptedSuite(), subject())
    assert isinstance(result, SuiteResult)
    assert (result.outcome, result.checks[0].found) == ("unfinished", "API server: nobody answers")
    assert namespaces.removed == ["robotkube-try-1a2b-1"], "one that is half made is removed as well"


@pytest.mark.parametrize("stays", [True, False])
def test_a_namespace_that_stays_is_named(stays: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    namespaces = Namespaces(stays=stays)
    lines: list[str] = []
    clock = Clock()
    with runs(namespaces, clock, lines) as made:
        made.run(RULE, ScriptedSuite(), subject())
        if stays:
            monkeypatch.setattr(made, "_clock", iter(range(0, 1000, 15)).__next__)
        else:
            monkeypatch.setattr(namespaces, "remove", _refuse)
    assert ("is still being removed" if stays else "kubectl delete namespace") in lines[-1]


def _refuse(namespace: str) -> None:
    raise InputError("403")
