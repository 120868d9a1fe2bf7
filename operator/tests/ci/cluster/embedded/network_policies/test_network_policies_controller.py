"""The nodes' rules follow policies, namespaces, pods and the addresses that nodes give out; what is not known is cut
off, and what cannot be done is done later."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ci.cluster.embedded.network.pod_links import PodLink
from ci.cluster.embedded.network_policies.controller import (
    AGAIN_SECONDS,
    POLL_SECONDS,
    KnownPod,
    Observed,
    PolicyController,
    known_pod,
    policy,
    reconcile,
    woken,
)
from ci.cluster.embedded.network_policies.enforcement import REPORT_SECONDS, PolicyReport, rules
from ci.errors import InputError, SetUpError
from ci.machine.network_policies import OFF, ON, VARIABLE, choice, lacking

WEB = PodLink("vethweb", "10.244.0.2", "shop", "web", "uid-web")
STORE = PodLink("vethstore", "10.244.1.2", "shop", "store", "uid-store")
DENY = {"metadata": {"namespace": "shop", "name": "deny"}, "spec": {"podSelector": {}}}


def document(namespace: str, name: str, uid: str, **spec: Any) -> dict[str, Any]:
    return {"metadata": {"namespace": namespace, "name": name, "uid": uid, "labels": {"app": name}}, "spec": spec}


class Cluster:
    """Two nodes and what the API server says of their pods; `failing`: who raises, and what it says."""

    def __init__(self) -> None:
        self.given: dict[str, frozenset[PodLink]] = {"one": frozenset([WEB]), "two": frozenset([STORE])}
        pods = [known_pod(document(link.namespace, link.name, link.uid)) for link in (WEB, STORE)]
        self.observed = Observed([], {"shop": {}}, dict(pods))
        self.failing: dict[str, str] = {}
        self.asked = 0
        self.written: list[str] = []
        self.rules: dict[str, str] = {}
        self.controller = PolicyController(self.links, self.observe, self.apply)

    def links(self) -> dict[str, frozenset[PodLink]]:
        self._raise("links")
        return dict(self.given)

    def observe(self) -> Observed:
        self.asked += 1
        self._raise("api")
        return self.observed

    def apply(self, node: str, text: str) -> None:
        self._raise(node)
        self.written.append(node)
        self.rules[node] = text

    def _raise(self, who: str) -> None:
        if who in self.failing:
            raise SetUpError(self.failing[who])

    def knows(self, node: str, link: PodLink) -> bool:
        """Return whether the node's rules let the pod send at all."""
        return f'"{link.port}" . {link.address}' in self.rules[node]

    def step(self, changed: bool = True) -> list[str]:
        """The nodes whose rules were replaced in one step, in their order."""
        self.written = []
        self.controller.step(changed)
        return self.written


@pytest.fixture
def cluster() -> Cluster:
    made = Cluster()
    made.step()
    return made


def test_a_pod_that_everybody_knows_has_rules(cluster: Cluster) -> None:
    assert cluster.knows("one", WEB)
    assert cluster.knows("two", STORE)
    assert (cluster.controller.nodes, cluster.controller.policies) == (2, 0)


def test_rules_that_stay_the_same_are_not_written_again(cluster: Cluster) -> None:
    assert cluster.step() == []


def test_nothing_is_asked_as_long_as_nothing_changes(cluster: Cluster) -> None:
    before = cluster.asked
    assert cluster.step(changed=False) == []
    assert cluster.asked == before


def test_a_policy_is_followed(cluster: Cluster) -> None:
    cluster.observed = replace(cluster.observed, policies=[policy(DENY, set())])
    assert cluster.step() == ["one", "two"]
    assert all("shop: deny" in text for text in cluster.rules.values())
    assert cluster.controller.policies == 1


def test_a_new_pods_node_comes_after_those_that_let_it_in(cluster: Cluster) -> None:
    """So it finds nobody closed who is open to it."""
    new = PodLink("vethnew", "10.244.0.3", "shop", "new", "uid-new")
    allow = {**DENY, "spec": {"podSelector": {}, "ingress": [{"from": [{"podSelector": {}}]}]}}
    pods = {**cluster.observed.pods, "uid-new": KnownPod("shop/new", {}, {})}
    cluster.observed = replace(cluster.observed, policies=[policy(allow, set())], pods=pods)
    cluster.given["one"] |= {new}
    assert cluster.step(changed=False) == ["two", "one"]
    assert cluster.knows("one", new)
    assert "10.244.0.2/31" in cluster.rules["two"]


@pytest.mark.parametrize(
    "pods",
    [
        {},
        {"uid-web": KnownPod("shop/other", {}, {})},
        {"uid-of-another": KnownPod("shop/web", {}, {})},
        {"uid-web": KnownPod("bank/web", {}, {})},
    ],
)
def test_an_address_whose_pod_is_not_known_is_cut_off(cluster: Cluster, pods: dict[str, KnownPod]) -> None:
    cluster.observed = replace(cluster.observed, pods=pods)
    cluster.step()
    assert not cluster.knows("one", WEB)


def test_a_pod_whose_namespace_is_not_known_is_cut_off(cluster: Cluster) -> None:
    cluster.observed = replace(cluster.observed, namespaces={})
    cluster.step()
    assert not cluster.knows("one", WEB)


def test_an_address_that_was_taken_back_is_nobodys(cluster: Cluster) -> None:
    cluster.given["one"] = frozenset()
    assert cluster.step(changed=False) == ["one"]
    assert not cluster.knows("one", WEB)


def test_a_node_that_joins_gets_rules_and_one_that_went_and_came_gets_them_anew(cluster: Cluster) -> None:
    cluster.given["three"] = frozenset()
    assert cluster.step(changed=False) == ["three"]
    del cluster.given["two"]
    cluster.step(changed=False)
    assert cluster.controller.nodes == 2
    cluster.given["two"] = frozenset([STORE])
    assert "two" in cluster.step(changed=False)


def test_while_the_api_server_is_away_rules_stay_and_new_pods_are_cut_off(cluster: Cluster) -> None:
    before = dict(cluster.rules)
    new = PodLink("vethnew", "10.244.0.3", "shop", "new", "uid-new")
    cluster.failing["api"] = "away"
    cluster.given["one"] |= {new}
    with pytest.raises(SetUpError, match="away"):
        cluster.step(changed=False)
    assert cluster.rules == before
    cluster.failing.clear()
    cluster.observed = replace(
        cluster.observed, pods={**cluster.observed.pods, "uid-new": KnownPod("shop/new", {}, {})}
    )
    assert cluster.step(changed=False) == ["one"], "it was not asked again"
    assert cluster.knows("one", new)


def test_a_node_that_takes_no_rules_keeps_no_other_from_its_own(cluster: Cluster) -> None:
    cluster.observed = replace(cluster.observed, policies=[policy(DENY, set())])
    cluster.failing["one"] = "nft: no"
    with pytest.raises(SetUpError, match="nft: no"):
        cluster.step()
    assert cluster.written == ["two"]
    cluster.failing.clear()
    assert cluster.step(changed=False) == ["one"]


def test_a_process_that_starts_again_writes_everything_anew(cluster: Cluster) -> None:
    """Whatever was there: it may be of other policies."""
    cluster.controller = PolicyController(cluster.links, cluster.observe, cluster.apply)
    assert cluster.step() == ["one", "two"]


def test_a_policy_that_is_not_understood_denies_everything_and_is_named() -> None:
    complaints: set[str] = set()
    odd = {**DENY, "spec": {"podSelector": {}, "ingress": [{"from": [{"cosmicSelector": {}}]}]}}
    odd_policy = policy(odd, complaints)
    assert (odd_policy.namespace, odd_policy.pods, odd_policy.ingress, odd_policy.egress) == ("shop", (), (), ())
    assert len(complaints) == 1
    assert "shop/deny" in complaints.pop()


def test_named_ports_are_those_of_containers_and_of_sidecars() -> None:
    def container(name: str, port: int, **more: Any) -> dict[str, Any]:
        return {"ports": [{"name": name, "containerPort": port, **more}, {"containerPort": 1}]}

    spec = {
        "containers": [container("http", 80), container("http", 81), container("dns", 53, protocol="UDP"), {}],
        "initContainers": [container("once", 5), {**container("side", 6), "restartPolicy": "Always"}],
    }
    uid, pod = known_pod(document("shop", "web", "uid", **spec))
    assert uid == "uid"
    assert pod == KnownPod("shop/web", {"app": "web"}, {("TCP", "http"): 80, ("UDP", "dns"): 53, ("TCP", "side"): 6})


class EndedError(Exception):
    """No more waits."""


def steps(
    cluster: Cluster, waits: Iterator[bool], clock: Callable[[], float]
) -> tuple[list[float], list[PolicyReport]]:
    """Follow until there are no more waits; how long each was to be, and the reports."""
    asked: list[float] = []
    reports: list[PolicyReport] = []

    def wait(seconds: float) -> bool:
        asked.append(seconds)
        try:
            return next(waits)
        except StopIteration:
            raise EndedError from None

    with pytest.raises(EndedError):
        reconcile(cluster.controller, wait, reports.append, clock)
    return asked, reports


def test_what_keeps_it_from_following_is_reported_and_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    cluster = Cluster()
    cluster.failing["api"] = "away"

    def waits() -> Iterator[bool]:
        yield False
        yield False
        cluster.failing.clear()
        yield False

    asked, reports = steps(cluster, waits(), lambda: 5.0)
    assert asked == [AGAIN_SECONDS, AGAIN_SECONDS, AGAIN_SECONDS, POLL_SECONDS]
    assert reports == [PolicyReport(0, 0, 5.0, "away"), PolicyReport(0, 2, 5.0, "")]
    assert [record.message for record in caplog.records] == ["network policies: the rules stay as they are: away"]


@pytest.mark.parametrize("passed", [REPORT_SECONDS, -1.0])
def test_everything_is_read_again_now_and_then(passed: float) -> None:
    """Whatever a watch has missed; also when the machine's clock was set back."""
    cluster = Cluster()
    now = [0.0]

    def waits() -> Iterator[bool]:
        yield False
        assert cluster.asked == 1
        now[0] += passed
        yield False
        assert cluster.asked == 2

    _, reports = steps(cluster, waits(), lambda: now[0])
    assert [report.at for report in reports] == [0.0, passed]


def test_a_change_wakes_and_is_forgotten_before_anything_is_read() -> None:
    changed = threading.Event()
    assert not woken(changed, 0.0)
    changed.set()
    assert woken(changed, 0.0)
    assert not changed.is_set()


class Late(threading.Event):
    """Set between the end of a wait and what comes after it."""

    def wait(self, timeout: float | None = None) -> bool:
        changed = super().wait(0)
        self.set()
        return changed


def test_a_change_right_after_a_wait_is_for_the_next_one() -> None:
    changed = Late()
    assert not woken(changed, 0.0)
    assert woken(changed, 0.0)


def test_policies_are_enforced_unless_somebody_says_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    assert choice() == ON
    monkeypatch.setenv(VARIABLE, OFF)
    assert choice() == OFF
    monkeypatch.setenv(VARIABLE, "yes")
    with pytest.raises(InputError, match=f"{VARIABLE}: 'yes' must be one of on, off"):
        choice()


def test_a_machine_that_cannot_enforce_them_is_told_before_anything_is_built(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))  # where no modprobe is
    monkeypatch.setenv(VARIABLE, ON)
    sentence = lacking(tmp_path)
    assert sentence is not None
    assert "no br_netfilter, so network policies would not hold between pods of one node" in sentence
    assert sentence.endswith(f"or set {VARIABLE}=off.")
    monkeypatch.setenv(VARIABLE, OFF)
    assert lacking(tmp_path) is None
    (tmp_path / "net" / "bridge").mkdir(parents=True)
    (tmp_path / "net" / "bridge" / "bridge-nf-call-iptables").touch()
    monkeypatch.setenv(VARIABLE, ON)
    assert lacking(tmp_path) is None


def test_a_cluster_that_enforces_is_another_one_and_so_is_one_of_other_rules() -> None:
    assert rules(OFF) == [OFF]
    assert any("class Rulebook" in text for text in rules(ON))
