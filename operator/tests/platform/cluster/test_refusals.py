"""What reaches main past manager and gate is refused by the API server: Argo CD is not even told of it, the others go
on, and what nobody asked for is taken away again. What the gate refuses of the manager's: delivery/gate/test_gate.py;
what Argo CD refuses where there is no admission: test_refusals_without_admission.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from robotkube.errors import InputError
from robotkube.registry.charts.adapters.oci import OciRegistry
from tests.stages.attacks import words_of
from tests.stages.platform.running_platform import Platform, Writer, asleep, eventually
from tests.stages.platform.unchecked_releases import (
    AGENT,
    NAMES,
    REFUSED_SECONDS_MAX,
    application,
    bring_to_main,
    files,
    push_chart,
    reached_nothing,
)

REFUSAL = words_of("main-moved-past-the-gate", "admission")
GENERATOR_LOG = ("-n", "argocd", "logs", "deployment/argocd-applicationset-controller", "--tail=4000")


@pytest.fixture(scope="module")
def manager_asleep(platform: Platform) -> Iterator[None]:
    """The manager does not run, since it would take away at once what nobody asked for."""
    eventually("all Applications synced and healthy", platform.settled)
    with asleep(platform, "manager"):
        yield


@pytest.fixture(scope="module")
def refused(platform: Platform, manager_asleep: None, tmp_path_factory: pytest.TempPathFactory) -> Writer:
    """Three releases on main that the gate has not seen."""
    return bring_to_main(platform, tmp_path_factory.mktemp("releases"))


@pytest.mark.parametrize("name", NAMES)
def test_argo_cd_is_not_told_of_a_chart_that_nobody_verified(platform: Platform, refused: Writer, name: str) -> None:
    """Its generator is refused the Application, and says so for each."""
    begin = f"Application {AGENT}-{name} is of "

    def said() -> list[str]:
        lines = platform.kubectl(*GENERATOR_LOG).splitlines()
        return [line[line.index(begin) :] for line in lines if begin in line]

    refusal = eventually(f"{name} is refused", said, REFUSED_SECONDS_MAX)
    assert REFUSAL.pattern.search(refusal[-1])
    assert application(platform, name) == {}
    assert reached_nothing(platform)


def test_the_application_set_says_what_is_refused(platform: Platform, refused: Writer) -> None:
    """What a person sees who asks why a release does not come: the first one by name."""

    def said() -> str:
        status = platform.get("-n", "argocd", "applicationset", "releases").get("status", {})
        errors = [one for one in status.get("conditions", []) if one["type"] == "ErrorOccurred"]
        return "".join(error["message"] for error in errors if error["status"] == "True")

    message = eventually("the ApplicationSet has an error", said, REFUSED_SECONDS_MAX)
    assert f"Application {AGENT}-everything is of " in message


def test_what_the_gate_refuses_is_merged_by_nobody(platform: Platform, refused: Writer, tmp_path: Path) -> None:
    """A staged chart, and in the same commit the policy that edits by hand are respected: approved, and not merged."""
    digest = push_chart(platform, tmp_path / "staged", "staged", "staging")
    name, approver = platform.scenario.story.person, platform.scenario.story.approver
    person = platform.writer(name, tmp_path / "person")
    changes = {**files("staged", "staged", digest), "policies/edits.yaml": "edits: respect\n"}
    commit = person.commit(changes, "test: a staged chart\n")
    number = person.proposals.propose(commit, "staged-by-a-person", "a staged chart", "a test")
    with platform.forge(name) as forge, platform.forge(approver) as other:
        review = {"event": "APPROVED", "commit_id": commit, "body": "seen"}
        other.post(f"/pulls/{number}/reviews", json=review).raise_for_status()

        def said() -> bool:
            return "it cannot be merged." in str(forge.get(f"/issues/{number}/comments").json())

        eventually("the gate has refused it", said)
        for account in (forge, other):
            for style in ("fast-forward-only", "rebase", "merge"):
                assert account.post(f"/pulls/{number}/merge", json={"Do": style}).status_code == 405
        assert not forge.get(f"/pulls/{number}").json()["merged"]
        forge.patch(f"/pulls/{number}", json={"state": "closed"}).raise_for_status()
    assert platform.kubectl("-n", AGENT, "get", "configmap", "staged", "--ignore-not-found") == ""
    with (
        OciRegistry(platform.forge_url(), "argocd", platform.password("argocd")) as registry,
        pytest.raises(InputError),
    ):
        registry.manifest_digest("staging/staged", digest)


def test_the_other_releases_go_on(platform: Platform, refused: Writer) -> None:
    assert platform.available(AGENT, "mqtt-bridge")


def test_the_manager_takes_away_what_nobody_asked_for(platform: Platform, refused: Writer) -> None:
    """By a pull request, as everything it does, but for the one that is no valid release: it leaves files alone that it
    cannot read. The fixtures wake it again afterwards; it may be woken twice."""
    path = f"releases/{AGENT}/foreign.yaml"
    source = next(path for path in refused.clone.files(refused.clone.fetch(), ("sources",)) if "elsewhere" in path)
    refused.push({path: None, source: None}, "test: take the foreign release away\n")
    platform.kubectl("-n", "robotkube", "scale", "deployment/manager", "--replicas=1")

    def clean() -> bool:
        left = [name for name in refused.clone.files(refused.clone.fetch(), ("releases",)) if AGENT in name]
        return not any(name.endswith(("everything.yaml", "unknown.yaml")) for name in left)

    eventually("main is as the catalogue and the tasks want it", clean, REFUSED_SECONDS_MAX)
    message = refused.clone.log(None, 1)[0].message
    assert message.startswith("deploy(initial)")
    eventually("all Applications synced and healthy", platform.settled)
    assert not any(application(platform, name) for name in NAMES)
