"""What brings a broken main back, and which edits of people are left alone."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.deployment.core.policies.edits import RESPECT, REVERT, read_edits_policy
from robotkube.delivery.deployment.core.releases import Release, Source, read_tree, write_release, write_source
from robotkube.delivery.deployment.core.repairs import repair
from robotkube.delivery.manager.core.plans import Change
from robotkube.delivery.manager.core.respected_edits import respected
from robotkube.errors import DocumentError

DIGEST = "sha256:" + "1" * 64
PLAN = "20261121-100000-000001"


def files(*names: str, namespace: str = "cloud-0") -> dict[str, str]:
    texts = {}
    for name in names:
        release = Release(namespace, name, "bridge", "0.1.0", DIGEST, {"a": name}, (), PLAN)
        source = Source(namespace, "bridge", DIGEST, "oci://forge:3000/verified/bridge")
        texts |= {release.path: write_release(release), source.path: write_source(source)}
    return texts


GOOD = files("one", "two")
ONE = "releases/cloud-0/one.yaml"


def applied(now: dict[str, str], changes: dict[str, str | None]) -> dict[str, str]:
    return {path: text for path, text in {**now, **changes}.items() if text is not None}


def test_nothing_is_repaired_where_nothing_is_broken() -> None:
    assert repair(GOOD, [GOOD]) == {}


def test_a_broken_file_comes_back_as_it_last_was_good() -> None:
    older = files("one") | {ONE: GOOD[ONE].replace("a: one", "a: older")}
    history = [{**GOOD, ONE: "also: ["}, GOOD, older]
    assert repair({**GOOD, ONE: ""}, history) == {ONE: GOOD[ONE]}


def test_what_was_never_good_goes() -> None:
    junk = {"releases/cloud-0/junk.yaml": "\0", "releases/junk.yaml": "a: 1\n"}
    assert repair({**GOOD, **junk}, [GOOD]) == dict.fromkeys(junk)
    assert repair({ONE: ""}, []) == {ONE: None}


def test_of_two_with_one_name_the_newer_goes() -> None:
    intruder = files("0-one", namespace="cloud")
    changes = repair({**GOOD, **intruder}, [GOOD])
    assert changes == {"releases/cloud/0-one.yaml": None}
    assert read_tree(applied({**GOOD, **intruder}, changes)).problems == ()


def test_a_missing_source_comes_back() -> None:
    source = next(path for path in GOOD if path.startswith("sources/"))
    broken = {path: text for path, text in GOOD.items() if path != source}
    assert repair(broken, [GOOD]) == {source: GOOD[source]}


TEXTS = st.one_of(st.none(), st.just(""), st.just("\0"), st.text(max_size=30), st.sampled_from(sorted(GOOD.values())))


@given(st.dictionaries(st.sampled_from([*sorted(GOOD), "releases/x.yaml", "releases/a/b.yaml"]), TEXTS, max_size=4))
def test_a_repaired_main_is_good_whatever_was_done_to_it(edits: dict[str, str | None]) -> None:
    broken = applied(GOOD, edits)
    changes = repair(broken, [GOOD])
    assert read_tree(applied(broken, changes)).problems == ()
    assert all(text in (None, GOOD.get(path)) for path, text in changes.items())


def test_policies_are_read_strictly() -> None:
    assert (read_edits_policy("edits: revert\n"), read_edits_policy("edits: respect\n")) == (REVERT, RESPECT)
    for text in ("edits: maybe\n", "edits: [revert]\n", "other: 1\n"):
        with pytest.raises(DocumentError):
            read_edits_policy(text)


def test_an_edit_stands_until_something_else_is_wanted() -> None:
    tree = read_tree(GOOD)
    before = tree.releases[ONE]
    wanted = Release("cloud-0", "one", "bridge", "0.1.0", DIGEST, {"a": "x"}, (), PLAN)
    other = Release("cloud-0", "one", "bridge", "0.1.0", DIGEST, {"a": "y"}, (), PLAN)
    memory: dict[str, str] = {}
    edits = {ONE: "c" * 40}
    assert respected([Change(ONE, before, wanted)], edits, memory) == ()
    assert respected([Change(ONE, before, wanted)], edits, memory) == ()
    assert respected([Change(ONE, before, other)], edits, memory) == (Change(ONE, before, other),)
    assert respected([Change(ONE, before, wanted)], {}, memory) == (Change(ONE, before, wanted),)
    assert memory == {}
