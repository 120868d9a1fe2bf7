"""The gate's checks on values: what passes, and each refusal in its own words."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import pytest

from robotkube.delivery.deployment.core.commit_messages import CommitMessage, write_message
from robotkube.delivery.deployment.core.releases import (
    Release,
    Source,
    TaskCause,
    read_tree,
    write_release,
    write_source,
)
from robotkube.delivery.gate.core import proposal_checks, verdict_comments
from robotkube.delivery.gate.core.release_checks import Rules
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.foundation.forge.core import merge_comments
from robotkube.registry.catalogue.core.applications import Application
from robotkube.registry.catalogue.core.catalogue import Catalogue, ChartVersion
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.charts.core.values_schemas import overlay
from tests.stages.attacks import shown

ACCOUNT = "manager"
TERM = 7
TIP = "a" * 40
PLAN = "20261121-100000-000001"
OLD_PLAN = "20261121-090000-000001"
DIGEST, NEWER = "sha256:" + "1" * 64, "sha256:" + "2" * 64
URL = "oci://forge:3000/verified"
SUMMARY, OTHER_SUMMARY = "sha256:" + "5" * 64, "sha256:" + "6" * 64
ONE = TaskCause("cloud-0/one", "e1", "near", "1" * 32, "recording", '{"seconds":5}')
TWO = TaskCause("cloud-0/two", "e2", "near", "2" * 32, "recording")
PARAMETERS = {
    "type": "object",
    "additionalProperties": False,
    "required": ["seconds"],
    "properties": {"seconds": {"type": "integer", "default": 10}},
}
SCHEMA = {
    "$schema": "http://json-schema.org/draft-07/schema#",
    "type": "object",
    "additionalProperties": False,
    "required": ["bridge", "image"],
    "properties": {
        "bridge": {"type": "object", "properties": {"out": {"type": "array"}}},
        "image": {"type": "string"},
        "global": {"type": "object", "properties": {"plan": {"type": "string"}}},
    },
    "default": {"image": "x", "bridge": {"out": [1]}},
}
PROVED = {"evidence": SUMMARY, "policy": "sha256:" + "7" * 64, "assured": True, "evidence_problem": ""}
CATALOGUE = Catalogue(
    applications={"recording": Application("recording", "Records", (), PARAMETERS, ())},
    charts={
        "bridge": (
            ChartVersion("bridge", "0.1.0", "verified", DIGEST, **PROVED),
            ChartVersion("bridge", "0.2.0", "withdrawn", NEWER, **PROVED),
        )
    },
)


def schema(chart: str, version: str) -> Mapping[str, Any] | None:
    return SCHEMA if chart == "bridge" else None


RULES = Rules(
    "manager",
    frozenset({"cloud-0", "vehicle-00"}),
    URL,
    CATALOGUE,
    schema,
    validate,
    lambda release: (),
    frozenset({"edge-0"}),
)
BRIDGE = Release("cloud-0", "bridge", "bridge", "0.1.0", DIGEST, {"bridge": {"out": []}}, (), OLD_PLAN, SUMMARY)
REFERENCE = ChartReference("bridge", "0.1.0", DIGEST)


def files(*releases: Release) -> dict[str, str]:
    texts = {release.path: write_release(release) for release in releases}
    for release in releases:
        source = Source(release.namespace, release.chart, release.digest, f"{URL}/{release.chart}")
        texts[source.path] = write_source(source)
    return texts


def message(*causes: TaskCause, **changes: Any) -> str:
    fields: dict[str, Any] = {
        "verb": "deploy",
        "area": "recording",
        "reason": "x",
        "plan": PLAN,
        "charts": (REFERENCE,),
        "manager": ACCOUNT,
        "term": TERM,
    }
    evidence = (SUMMARY,) * len(changes.get("charts", fields["charts"]))
    given = {"causes": causes, "kinds": () if causes else ("initial",), "evidence": evidence}
    return write_message(CommitMessage(**{**fields, **given, **changes}))


def proposal(before: dict[str, str], after: dict[str, str], text: str) -> proposal_checks.ProposedCommit:
    changes: dict[str, str | None] = {path: after.get(path) for path in {*before, *after}}
    changes = {path: value for path, value in changes.items() if before.get(path) != value}
    left = proposal_checks.folders_of(proposal_checks.apply_changes(before, changes))
    return proposal_checks.ProposedCommit(
        (TIP,), text, changes, (), read_tree(proposal_checks.folders_of(before)), read_tree(left)
    )


def problems(found: proposal_checks.ProposedCommit) -> str:
    verdict = proposal_checks.judge(found, TIP, RULES)
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
    assert "state withdrawn is not allowed" in problems(proposal(files(old), files(new), message(ONE, charts=charts)))


def test_an_undeclared_agents_release_can_be_removed() -> None:
    gone = replace(BRIDGE, namespace="vehicle-99", causes=(ONE,))
    assert problems(proposal(files(gone), {}, message(ONE))) == ""
    new = replace(gone, plan=PLAN, causes=())
    assert "'vehicle-99' is not a namespace that account manager may touch" in problems(
        proposal({}, files(new), message())
    )


def test_another_proposers_release_can_not_even_be_removed() -> None:
    theirs = replace(BRIDGE, namespace="edge-0", causes=(ONE,))
    assert "'edge-0' is not a namespace that account manager may touch (it has cloud-0, vehicle-00)" in problems(
        proposal(files(theirs), {}, message(ONE))
    )


REFUSALS: dict[str, tuple[Callable[[], proposal_checks.ProposedCommit], str]] = {
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
    "a policy": (
        lambda: proposal({}, {"policies/initial.yaml": "add: []"}, message()),
        "policies/initial.yaml: policies are made by people; account manager may not change them",
    ),
    "what installs the platform": (
        lambda: proposal({}, {"bootstrap/appproject.yaml": "a: 1"}, message()),
        "bootstrap/appproject.yaml: what installs the platform is changed by people",
    ),
    "a workflow": (
        lambda: proposal({}, {".gitea/workflows/x.yaml": "a: 1"}, message()),
        ".gitea/workflows/x.yaml: a forge runs what this file says; account manager may not touch it",
    ),
    "a pipeline": (
        lambda: proposal({}, {".gitlab-ci.yml": "a: 1"}, message()),
        ".gitlab-ci.yml: a forge runs what this file says",
    ),
    "evidence of another version in the annotation": (
        lambda: proposal({}, files(replace(BRIDGE, plan=PLAN, evidence=OTHER_SUMMARY)), message()),
        f"robotkube.io/evidence is {OTHER_SUMMARY}, the evidence of chart {REFERENCE} is {SUMMARY}",
    ),
    "no evidence in the annotation": (
        lambda: proposal({}, files(replace(BRIDGE, plan=PLAN, evidence="none")), message()),
        f"robotkube.io/evidence is none, the evidence of chart {REFERENCE} is {SUMMARY}",
    ),
    "other evidence in the trailer": (
        lambda: proposal({}, files(replace(BRIDGE, plan=PLAN)), message(evidence=("none",))),
        f"RobotKube-Evidence of {REFERENCE} is none, releases/cloud-0/bridge.yaml has {SUMMARY}",
    ),
    "values against the schema": (
        lambda: proposal({}, files(replace(BRIDGE, plan=PLAN, values={"bridge": {"out": 1}, "x": 2})), message()),
        "spec.values.bridge.out: 1 is not of type 'array'",
    ),
    "an unknown value": (
        lambda: proposal({}, files(replace(BRIDGE, plan=PLAN, values={"x": 2})), message()),
        "Additional properties are not allowed ('x' was unexpected)",
    ),
    "parameters against the application": (
        lambda: proposal(
            {}, files(replace(BRIDGE, plan=PLAN, causes=(replace(ONE, parameters='{"seconds":"5"}'),))), message(ONE)
        ),
        "task cloud-0/one: parameters.seconds: '5' is not of type 'integer'",
    ),
    "an unknown application": (
        lambda: proposal(
            {}, files(replace(BRIDGE, plan=PLAN, causes=(replace(ONE, application="other"),))), message(ONE)
        ),
        "task cloud-0/one: the catalogue has no application 'other'; it has recording",
    ),
    "a chart named twice": (
        lambda: proposal({}, files(replace(BRIDGE, plan=PLAN)), message(charts=(REFERENCE, REFERENCE))),
        "stands twice; keep one of them",
    ),
    "no trailers": (lambda: proposal({}, files(replace(BRIDGE, plan=PLAN)), "deploy(x): y\n"), "RobotKube-Plan must"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_refusals(case: str) -> None:
    make, expected = REFUSALS[case]
    assert expected in problems(make())


def test_parents_decide_first() -> None:
    good = proposal({}, files(replace(BRIDGE, plan=PLAN)), message())
    assert proposal_checks.judge(good, TIP, RULES).accepted
    assert proposal_checks.judge(good, "b" * 40, RULES).stale
    assert not proposal_checks.judge(replace(good, parents=(TIP, TIP)), TIP, RULES).accepted
    assert not proposal_checks.judge(replace(good, parents=()), TIP, RULES).accepted


def test_a_lower_term_is_refused_before_anything_else() -> None:
    good = proposal({}, files(replace(BRIDGE, plan=PLAN)), message())
    later = replace(RULES, last_term=TERM + 1)
    words = "another process of this manager leads now"
    for tip in (TIP, "b" * 40):
        judgement = proposal_checks.judge(good, tip, later)
        assert (judgement.stale, len(judgement.problems)) == (False, 1)
        assert (
            f"RobotKube-Term: {TERM} is lower than {TERM + 1}, manager's last on main: {words}" in judgement.problems[0]
        )
    assert proposal_checks.judge(good, TIP, replace(RULES, last_term=TERM)).accepted


def test_a_plan_in_the_name_of_another_manager_is_refused() -> None:
    judgement = proposal_checks.judge(
        proposal({}, files(replace(BRIDGE, plan=PLAN)), message(manager="other")), TIP, RULES
    )
    assert judgement.problems == ("RobotKube-Manager: 'other' must be the account that proposes, 'manager'",)


BROKEN = {**files(BRIDGE), "releases/cloud-0/broken.yaml": "a: ["}
REPAIRS = {"releases/cloud-0/broken.yaml": None}
REPAIRING = replace(RULES, repair=REPAIRS)


def repair_message(**changes: Any) -> str:
    return message(**{"kinds": ("repair",), "charts": (), "evidence": (), "reverts": ("c" * 40,), **changes})


def test_while_main_is_broken_only_its_repair_is_taken() -> None:
    new = replace(BRIDGE, name="other", plan=PLAN)
    plan = proposal_checks.judge(proposal(BROKEN, {**BROKEN, **files(new)}, message()), TIP, REPAIRING)
    assert plan.problems == (
        "main is broken (releases/cloud-0/broken.yaml): a plan with RobotKube-Cause: repair comes first",
    )
    judgement = proposal_checks.judge(proposal(BROKEN, files(BRIDGE), repair_message()), TIP, REPAIRING)
    assert (judgement.accepted, judgement.repair) == (True, True)
    more = proposal_checks.judge(proposal(BROKEN, {**files(BRIDGE), **files(new)}, repair_message()), TIP, REPAIRING)
    assert not more.repair
    assert "releases/cloud-0/other.yaml: a repair brings back what main last had" in "\n".join(more.problems)
    other = {**files(BRIDGE), "releases/cloud-0/broken.yaml": "a: 1\n"}
    assert "this is neither" in "\n".join(
        proposal_checks.judge(proposal(BROKEN, other, repair_message()), TIP, REPAIRING).problems
    )


def test_a_repair_in_a_namespace_of_others_is_theirs() -> None:
    broken = {**files(BRIDGE), "releases/edge-0/broken.yaml": "a: ["}
    rules = replace(RULES, repair={"releases/edge-0/broken.yaml": None})
    judgement = proposal_checks.judge(proposal(broken, files(BRIDGE), repair_message()), TIP, rules)
    assert "'edge-0' is not a namespace that account manager may touch" in "\n".join(judgement.problems)


def test_an_irregular_file_is_named() -> None:
    proposed = replace(
        proposal({}, files(replace(BRIDGE, plan=PLAN)), message()), irregular=("releases/cloud-0/x.yaml",)
    )
    assert "releases/cloud-0/x.yaml: not an ordinary text file" in problems(proposed)


def judged(catalogue: Catalogue, release: Release = BRIDGE, **changes: Any) -> str:
    """The problems of a new release under another catalogue."""
    proposed = proposal({}, files(replace(release, plan=PLAN)), message(**changes))
    return "\n".join(proposal_checks.judge(proposed, TIP, replace(RULES, catalogue=catalogue)).problems)


def with_version(**changes: Any) -> Catalogue:
    """The catalogue with another version 0.1.0 of the chart."""
    version = replace(CATALOGUE.charts["bridge"][0], **changes)
    return replace(CATALOGUE, charts={"bridge": (version,)})


def test_a_chart_without_valid_evidence_is_refused_with_the_doubt() -> None:
    problem = "suite install: there is no evidence; a missing suite is not a passed one"
    assert f"no valid evidence: {problem}" in judged(with_version(assured=False, evidence_problem=problem))
    assert "state staged is not allowed (release policy: assurance verified)" in judged(with_version(state="staged"))


def test_without_assurance_evidence_is_none_everywhere() -> None:
    lax = replace(with_version(state="staged", assured=False, evidence=""), assurance="none")
    bare = replace(BRIDGE, evidence="none")
    assert judged(lax, bare, evidence=("none",)) == ""
    assert f"robotkube.io/evidence is {SUMMARY}, the evidence of chart {REFERENCE} is none" in judged(lax)


def test_a_chart_without_a_schema_is_refused_where_evidence_is_asked_for() -> None:
    rules = replace(RULES, schema=lambda chart, version: None)
    proposed = proposal({}, files(replace(BRIDGE, plan=PLAN)), message())
    assert "has no charts/bridge/0.1.0.schema.json to check the values by; submit the chart again" in "\n".join(
        proposal_checks.judge(proposed, TIP, rules).problems
    )


def test_values_are_laid_on_the_charts_own_as_helm_does() -> None:
    base = {"a": {"b": 1, "c": 2}, "d": [1, 2], "e": {"f": 1}}
    over = {"a": {"b": None, "x": 3}, "d": [3], "e": None, "g": {"h": None}}
    assert overlay(base, over) == {"a": {"c": 2, "x": 3}, "d": [3], "g": {"h": None}}


# -- people -----------------------------------------------------------------------------------------------------------


def of_person(before: dict[str, str], after: dict[str, str]) -> str:
    judgement = proposal_checks.judge_person(proposal(before, after, "Correct it\n"), RULES)
    return "\n".join(judgement.problems)


INITIAL = "add:\n- {application: recording, agents: [cloud-0], parameters: {seconds: 3}}\nremove: []\n"
PEOPLE: dict[str, tuple[dict[str, str], str]] = {
    "a release of an unknown chart": (
        files(replace(BRIDGE, chart="other")),
        "is not in the catalogue, which has no version of it",
    ),
    "wrong values": (files(replace(BRIDGE, values={"x": 1})), "'x' was unexpected"),
    "an unreadable policy": ({"policies/other.yaml": "a: ["}, "policies/other.yaml: not readable as YAML"),
    "an unknown key": (
        {"policies/initial.yaml": "added: []\n"},
        "policies/initial.yaml: added: unknown key; remove it",
    ),
    "an unknown application": (
        {"policies/initial.yaml": INITIAL.replace("recording", "other")},
        "policies/initial.yaml: add[0].application: the catalogue has no 'other'; it has recording",
    ),
    "wrong parameters": (
        {"policies/initial.yaml": INITIAL.replace("3", "many")},
        "policies/initial.yaml: add[0].parameters.seconds: 'many' is not of type 'integer'",
    ),
    "a wrong merge policy": (
        {"policies/merge.yaml": "automatic: [{author: manager}]\n"},
        "policies/merge.yaml: automatic[0].paths: missing",
    ),
    "nobody's account": (
        {"policies/revoked.yaml": "revoked: [{agent: vehicle-99, reason: stolen}]\n"},
        "policies/revoked.yaml: revoked[0].agent: no agent vehicle-99 is declared; there are: ",
    ),
    "no reason": (
        {"policies/revoked.yaml": "revoked: [{agent: cloud-0}]\n"},
        "policies/revoked.yaml: revoked[0].reason: missing",
    ),
    "nothing": ({}, "the commit changes nothing"),
}


@pytest.mark.parametrize("case", PEOPLE)
def test_what_people_propose_is_checked_in_the_same_way(case: str) -> None:
    after, expected = PEOPLE[case]
    assert expected in of_person({}, after)


def test_people_may_touch_everything_and_need_no_trailers() -> None:
    revoked = "revoked: [{agent: cloud-0, reason: stolen}]"
    policies = {"policies/initial.yaml": INITIAL, "policies/revoked.yaml": revoked}
    after = {**files(BRIDGE), **policies, "README.md": "x", "bootstrap/x.yaml": "a: 1"}
    assert of_person({}, after) == ""


def test_the_merge_policy_cannot_be_removed() -> None:
    assert "must stay; without it the gate merges nothing" in of_person({"policies/merge.yaml": "{}\n"}, {})


def test_where_main_changed_the_same_files_the_branch_is_updated_first_and_still_checked() -> None:
    behind = replace(proposal({}, {"policies/x.yaml": "a: ["}, "x\n"), parents=("b" * 40,))
    assert not proposal_checks.judge_person(behind, RULES).stale
    judgement = proposal_checks.judge_person(replace(behind, overlaps=("policies/x.yaml",)), RULES)
    assert judgement.stale
    assert judgement.problems
    assert not judgement.accepted


HEAD = "c" * 40


def test_the_refusal_is_readable_and_bounded() -> None:
    text = verdict_comments.refusal_text(HEAD, [f"problem\n{n}" for n in range(merge_comments.PROBLEMS_SHOWN_MAX + 3)])
    assert text.startswith("Refused cccccccccccc: the gate does not merge this commit.\n")
    assert "- problem 0\n" in text
    assert text.endswith("- and 3 more\n")


EDITED = {"evidence": "sha256:" + "8" * 64, "evidence_problem": "applications/recording.yaml is not what was verified"}


@pytest.mark.parametrize("policy", ["verified", "transition"])
def test_a_task_of_an_application_that_is_not_what_was_verified_is_refused(policy: str) -> None:
    application = replace(CATALOGUE.applications["recording"], **EDITED)  # type: ignore[arg-type]
    doubted = replace(CATALOGUE, applications={"recording": application}, application_assurance=policy)
    release = replace(BRIDGE, plan=PLAN, causes=(ONE,))
    verdict = proposal_checks.judge(proposal({}, files(release), message(ONE)), TIP, replace(RULES, catalogue=doubted))
    assert verdict.problems == (
        f"{release.path}: task cloud-0/one: application recording: no valid evidence: {EDITED['evidence_problem']} "
        f"(release policy: applications {policy})",
    )
    shown("gate", verdict.problems[0], "application-edited")
    allowed = replace(doubted, application_assurance="none")
    assert proposal_checks.judge(
        proposal({}, files(release), message(ONE)), TIP, replace(RULES, catalogue=allowed)
    ).accepted


def test_an_application_without_evidence_may_run_until_the_policy_asks_for_it() -> None:
    release = replace(BRIDGE, plan=PLAN, causes=(ONE,))
    plan = proposal({}, files(release), message(ONE))
    assert proposal_checks.judge(plan, TIP, RULES).accepted
    strict = replace(RULES, catalogue=replace(CATALOGUE, application_assurance="verified"))
    assert (
        "there is no evidence that it was composed and checked" in proposal_checks.judge(plan, TIP, strict).problems[0]
    )
