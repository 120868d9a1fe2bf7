"""The gate's checks on values: what passes, and each refusal in its own words."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from robotkube.domain import checks
from robotkube.domain.catalogue import Catalogue, ChartVersion
from robotkube.domain.proposals import ChartReference, CommitMessage, write_message
from robotkube.domain.releases import Cause, Release, Source, read_tree, write_release, write_source

TIP, PLAN, OLD_PLAN = "a" * 40, "20261121-100000-000001", "20261121-090000-000001"
DIGEST, NEWER = "sha256:" + "1" * 64, "sha256:" + "2" * 64
URL = "oci://forge:3000/staging"
ONE = Cause("cloud-0/one", "e1", "near", "1" * 32, "recording")
TWO = Cause("cloud-0/two", "e2", "near", "2" * 32, "recording")
BARE = {cause: replace(cause, application="") for cause in (ONE, TWO)}
CATALOGUE = Catalogue(
    charts={
        "bridge": (
            ChartVersion("bridge", "0.1.0", "staged", DIGEST),
            ChartVersion("bridge", "0.2.0", "withdrawn", NEWER),
        )
    },
    assurance="none",
)
RULES = checks.Rules(frozenset({"cloud-0", "vehicle-00"}), URL, CATALOGUE)
BRIDGE = Release("cloud-0", "bridge", "bridge", "0.1.0", DIGEST, {"bridge": {"out": []}}, (), OLD_PLAN)
REFERENCE = ChartReference("bridge", "0.1.0", DIGEST)


def files(*releases: Release) -> dict[str, str]:
    found = {release.path: write_release(release) for release in releases}
    for release in releases:
        source = Source(release.namespace, release.chart, release.digest, f"{URL}/{release.chart}")
        found[source.path] = write_source(source)
    return found


def message(*causes: Cause, **changes: Any) -> str:
    fields: dict[str, Any] = {
        "verb": "deploy",
        "area": "recording",
        "reason": "x",
        "plan": PLAN,
        "charts": (REFERENCE,),
    }
    given = {"causes": causes, "initial": not causes}
    return write_message(CommitMessage(**{**fields, **given, **changes}))


def proposal(before: dict[str, str], after: dict[str, str], text: str) -> checks.Proposal:
    changes: dict[str, str | None] = {path: after.get(path) for path in {*before, *after}}
    changes = {path: value for path, value in changes.items() if before.get(path) != value}
    left = checks.folders_of(checks.apply_changes(before, changes))
    return checks.Proposal((TIP,), text, changes, (), read_tree(checks.folders_of(before)), read_tree(left))


def problems(found: checks.Proposal) -> str:
    verdict = checks.judge(found, TIP, RULES)
    assert not verdict.stale
    return "\n".join(verdict.problems)


def test_the_initial_configuration_is_accepted() -> None:
    new = replace(BRIDGE, plan=PLAN)
    assert problems(proposal({}, files(new), message())) == ""


def test_a_second_demand_on_a_release_names_only_the_new_task() -> None:
    old = replace(BRIDGE, causes=(ONE,))
    new = replace(BRIDGE, causes=(ONE, TWO), plan=PLAN)
    assert problems(proposal(files(old), files(new), message(TWO))) == ""


def test_a_withdrawal_names_the_task_that_went() -> None:
    old, new = replace(BRIDGE, causes=(ONE, TWO)), replace(BRIDGE, causes=(TWO,), plan=PLAN)
    assert problems(proposal(files(old), files(new), message(ONE, verb="withdraw"))) == ""
    assert "cloud-0/one is missing; its demand changes" in problems(proposal(files(old), files(new), message()))


def test_a_removed_release_takes_its_source_along() -> None:
    old = replace(BRIDGE, causes=(ONE,))
    text = message(ONE, verb="withdraw")
    assert problems(proposal(files(old), {}, text)) == ""
    source = {path: text for path, text in files(old).items() if path.startswith("sources/")}
    assert "no release uses this source; remove the file" in problems(proposal(files(old), source, text))


def test_a_release_without_its_source_is_refused() -> None:
    new = replace(BRIDGE, plan=PLAN)
    only = {path: text for path, text in files(new).items() if path.startswith("releases/")}
    assert "its source sources/cloud-0/bridge-111111111111.yaml is missing" in problems(proposal({}, only, message()))


def test_what_main_had_wrong_before_is_not_held_against_a_proposal() -> None:
    broken = {"releases/cloud-0/broken.yaml": "a: ["}
    new = files(replace(BRIDGE, plan=PLAN))
    assert problems(proposal(broken, {**broken, **new}, message())) == ""
    assert problems(proposal(broken, new, message())) == ""


def test_a_release_with_a_withdrawn_chart_can_be_removed_but_not_changed() -> None:
    old = replace(BRIDGE, version="0.2.0", digest=NEWER, causes=(ONE,))
    charts = (ChartReference("bridge", "0.2.0", NEWER),)
    assert problems(proposal(files(old), {}, message(ONE, charts=charts))) == ""
    new = replace(old, plan=PLAN, values={})
    assert "is withdrawn" in problems(proposal(files(old), files(new), message(ONE, charts=charts)))


def test_an_undeclared_agents_release_can_be_removed() -> None:
    gone = replace(BRIDGE, namespace="vehicle-99", causes=(ONE,))
    assert problems(proposal(files(gone), {}, message(ONE))) == ""
    new = replace(gone, plan=PLAN, causes=())
    assert "'vehicle-99' is not the namespace" in problems(proposal({}, files(new), message()))


REFUSALS: dict[str, tuple[Callable[[], checks.Proposal], str]] = {
    "nothing changes": (lambda: proposal({}, {}, message()), "the commit changes nothing"),
    "another file": (lambda: proposal({}, {"Makefile": ""}, message()), "Makefile: a plan may only touch"),
    "a deeper file": (
        lambda: proposal({}, {"releases/cloud-0/a/b.yaml": "a: 1"}, message()),
        "releases/cloud-0/a/b.yaml: a plan may only touch",
    ),
    "a file of another kind": (
        lambda: proposal({}, {"releases/cloud-0/notes.txt": "x"}, message()),
        "releases/cloud-0/notes.txt: a plan may only touch",
    ),
    "two releases, one name": (
        lambda: proposal(
            files(BRIDGE),
            files(BRIDGE) | files(replace(BRIDGE, namespace="cloud", name="0-bridge", plan=PLAN)),
            message(),
        ),
        "Argo CD Application name 'cloud-0-bridge' is taken",
    ),
    "a chart nobody named": (
        lambda: proposal({}, files(replace(BRIDGE, plan=PLAN)), message(charts=(ChartReference("x", "1.0.0", NEWER),))),
        f"RobotKube-Chart: bridge@0.1.0@{DIGEST} is missing",
    ),
    "a chart too many": (
        lambda: proposal(
            {}, files(replace(BRIDGE, plan=PLAN)), message(charts=(REFERENCE, ChartReference("x", "1.0.0", NEWER)))
        ),
        "no changed release has x@1.0.0",
    ),
    "a task that has no part": (
        lambda: proposal({}, files(replace(BRIDGE, plan=PLAN)), message(ONE)),
        "cloud-0/one has no part in any changed release",
    ),
    "an unnamed task": (
        lambda: proposal({}, files(replace(BRIDGE, causes=(ONE,), plan=PLAN)), message()),
        "cloud-0/one is missing; its demand changes",
    ),
    "no trailers": (lambda: proposal({}, files(replace(BRIDGE, plan=PLAN)), "deploy(x): y\n"), "RobotKube-Plan must"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_refusals(case: str) -> None:
    make, expected = REFUSALS[case]
    assert expected in problems(make())


def test_parents_decide_first() -> None:
    good = proposal({}, files(replace(BRIDGE, plan=PLAN)), message())
    assert checks.judge(good, TIP, RULES).accepted
    assert checks.judge(good, "b" * 40, RULES).stale
    assert not checks.judge(replace(good, parents=(TIP, TIP)), TIP, RULES).accepted
    assert not checks.judge(replace(good, parents=()), TIP, RULES).accepted


def test_an_irregular_file_is_named() -> None:
    found = replace(proposal({}, files(replace(BRIDGE, plan=PLAN)), message()), irregular=("releases/cloud-0/x.yaml",))
    assert "releases/cloud-0/x.yaml: not an ordinary text file" in problems(found)


def test_a_stricter_policy_refuses_staged_charts() -> None:
    strict = replace(RULES, catalogue=replace(CATALOGUE, assurance="verified"))
    found = checks.judge(proposal({}, files(replace(BRIDGE, plan=PLAN)), message()), TIP, strict)
    assert any("is staged; the release policy (assurance: verified) allows verified" in p for p in found.problems)


def test_the_refusal_is_readable_and_bounded() -> None:
    text = checks.refusal_text([f"problem\n{number}" for number in range(checks.PROBLEMS_SHOWN_MAX + 3)])
    assert "- problem 0\n" in text
    assert text.endswith("- and 3 more\n")
