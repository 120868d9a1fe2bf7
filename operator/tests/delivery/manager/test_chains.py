"""Chains of operators: who may name a parent, how deep and how wide, and what goes with a task that goes."""

from __future__ import annotations

from collections.abc import Mapping

from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.deployment.core.releases import Release, TaskCause
from robotkube.delivery.manager.core.chains import DEPTH_MAX, FAN_OUT_MAX, ChainRefusal, ChainTask, judge, lineage

TRACE = "a" * 32


def task(key: str, parent: str = "", created: str = "2026-11-21T10:00:00Z") -> ChainTask:
    return ChainTask(created, key, key.partition("/")[0], parent)


def by_key(*tasks: ChainTask) -> dict[str, ChainTask]:
    return {t.key: t for t in tasks}


def detector(namespace: str, parent: str, told: str | None = None, chart: str = "event-detector") -> Release:
    """A release that `parent` launched, with a detector that writes tasks for `told`."""
    cause = TaskCause(parent, "event", "rule", TRACE, "operator")
    values = {"detector": {"task": told or parent, "reactions": [{"kind": "operator", "rule": "near"}]}}
    return Release(namespace, f"d-{parent.replace('/', '-')}", chart, "1.0.0", f"sha256:{'0' * 64}", values, (cause,))


def launching(tasks: Mapping[str, ChainTask]) -> list[Release]:
    """A detector for every parent in each of its children's namespaces."""
    return [detector(t.namespace, t.parent) for t in tasks.values() if t.parent]


def reasons(refusals: Mapping[str, ChainRefusal]) -> dict[str, str]:
    return {key: refusal.reason for key, refusal in refusals.items()}


def chain(length: int) -> dict[str, ChainTask]:
    keys = [f"n-{i}/t" for i in range(length)]
    return by_key(*(task(key, keys[i - 1] if i else "") for i, key in enumerate(keys)))


def test_a_chain_stands_while_its_first_task_does() -> None:
    tasks = chain(DEPTH_MAX + 1)
    assert judge(tasks, {}, launching(tasks)) == {}
    gone = dict(tasks)
    del gone["n-0/t"]
    refusals = judge(gone, {}, launching(tasks))
    assert reasons(refusals) == dict.fromkeys(gone, "ParentWithdrawn")
    assert "its chain has ended at n-0/t: it is withdrawn" in refusals["n-3/t"].message


def test_what_a_refused_or_expired_task_launched_goes_too() -> None:
    tasks = chain(3)
    refusals = judge(tasks, {"n-0/t": "its lease has run out"}, launching(tasks))
    assert reasons(refusals) == {"n-1/t": "ParentWithdrawn", "n-2/t": "ParentWithdrawn"}
    assert refusals["n-2/t"].message.endswith("n-0/t: its lease has run out")


def test_a_chain_has_a_greatest_depth() -> None:
    tasks = chain(DEPTH_MAX + 3)
    refusals = judge(tasks, {}, launching(tasks))
    assert reasons(refusals) == {"n-5/t": "ChainTooDeep", "n-6/t": "ChainTooDeep"}
    assert "let an earlier operator ask" in refusals["n-5/t"].message


def test_a_parent_has_a_greatest_number_of_children_the_oldest_stay() -> None:
    children = [task(f"a/c{i:02d}", "p/t", f"2026-11-21T10:00:{i:02d}Z") for i in range(FAN_OUT_MAX + 2)]
    tasks = by_key(task("p/t"), *reversed(children))
    refusals = judge(tasks, {}, [detector("a", "p/t")])
    assert reasons(refusals) == {"a/c16": "ChainTooWide", "a/c17": "ChainTooWide"}
    grandchild = task("b/g", "a/c17")
    assert (
        reasons(judge({**tasks, "b/g": grandchild}, {}, [detector("a", "p/t"), detector("b", "a/c17")]))["b/g"]
        == "ParentWithdrawn"
    )


def test_only_a_detector_that_the_parent_launched_may_name_it() -> None:
    tasks = by_key(task("p/t"), task("a/c", "p/t"))
    wrong = {
        "in another namespace": [detector("b", "p/t")],
        "told of another task": [detector("a", "p/t", told="p/other")],
        "launched by another task": [detector("a", "p/other", told="p/t"), detector("b", "p/t")],
        "another chart": [detector("a", "p/t", chart="mqtt-bridge")],
    }
    for name, releases in wrong.items():
        refusals = judge(tasks, {}, releases)
        assert reasons(refusals) == {"a/c": "OutsideScope"}, name
        assert "leave spec.chain out" in refusals["a/c"].message
    assert judge(tasks, {}, [detector("a", "p/t")]) == {}


def test_a_parent_of_which_nothing_runs_has_no_children() -> None:
    refusals = judge(by_key(task("p/t"), task("a/c", "p/t")), {}, [])
    assert reasons(refusals) == {"a/c": "ParentWithdrawn"}
    assert refusals["a/c"].message.endswith("at p/t: nothing of it is on main")


def test_parents_in_a_ring_have_no_beginning() -> None:
    tasks = by_key(task("a/x", "b/y"), task("b/y", "a/x"), task("c/z", "c/z"))
    assert set(judge(tasks, {}, launching(tasks))) == set(tasks)


def test_values_of_any_form_are_no_detector() -> None:
    tasks = by_key(task("p/t"), task("a/c", "p/t"))
    for values in ({}, {"detector": 1}, {"detector": {}}, {"detector": {"task": ["p/t"]}}):
        release = detector("a", "p/t")
        similar = Release("a", "d", release.chart, "1.0.0", release.digest, values, release.causes)
        assert reasons(judge(tasks, {}, [similar])) == {"a/c": "OutsideScope"}


KEYS = [f"n-{i % 3}/t-{i}" for i in range(24)]


@given(st.lists(st.sampled_from(["", *KEYS]), min_size=24, max_size=24), st.sets(st.sampled_from(KEYS)))
def test_whatever_the_parents_what_stands_is_a_forest_within_its_bounds(parents: list[str], missing: set[str]) -> None:
    tasks = by_key(*(task(k, p) for k, p in zip(KEYS, parents, strict=True) if k not in missing))
    refused = judge(tasks, {}, launching(tasks))
    standing = {key: t for key, t in tasks.items() if key not in refused}
    children: dict[str, int] = {}
    for key, child in standing.items():
        line = lineage(key, standing)
        assert line[-1].parent == "", "the chain leads to a first task, and everything on it stands"
        assert len(line) <= DEPTH_MAX + 1
        children[child.parent] = children.get(child.parent, 0) + 1
    assert all(count <= FAN_OUT_MAX for parent, count in children.items() if parent)
    assert all(key in standing for key, child in tasks.items() if not child.parent)
