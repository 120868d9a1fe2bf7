"""What nobody of the cluster started: names and labels make nothing a known container, only what its kubelet wrote
down does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest

from ci.cluster.embedded.containers.beside_kubelets import (
    CONTAINER,
    GRACE_SECONDS,
    MAKING_SECONDS,
    SANDBOX,
    NodeContents,
    RuntimeContainer,
    Unknown,
    Watched,
    message,
    unknown,
)

BOX = RuntimeContainer("k8s.io", "b0" * 32, 10, SANDBOX, "b0" * 32, "vehicle-00", "web-1", "uid-web", program="/pause")
WEB = RuntimeContainer(
    "k8s.io", "c1" * 32, 20, CONTAINER, BOX.id, "vehicle-00", "web-1", "uid-web", "web", "/web", started=True
)
NODE = NodeContents((BOX, WEB), {WEB.link: 21}, frozenset(["uid-web"]), frozenset([BOX.id]))


def with_containers(*containers: RuntimeContainer, node: NodeContents = NODE) -> NodeContents:
    return replace(node, containers=containers)


def keys(node: NodeContents) -> list[str]:
    return [one.container.id for one in unknown(node)]


def test_what_the_kubelet_started_is_known() -> None:
    assert unknown(NODE) == ()
    assert unknown(NodeContents()) == ()


def test_the_kubelets_link_is_named_as_kubernetes_names_it() -> None:
    assert WEB.link == f"web-1_vehicle-00_web-{WEB.id}.log"
    long = replace(WEB, pod="p" * 200)
    assert long.link == f"{'p' * 200}_vehicle-00_web-{WEB.id}"[:251] + ".log"
    assert len(long.link) == 255


def test_a_container_in_another_namespace_of_the_runtime_is_nobodys_at_once() -> None:
    other = replace(WEB, runtime_namespace="default")
    [stranger] = unknown(with_containers(BOX, WEB, other))
    assert (stranger.container, stranger.certain) == (other, True)
    assert "containerd's namespace default is not k8s.io" in stranger.why


@pytest.mark.parametrize(
    "foreign",
    [
        RuntimeContainer("k8s.io", "foreign"),
        replace(WEB, id="d2" * 32),
        replace(WEB, id="d2" * 32, name="sidecar"),
        replace(WEB, id="d2" * 32, kind=""),
        replace(WEB, id="d2" * 32, kind=SANDBOX, sandbox="d2" * 32),
        replace(BOX, id="d2" * 32, sandbox="d2" * 32),
        replace(BOX, id="d2" * 32, sandbox="d2" * 32, pod_uid="uid-of-nobody"),
        replace(BOX, id="d2" * 32, sandbox=BOX.id),
    ],
    ids=["bare", "another of the same name", "sidecar", "no kind", "as sandbox", "second sandbox", "no pod", "in it"],
)
def test_what_a_container_says_of_itself_makes_it_nobodys(foreign: RuntimeContainer) -> None:
    assert keys(with_containers(BOX, WEB, foreign)) == [foreign.id]


def test_in_what_was_not_started_nothing_runs() -> None:
    made = replace(WEB, id="foreign", waits=True)
    assert unknown(with_containers(BOX, WEB, made, replace(made, runtime_namespace="default"))) == ()
    assert keys(with_containers(BOX, WEB, replace(made, waits=False))) == ["foreign"]


def test_an_id_that_the_kubelets_container_had_before_is_not_enough() -> None:
    again = replace(WEB, made_ns=30)
    assert keys(with_containers(BOX, again)) == [WEB.id]


def test_a_sandbox_that_is_younger_than_its_containers_is_another_one() -> None:
    again = replace(BOX, made_ns=30)
    assert keys(with_containers(again, WEB)) == [BOX.id]


def test_a_sandbox_stays_known_by_any_container_that_was_started_in_it() -> None:
    later = replace(WEB, id="d2" * 32, made_ns=40, name="other")
    node = NodeContents((BOX, WEB, later), {WEB.link: 21, later.link: 41})
    assert unknown(node) == ()


def test_a_sandbox_is_known_before_its_first_container() -> None:
    assert unknown(with_containers(BOX)) == ()


def test_a_sandbox_without_containers_needs_its_pod_and_the_runtimes_record() -> None:
    assert keys(replace(with_containers(BOX), pods=frozenset())) == [BOX.id]
    assert keys(replace(with_containers(BOX), recorded=frozenset())) == [BOX.id]


def test_of_two_sandboxes_that_say_to_be_of_one_pod_neither_is_known_by_that() -> None:
    second = replace(BOX, id="d2" * 32, sandbox="d2" * 32)
    node = replace(with_containers(BOX, second), recorded=frozenset([BOX.id, second.id]))
    assert keys(node) == [BOX.id, second.id]


def test_a_container_that_the_kubelet_is_about_to_write_down_takes_nothing_from_its_sandbox() -> None:
    node = replace(NODE, links={})
    assert keys(node) == [WEB.id]


class Looks:
    """Looks at one node, each a second after the one before."""

    def __init__(self) -> None:
        self.watched = Watched()
        self.now = 100.0

    def named(self, seen: Sequence[Unknown], node: str = "vehicle-00") -> list[str]:
        self.now += 1
        self.watched = self.watched.after(node, seen, self.now)
        return [one.container.id for one in self.watched.named(node, seen, self.now)]


@pytest.mark.parametrize(("started", "seconds"), [(True, GRACE_SECONDS), (False, MAKING_SECONDS)])
def test_what_says_to_be_a_kubelets_is_named_when_it_stays_unknown(started: bool, seconds: float) -> None:
    looks = Looks()
    seen = [Unknown(replace(WEB, started=started), "why")]
    named = [looks.named(seen) for _ in range(int(seconds) + 1)]
    assert named == [[]] * int(seconds) + [[WEB.id]]


def test_what_was_known_in_between_begins_anew() -> None:
    looks = Looks()
    seen = [Unknown(WEB, "why")]
    assert not any(looks.named(seen) for _ in range(int(GRACE_SECONDS)))
    looks.named([])
    assert looks.named(seen) == []


def test_what_no_kubelet_could_have_started_is_named_at_once() -> None:
    assert Looks().named([Unknown(WEB, "why", certain=True)]) == [WEB.id]


def test_nodes_are_watched_apart() -> None:
    looks = Looks()
    seen = [Unknown(WEB, "why")]
    for _ in range(int(GRACE_SECONDS)):
        looks.named(seen, "vehicle-00")
        looks.named([], "vehicle-01")
    assert looks.named(seen, "vehicle-01") == []
    assert looks.named(seen, "vehicle-00") == [WEB.id]


def test_the_message_says_what_why_and_what_to_do() -> None:
    [one] = unknown(with_containers(BOX, WEB, replace(WEB, id="foreign")))
    text = message("vehicle-00", one)
    assert "container k8s.io/foreign on node vehicle-00 runs /web" in text
    assert "the kubelet started no such container, though it says to be container web of pod vehicle-00/web-1" in text
    assert "`ctr --namespace k8s.io tasks kill --signal SIGKILL foreign`" in text
