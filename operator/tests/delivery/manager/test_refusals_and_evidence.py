"""What the manager says and does when something is refused, and which evidence its commits name."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from robotkube.delivery.deployment.core.commit_messages import read_message
from robotkube.delivery.gate.core.verdict_comments import refusal_text
from robotkube.delivery.manager.loops import planner
from robotkube.delivery.manager.loops.proposals.refused_plans import FORGE_REFUSAL_SECONDS
from robotkube.delivery.manager.loops.reconciler import CATALOGUE, DEPLOYMENT
from robotkube.errors import InputError, RefusalError
from robotkube.registry.catalogue.core.catalogue import read_catalogue
from robotkube.testing.clusters import MemoryTasks
from tests.stages.delivery.manager.manager_in_memory import MEETING, Stage


def test_a_refused_plan_is_reported_and_not_repeated_until_its_inputs_change(stage: Stage) -> None:
    stage.forge.decide = lambda pull: stage.forge.refuse(pull, "the chart is not in the catalogue")
    stage.ask()
    stage.go(20)
    assert len(stage.forge.pulls) == 2
    assert stage.tasks.condition(MEETING, "Committed") == ("False", "ProposalRefused")
    committed = stage.tasks.objects[MEETING]["status"]["conditions"][1]
    assert committed["message"] == "the chart is not in the catalogue"
    stage.forge.decide = stage.forge.merge
    stage.go(20)
    assert len(stage.forge.pulls) == 2
    stage.tasks.objects[MEETING]["metadata"]["generation"] = 2
    stage.go(4)
    assert stage.tasks.condition(MEETING, "Committed") == ("True", "Merged")


def test_one_refused_task_does_not_hold_the_others(stage: Stage) -> None:
    def judge(pull: Any) -> None:
        bad = "vehicle-02" in stage.repository.trees[pull.head].get(
            "releases/cloud-0/recorder-vehicle-00-vehicle-02.yaml", ""
        )
        stage.forge.refuse(pull, "no") if bad else stage.forge.merge(pull)

    stage.forge.decide = judge
    bad = stage.ask("bad", ("vehicle-00", "vehicle-02"))
    good = stage.ask("good", ("vehicle-00", "vehicle-01"))
    stage.go(12)
    assert stage.tasks.condition(good, "Committed") == ("True", "Merged")
    assert stage.tasks.condition(bad, "Committed") == ("False", "ProposalRefused")
    pulls = len(stage.forge.pulls)
    stage.go(20)
    assert len(stage.forge.pulls) == pulls


def test_a_refused_withdrawal_is_not_repeated(stage: Stage) -> None:
    stage.ask()
    stage.settle()
    stage.forge.decide = lambda pull: stage.forge.refuse(pull, "no")
    stage.tasks.delete(MEETING)
    stage.go(20)
    assert len(stage.forge.pulls) == 3


def test_what_the_gate_refuses_is_in_the_status_and_reported_once(stage: Stage) -> None:
    text = refusal_text("c" * 40, ["releases/cloud-0/x.yaml: no"])
    stage.forge.decide = lambda pull: stage.forge.refuse(pull, text)
    key = stage.ask()
    stage.go(20)
    assert stage.tasks.reports == [(key, "ProposalRefused", text.strip())]
    stage.manager = stage.start()
    stage.go(20)
    assert stage.tasks.reports == [(key, "ProposalRefused", text.strip())]


def test_an_event_that_is_refused_holds_nothing(stage: Stage) -> None:
    def refuse(task: Any, reason: str, text: str) -> None:
        raise InputError("events are forbidden")

    stage.tasks.report_on_task = refuse  # type: ignore[method-assign]
    stage.forge.decide = lambda pull: stage.forge.refuse(pull, "no")
    key = stage.ask()
    stage.go(8)
    assert stage.tasks.condition(key, "Committed") == ("False", "ProposalRefused")


def test_a_proposal_that_the_forge_itself_refuses_is_reported(stage: Stage) -> None:
    def refuse(commit: str, topic: str, title: str, body: str) -> int | None:
        raise RefusalError("ProposalRefused", "the forge refused proposal: you may not")

    stage.forge.propose = refuse  # type: ignore[method-assign]
    key = stage.ask()
    stage.go(8)
    assert stage.tasks.condition(key, "Committed") == ("False", "ProposalRefused")
    assert stage.tasks.reports == [(key, "ProposalRefused", "the forge refused proposal: you may not")]


@pytest.mark.parametrize("repairs", [False, True])
def test_what_the_forge_itself_refused_is_proposed_again_after_a_while(stage: Stage, repairs: bool) -> None:
    """A right that came back changes nothing that the manager reads."""
    proposed: list[str] = []
    propose = stage.forge.propose

    def refuse(commit: str, topic: str, title: str, body: str) -> int | None:
        proposed.append(topic)
        raise RefusalError("ProposalRefused", "the forge refused proposal: you may not")

    stage.go()
    stage.forge.propose = refuse  # type: ignore[method-assign]
    if repairs:
        stage.repository.push({"releases/cloud-0/broken.yaml": "{"}, "by hand")
    else:
        stage.ask()
    stage.go(20, seconds=5.0, wake=DEPLOYMENT)
    assert len(proposed) == 1, "it is said at once, and not repeated"
    stage.seconds += FORGE_REFUSAL_SECONDS
    stage.go(20, wake=DEPLOYMENT)
    assert len(proposed) == 2
    stage.forge.propose = propose  # type: ignore[method-assign]
    stage.seconds += FORGE_REFUSAL_SECONDS
    stage.go(8, wake=DEPLOYMENT)
    if repairs:
        assert "releases/cloud-0/broken.yaml" not in stage.repository.trees[stage.repository.tip]
    else:
        assert stage.tasks.condition(MEETING, "Committed") == ("True", "Merged")


def edit(stage: Stage, path: str, **status: Any) -> None:
    """What somebody who may write the catalogue repository does by hand."""
    document = yaml.safe_load(stage.catalogue.trees[stage.catalogue.tip][path])
    document["status"] |= status
    stage.catalogue.push({path: yaml.safe_dump(document)})


DETECTOR = "charts/event-detector/0.2.3.yaml"


def test_every_commit_names_the_evidence_of_its_charts(stage: Stage) -> None:
    key = stage.ask()
    stage.go()
    message = read_message(stage.repository.commits[stage.repository.tip].message)
    catalogue = read_catalogue(stage.catalogue.trees[stage.catalogue.tip])
    assert [chart.name for chart in message.charts] == ["event-detector", "mqtt-bridge"]
    assert list(message.evidence) == [catalogue.charts[chart.name][-1].evidence for chart in message.charts]
    release = stage.releases()["releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml"]
    assert release.evidence == message.evidence[0]
    assert release.causes[0].parameters == '{"vehicles":["vehicle-00","vehicle-01"]}'
    body = stage.forge.bodies[2]
    assert "Assurance of the release policy: **verified**." in body
    assert "- event-detector 0.2.3: passed static, images, install under policy" in body
    assert "  - guarantees: stop-time at most 10 s (declared)" in body
    assert f"summary `{message.evidence[0]}`" in body
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")


def test_an_entry_edited_to_verified_without_evidence_is_no_verified_version(stage: Stage) -> None:
    files = stage.catalogue.trees[stage.catalogue.tip]
    stage.catalogue.push({path: None for path in files if path.startswith("evidence/event-detector/")})
    edit(stage, DETECTOR, digest="sha256:" + "f" * 64)
    key = stage.ask()
    stage.go(wake=CATALOGUE)
    assert stage.tasks.condition(key, "Accepted") == ("False", "NoVerifiedVersion")
    message = stage.tasks.objects[key]["status"]["conditions"][0]["message"]
    assert "event-detector 0.2.3 (verified): no valid evidence: suite static: there is no evidence" in message
    assert stage.tasks.reports == [(key, "NoVerifiedVersion", message)]


def test_a_guarantee_that_must_be_verified_is_not_met_yet(stage: Stage) -> None:
    path = "applications/pose-point-cloud-recording.yaml"
    application = yaml.safe_load(stage.catalogue.trees[stage.catalogue.tip][path])
    wanted = {"guarantee": "stop-time", "atMost": 10, "unit": "s", "verified": True}
    application["spec"]["services"][0]["chart"]["requirements"] = [wanted]
    stage.catalogue.push({path: yaml.safe_dump(application)})
    key = stage.ask()
    stage.go(wake=CATALOGUE)
    assert stage.tasks.condition(key, "Accepted") == ("False", "GuaranteeNotMet")
    message = stage.tasks.objects[key]["status"]["conditions"][0]["message"]
    assert "stop-time at most 10 s (declared)" in message
    assert stage.tasks.reports == [(key, "GuaranteeNotMet", message)]
    del wanted["verified"]
    stage.catalogue.push({path: yaml.safe_dump(application)})
    stage.go(wake=CATALOGUE)
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")


def test_what_runs_stays_when_its_evidence_is_not_accepted(stage: Stage) -> None:
    key = stage.ask()
    stage.settle()
    before = stage.releases()
    files = stage.catalogue.trees[stage.catalogue.tip]
    stage.catalogue.push({path: None for path in files if path.startswith("evidence/")})
    stage.go(20, wake=CATALOGUE)
    assert stage.tasks.condition(key, "Accepted") == ("False", "NoVerifiedVersion")
    assert stage.releases() == before
    stage.tasks.delete(key)
    stage.go(20)
    assert "releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml" not in stage.releases()


def test_without_assurance_the_evidence_is_none(stage: Stage) -> None:
    stage.catalogue.push({"policies/release.yaml": "assurance: none\n"})
    stage.ask()
    stage.go(wake=CATALOGUE)
    message = read_message(stage.repository.commits[stage.repository.tip].message)
    assert set(message.evidence) == {"none"}
    assert {release.evidence for release in stage.releases().values()} == {"none"}
    assert "- event-detector 0.2.3: none" in stage.forge.bodies[2]


@pytest.mark.parametrize(
    ("spec", "reason", "text"),
    [
        ({"application": "nothing"}, "UnknownApplication", "the catalogue has no application 'nothing'"),
        ({"parameters": {"vehicles": []}}, "InvalidParameters", "parameters.vehicles"),
        ({"event": {"rule": "a b", "id": "1", "trace": "t"}}, "InvalidParameters", "spec.event.rule"),
        ({"parameters": {"vehicles": ["vehicle-44"]}}, "NoCapableNode", "vehicle-44"),
        ({"surprise": 1}, "InvalidParameters", "spec.surprise: unknown key"),
    ],
)
def test_refused_tasks_have_the_reason_in_their_status(
    stage: Stage, spec: dict[str, Any], reason: str, text: str
) -> None:
    key = stage.ask(**spec)
    stage.go()
    assert stage.tasks.condition(key, "Accepted") == ("False", reason)
    assert text in stage.tasks.objects[key]["status"]["conditions"][0]["message"]
    assert len(stage.forge.pulls) == 1


@pytest.mark.parametrize(
    "vehicles", [[], ["vehicle-00", "vehicle-01"]], ids=["values that are not valid", "valid ones"]
)
def test_an_error_that_values_caused_before_they_were_checked_is_none(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, vehicles: list[str]
) -> None:
    """Values are composed while they are checked. An error that has another cause is not lost."""
    plain = planner.resolve
    errors = [TypeError("no number")]

    def resolve(wanted: Any, *arguments: Any) -> Any:
        resolution = plain(wanted, *arguments)
        if errors and any(demand.task for demand in wanted):
            raise errors.pop()
        return resolution

    monkeypatch.setattr(planner, "resolve", resolve)
    key = stage.ask(parameters={"vehicles": vehicles})
    if vehicles:
        with pytest.raises(TypeError, match="no number"):
            stage.go()
    else:
        stage.go()
        assert stage.tasks.condition(key, "Accepted") == ("False", "InvalidParameters")
    assert errors == []


def test_a_refused_task_is_accepted_when_its_inputs_change(stage: Stage) -> None:
    cloud = stage.cluster.machines.pop()
    key = stage.ask()
    stage.go()
    assert stage.tasks.condition(key, "Accepted") == ("False", "NoCapableNode")
    stage.cluster.machines.append(cloud)
    stage.go()
    assert stage.tasks.condition(key, "Accepted") == ("True", "Accepted")


def test_a_task_that_was_made_anew_under_its_old_name_gets_its_own_status_and_chance(stage: Stage) -> None:
    stage.forge.decide = lambda pull: stage.forge.refuse(pull, "no")
    key = stage.ask()
    stage.go(6)
    assert stage.tasks.condition(key, "Committed") == ("False", "ProposalRefused")
    stage.forge.decide = stage.forge.merge
    stage.tasks.delete(key)
    stage.ask()
    stage.tasks.objects[key]["metadata"]["uid"] = "another"
    stage.go(6)
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")


def test_a_status_that_is_refused_does_not_hold_the_others(stage: Stage) -> None:
    def refuse(namespace: str, name: str, status: Any) -> bool:
        if name == "bad":
            raise InputError("status.plan: too long")
        return MemoryTasks.patch_status(stage.tasks, namespace, name, status)

    stage.tasks.patch_status = refuse  # type: ignore[method-assign]
    stage.ask("bad", ("vehicle-00", "vehicle-02"))
    good = stage.ask("good")
    stage.settle()
    assert stage.tasks.condition(good, "Ready") == ("True", "Observed")


RECORDING = "applications/pose-point-cloud-recording.yaml"


def test_an_application_edited_after_it_was_signed_is_not_selected(stage: Stage) -> None:
    files = stage.catalogue.trees[stage.catalogue.tip]
    policy = {"policies/release.yaml": "assurance: verified\napplications: verified\n"}
    stage.catalogue.push({**policy, **stage.applications_signed()})
    first = stage.ask("first")
    stage.go(wake=CATALOGUE)
    assert stage.tasks.condition(first, "Committed") == ("True", "Merged")
    before = stage.releases()
    stage.catalogue.push({RECORDING: files[RECORDING].replace("afterSeconds: 2", "afterSeconds: 3")})
    key = stage.ask("second", ("vehicle-00", "vehicle-02"))
    stage.go(wake=CATALOGUE)
    for task in (first, key):
        assert stage.tasks.condition(task, "Accepted") == ("False", "ApplicationNotVerified")
    message = stage.tasks.objects[key]["status"]["conditions"][0]["message"]
    assert f"{RECORDING} is not what was verified" in message
    assert stage.releases() == before


def test_without_its_statement_an_application_is_taken_in_transition_only(stage: Stage) -> None:
    signed = stage.applications_signed()
    statement = "evidence/applications/pose-point-cloud-recording.json"
    policy = {"policies/release.yaml": "assurance: verified\napplications: verified\n"}
    stage.catalogue.push({**policy, **signed, statement: None})
    key = stage.ask()
    stage.go(wake=CATALOGUE)
    assert stage.tasks.condition(key, "Accepted") == ("False", "ApplicationNotVerified")
    stage.catalogue.push({"policies/release.yaml": "assurance: verified\n"})
    stage.go(wake=CATALOGUE)
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")
