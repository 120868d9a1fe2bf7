"""Which checks a verdict names, in which order, and what each came to."""

from __future__ import annotations

from dataclasses import replace

from robotkube.delivery.gate.core import check_results, proposal_checks
from tests.delivery.gate.test_proposal_checks import BRIDGE, PLAN, RULES, TIP, files, message, proposal


def test_a_verdict_names_its_checks_in_their_order_and_what_each_took() -> None:
    seconds = iter(range(1000))
    good = proposal({}, files(replace(BRIDGE, plan=PLAN)), message())
    made = proposal_checks.judge(good, TIP, RULES, lambda: float(next(seconds))).checks
    assert [check.name for check in made] == [
        *(check_results.ONE_COMMIT, check_results.AUTHOR, check_results.FILES, check_results.TOGETHER),
        *(check_results.NAMESPACES, check_results.USED, check_results.CHART, check_results.VALUES),
        *(check_results.TOPICS, check_results.PARAMETERS, check_results.IMAGES, check_results.ORIGIN),
        check_results.MESSAGE,
    ]
    assert {check.problems for check in made} == {()}
    assert {check.seconds for check in made} == {1.0}


def test_a_check_of_several_files_is_one_and_what_was_not_tried_is_none() -> None:
    two = [replace(BRIDGE, plan=PLAN), replace(BRIDGE, name="second", plan=PLAN, digest="sha256:" + "3" * 64)]
    refused = proposal_checks.judge(proposal({}, files(*two), message()), TIP, RULES)
    found = {check.name: check.problems for check in refused.checks}
    assert len(found[check_results.CHART]) == 1
    assert set(found[check_results.CHART]) < set(refused.problems)
    assert found[check_results.VALUES] == (), "tried of the first release alone"
    stale = proposal_checks.judge(proposal({}, files(two[0]), message()), "b" * 40, RULES)
    assert {check.name: check.problems for check in stale.checks} == {
        check_results.ONE_COMMIT: (check_results.MOVED,),
        check_results.AUTHOR: (),
    }
    assert stale.problems == (), "it is no mistake of its author's"


def test_checks_of_what_people_propose_are_named_too() -> None:
    made = proposal_checks.judge_person(proposal({}, {"policies/updates.yaml": "a: [\n"}, "x\n"), RULES).checks
    [failed] = [check for check in made if check.problems]
    assert failed.name == check_results.POLICIES
    assert check_results.MESSAGE not in [check.name for check in made]
