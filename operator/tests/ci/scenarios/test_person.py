"""The scenario's person against a real forge and gate: proposes a policy, has it approved, reads the history back."""

import time
from urllib.parse import urlparse

import pytest
import yaml

from scenarios.runner.judging import audit, evidence
from scenarios.runner.platform import proposing
from scenarios.runner.platform.access import Endpoint
from scenarios.runner.platform.deployment import CATALOGUE, REPOSITORY, Deployment, specification_digests
from scenarios.runner.waiting import RunError
from tests.stages.forge.catalogue_evidence import trusted_keys
from tests.stages.forge.installation import CAUSE, DIGESTS, Installation, RunningGate, message, release_files
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

POLICY = "policies/initial.yaml"
TEXT = "add: [{application: bag-player, forRole: vehicle}]\nremove: []\n"


def person(installation: Installation, repository: str = REPOSITORY) -> Deployment:
    address = urlparse(installation.url)
    endpoint = Endpoint(address.hostname or "", address.port or 0)
    names = ("operator-team", "reviewer")
    own, approver = ((name, installation.passwords[name]) for name in names)
    return Deployment(endpoint, *own, repository, approver)


def test_a_change_is_proposed_approved_and_merged_in_one_go(installation: Installation, gate: RunningGate) -> None:
    with person(installation) as deployment:
        before = deployment.fetch()
        number = proposing.change(deployment, POLICY, TEXT, "policy(initial): play", f"run-{time.time_ns()}")
        merged = deployment.pull_request(number)
        assert merged.merged
        tip = deployment.fetch()
        assert tip == merged.commit
        assert yaml.safe_load(deployment.file(POLICY)) == yaml.safe_load(TEXT)
        newest = deployment.commits()[0]
        assert (newest.sha, newest.parents[0], newest.author) == (tip, before, "operator-team")
        assert (newest.subject, newest.paths) == (f"policy(initial): play (#{number})", (POLICY,))
        assert audit.entry(newest, merged).missing == ()
        assert deployment.commits()[-1].parents == ()
        assert deployment.history(tip)[0].commit == tip


def test_it_is_merged_although_main_has_moved(installation: Installation, gate: RunningGate) -> None:
    manager = installation.clone("manager")
    plan = installation.plan()
    with person(installation) as deployment:
        deployment.fetch()
        commit = deployment.propose(POLICY, "add: []\nremove: []\n# moved\n", "policy(initial): stop\n", f"run-{plan}")
        until(lambda: deployment.number_of(commit) is not None, "pull request open")
        number = deployment.number_of(commit)
        assert number
        theirs = manager.commit(release_files(plan, "meanwhile"), message(plan), [manager.tip()])
        other = installation.propose(manager, theirs, plan)
        until(lambda: deployment.pull_request(other).merged, "the manager's merged")
        deployment.approve(number, commit)
        until(lambda: deployment.pull_request(number).merged, "merged")
        assert deployment.fetch() == deployment.pull_request(number).commit != commit
        newest = deployment.commits()[0]
        assert (newest.parents, newest.paths) == ((theirs, commit), (POLICY,))
        assert audit.entry(newest, deployment.pull_request(number)).missing == ()


def test_nothing_is_merged_without_another_person_and_the_gates_words_are_named(
    installation: Installation, gate: RunningGate, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(proposing, "MERGE_SECONDS_MAX", 2.0)
    address = urlparse(installation.url)
    endpoint = Endpoint(address.hostname or "", address.port or 0)
    own = ("operator-team", installation.passwords["operator-team"])
    for approver, words in ((None, "nobody was named who approves it"), (own, "as operator-team: 422")):
        with Deployment(endpoint, *own, approver=approver) as deployment:
            text = f"add: []\nremove: []\n# {time.time_ns()}\n"
            assert words in refusal(deployment, text)
    with person(installation) as deployment:
        assert "other: unknown key; remove it" in refusal(deployment, "other: 1\n")


def refusal(deployment: Deployment, text: str) -> str:
    """Why a change of the policy is not merged."""
    deployment.fetch()
    with pytest.raises(RunError) as caught:
        proposing.change(deployment, POLICY, text, "policy(initial): refused", f"run-{time.time_ns()}")
    return str(caught.value)


def test_a_manager_s_commit_has_its_trailers_paths_and_pull_request(
    installation: Installation, gate: RunningGate
) -> None:
    manager = installation.clone("manager")
    plan = installation.plan()
    commit = manager.commit(release_files(plan, "scenario"), message(plan), [manager.tip()])
    number = installation.propose(manager, commit, plan)
    with person(installation) as deployment:
        until(lambda: deployment.pull_request(number).merged, "merged")
        assert deployment.fetch() == commit
        newest = deployment.commits()[0]
        merged = {request.commit: request for request in deployment.pull_requests() if request.merged}
        assert audit.entry(newest, merged[commit]).missing == ()
        assert newest.trailers["Event"] == (CAUSE.event,)
        assert "releases/cloud-0/scenario.yaml" in newest.paths
        assert "cloud-0/scenario" in specification_digests(deployment.releases())


def test_what_a_release_named_is_found_in_the_catalogue_also_when_it_is_gone_again(installation: Installation) -> None:
    gate = installation.clone("gate")
    plan = installation.plan()
    there = release_files(plan, "passing")
    with person(installation) as deployment, person(installation, CATALOGUE) as catalogue:
        before = deployment.fetch()
        release = next(path for path in there if path.startswith("releases/"))
        for files in ({release: there[release]}, {release: None}):
            commit = gate.commit(files, message(plan), [gate.tip()])
            assert gate.push(commit, "refs/heads/main") == ""
        deployment.fetch()
        assert "cloud-0/passing" not in deployment.releases()
        released = evidence.released(deployment.releases_since(before))
        [mine] = [one for one in released if one.release == "cloud-0/passing"]
        assert (mine.chart, mine.digest) == ("event-detector", DIGESTS["event-detector"])
        catalogue.fetch()
        assert evidence.summaries(catalogue.files("evidence"), trusted_keys().verify)[mine.evidence] == mine.digest


def test_main_cannot_be_pushed_and_a_wrong_password_is_named(installation: Installation) -> None:
    address = urlparse(installation.url)
    endpoint = Endpoint(address.hostname or "", address.port or 0)
    with (
        Deployment(endpoint, "operator-team", "wrong") as deployment,
        pytest.raises(RunError, match="cannot be fetched as operator-team"),
    ):
        deployment.fetch()
