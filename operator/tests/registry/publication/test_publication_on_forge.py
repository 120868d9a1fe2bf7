"""Publication on a real forge: real Git, registry and keys; the suites' verdicts are the test's."""

import base64
import secrets
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pygit2
import pytest

from robotkube.cli.registry.submit import CATALOGUE
from robotkube.errors import InputError
from robotkube.foundation.documents.core.digests import sha256
from robotkube.foundation.documents.core.yaml_codec import read_mapping, write_mapping
from robotkube.foundation.forge.ports.pull_requests import PullRequest
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.core.packing import PackedChart, build_tag
from robotkube.registry.evidence.core.statements import Artefact, Check, SuiteResult, suite_statement
from robotkube.registry.evidence.core.verification_policy import PLAIN_SUITES, read_verification_policy
from robotkube.registry.publication.loops.publication import PublicationLoop
from robotkube.registry.publication.loops.submitting import PLANNED, PUBLISHED, REFUSED, UNCHANGED, SubmissionOutcome
from robotkube.registry.suites.core.requests import SuiteProgress
from tests.stages import http_calls
from tests.stages.attacks import shown
from tests.stages.forge.catalogue_evidence import OTHER_SEED, gate_key
from tests.stages.forge.installation import Installation
from tests.stages.registry.publications import WAIT_SECONDS, Publishing, disconnect, look_often
from tests.stages.registry.signed_evidence import POLICY_TEXT
from tests.stages.registry.submissions import IMAGE, application, chart
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

PLACE = "staging-publisher"
SUITES = tuple(rule.name for rule in read_verification_policy(POLICY_TEXT).suites)


class KilledError(BaseException):
    """The process ends here."""


@pytest.fixture(autouse=True)
def _prompt(monkeypatch: pytest.MonkeyPatch) -> None:
    look_often(monkeypatch)


@pytest.fixture
def publishing(installation: Installation, tmp_path: Path) -> Iterator[Publishing]:
    stage = Publishing(installation, tmp_path)
    stage.start()
    yield stage
    stage.stop()


@pytest.fixture
def name() -> str:
    """A chart name nobody had before."""
    return f"chart-{secrets.token_hex(4)}"


def status(publishing: Publishing, chart_name: str, version: str = "0.1.0") -> dict[str, Any]:
    text = publishing.main().get(f"charts/{chart_name}/{version}.yaml")
    return read_mapping(text, "entry")["status"] if text else {}


def registry_of(installation: Installation, account: str) -> OciRegistry:
    return OciRegistry(installation.url, account, installation.passwords[account])


def test_a_persons_change_is_merged_by_the_gate_when_another_person_approved_it(publishing: Publishing) -> None:
    installation = publishing.installation
    person = installation.clone("operator-team", CATALOGUE)
    text = f"{secrets.token_hex(4)}\n"
    commit = person.commit({"README.md": text}, "Better words\n", [person.tip()])
    assert person.push(commit, "refs/for/main", [f"topic=words-{text.strip()}", "title=words"]) == ""
    pulls = f"{installation.url}/api/v1/repos/{CATALOGUE}/pulls"
    own, other = ((name, installation.passwords[name]) for name in ("operator-team", "reviewer"))
    pull_requests = http_calls.get(pulls, auth=own, timeout=30).json()
    number = next(pull["number"] for pull in pull_requests if pull["head"]["sha"] == commit)
    review = {"event": "APPROVED", "commit_id": commit, "body": "seen"}
    assert http_calls.post(f"{pulls}/{number}/reviews", auth=own, json=review, timeout=30).status_code in (403, 422)
    http_calls.post(f"{pulls}/{number}/reviews", auth=other, json=review, timeout=30).raise_for_status()
    publishing.say("pull request")  # as the forge's webhook does
    until(lambda: http_calls.get(f"{pulls}/{number}", auth=own, timeout=30).json()["merged"], "merged")
    newest = person.repository[person.tip()].peel(pygit2.Commit)
    assert str(newest.parent_ids[1]) == commit
    assert newest.message.endswith(f"RobotKube-Pull-Request: {number}\nRobotKube-Approved-By: reviewer\n")
    assert publishing.main()["README.md"] == text


def test_a_submission_is_published_and_the_pull_request_merged(publishing: Publishing, name: str) -> None:
    packed, spec = chart(name)
    applications = {f"applications/use-{name}.yaml": application(f"use-{name}", name)}
    outcome = publishing.submit((packed, spec), applications=applications)
    assert outcome.verdict == PUBLISHED, outcome.text
    assert f"## Verified: {name} 0.1.0, application use-{name}" in outcome.text
    assert any(f"{name} 0.1.0: static 1  passed" in line for line in publishing.lines)
    pull = publishing.installation.client("gate").get(f"../catalogue/pulls/{outcome.number}").json()
    assert (pull["state"], pull["merged"], pull["merged_by"]["login"]) == ("closed", True, "gate")
    assert status(publishing, name)["state"] == "verified"
    assert set(outcome.evidence) == {
        f"evidence/{name}/0.1.0_{packed.digest[7:19]}/{one}.json" for one in (*SUITES, "summary")
    }
    assert f"applications/use-{name}.yaml" in publishing.main()
    with registry_of(publishing.installation, "manager") as registry:
        attached = registry.attachments(f"verified/{name}", packed.digest)
        assert {sha256(one.data) for one in attached} == {sha256(text.encode()) for text in outcome.evidence.values()}
        assert registry.manifest_digest(f"verified/{name}", f"0.1.0_{packed.digest[7:19]}") == packed.digest
    again = publishing.submit((packed, spec), applications=applications)
    assert (again.verdict, again.unchanged, again.evidence) == (UNCHANGED, (f"{name} 0.1.0",), outcome.evidence)


def test_a_submission_that_waits_is_withdrawn_and_approved_by_the_forges_api(publishing: Publishing, name: str) -> None:
    """As docs/how-to/add-an-application.md and write-a-policy.md say."""
    installation = publishing.installation
    pulls = f"{installation.url}/api/v1/repos/{CATALOGUE}/pulls"
    publisher, person = ((account, installation.passwords[account]) for account in ("publisher", "reviewer"))
    path = f"applications/use-{name}.yaml"
    applications = {path: application(f"use-{name}", name, initialFor="cloud")}

    def withdraw(pull: PullRequest) -> None:
        until(
            lambda: (
                "## Waiting"
                in publishing.installation.client("gate").get(f"../catalogue/issues/{pull.number}/comments").text
            )
        )
        closed = {"state": "closed"}
        http_calls.patch(f"{pulls}/{pull.number}", auth=publisher, json=closed, timeout=30).raise_for_status()

    def approve(pull: PullRequest) -> None:
        review = {"event": "APPROVED", "commit_id": pull.head, "body": "Seen"}
        http_calls.post(f"{pulls}/{pull.number}/reviews", auth=person, json=review, timeout=30).raise_for_status()

    first = publishing.submit(chart(name), applications=applications, opened=withdraw)
    assert (first.verdict, path in publishing.main()) == (REFUSED, False)
    assert f"{path} runs by itself on every agent of role cloud (initialFor)" in first.text
    second = publishing.submit(chart(name), applications=applications, opened=approve)
    assert (second.verdict, path in publishing.main()) == (PUBLISHED, True)
    assert second.number != first.number


def test_a_dry_run_writes_nothing(publishing: Publishing, name: str) -> None:
    packed, spec = chart(name)
    assert publishing.submit((packed, spec), dry_run=True).verdict == PLANNED
    with registry_of(publishing.installation, "gate") as registry:
        assert registry.list(f"staging/{name}") == ()


@pytest.mark.parametrize("suite", [SUITES[0], *(pytest.param(one, marks=pytest.mark.thorough) for one in SUITES[1:])])
def test_a_failed_suite_refuses(publishing: Publishing, name: str, suite: str) -> None:
    publishing.runner.checks[suite] = (Check("what it looks at", False, "this was found", "do that"),)
    packed, spec = chart(name)
    outcome = publishing.submit((packed, spec))
    assert outcome.verdict == REFUSED
    for part in (f"{suite} of {name} failed", "- what it looks at", "found: `this was found`", "do: do that"):
        assert part in outcome.text
    assert status(publishing, name) == {}
    with registry_of(publishing.installation, "gate") as registry:
        assert registry.list(f"verified/{name}") == ()
        run = [one for one in SUITES if one in PLAIN_SUITES or suite not in PLAIN_SUITES]
        assert len(registry.attachments(f"staging/{name}", packed.digest)) == len(run)
    publishing.runner.checks.clear()
    assert publishing.submit((packed, spec)).verdict == PUBLISHED
    assert publishing.runner.runs.count((name, suite)) == 2
    assert len(publishing.runner.runs) == len(SUITES) + 1


def test_kept_evidence_spares_the_suites(publishing: Publishing, name: str) -> None:
    """As after a new cluster with the same key: nothing is attached there, the submission brings what was kept."""
    packed, spec = chart(name)
    first = publishing.submit((packed, spec))
    assert first.verdict == PUBLISHED
    forget(publishing.installation, name, packed.digest)
    publishing.runner.runs.clear()
    second = publishing.submit((packed, spec), kept=first.evidence)
    assert second.verdict == PUBLISHED, second.text
    assert publishing.runner.runs == []
    assert second.evidence == first.evidence
    assert second.text.count("kept result") == len(SUITES)


def forget(installation: Installation, name: str, digest: str) -> None:
    """Take the chart out of catalogue and registry, as a new installation begins."""
    clone = installation.clone("gate", CATALOGUE)
    tip = clone.tip()
    tag = f"0.1.0_{digest[7:19]}"
    files = [f"charts/{name}/0.1.0.yaml", f"charts/{name}/0.1.0.schema.json"]
    files += [f"evidence/{name}/{tag}/{one}.json" for one in (*SUITES, "summary")]
    assert clone.push(clone.commit(dict.fromkeys(files), "forget\n", [tip]), "refs/heads/main") == ""
    account = ("gate", installation.passwords["gate"])
    for organisation in ("staging", "verified"):
        where = f"{installation.url}/api/v1/packages/{organisation}"
        for version in http_calls.get(where, auth=account, params={"q": name, "limit": 50}).json():
            url = f"{where}/container/{version['name']}/{version['version']}"
            assert http_calls.delete(url, auth=account).status_code in (204, 404)


def test_forged_evidence_is_not_used(publishing: Publishing, name: str) -> None:
    packed, spec = chart(name)
    policy = read_verification_policy(publishing.main()["policies/verification.yaml"])
    artefact = Artefact(name, "0.1.0", packed.digest, "linux/amd64")
    rule = policy.suites[-1]
    result = SuiteResult(rule.name, rule.version, "passed", (Check("installs", True),), 1.0)
    forged = gate_key(OTHER_SEED).sign(suite_statement(artefact, policy.digest, result))
    with registry_of(publishing.installation, "gate") as registry:  # publishers could, before they had places
        registry.push_chart("staging", packed, "by-hand")
        kind = "application/vnd.in-toto+json"
        registry.attach(f"staging/{name}", packed.digest, kind, forged, {"robotkube.io/suite": rule.name})
    publishing.runner.checks[rule.name] = (Check("installs", False, "never ready", "repair the probe"),)
    outcome = publishing.submit((packed, spec), kept={f"{artefact.folder}/{rule.name}.json": forged.decode()})
    assert outcome.verdict == REFUSED
    assert f"{rule.name} of {name} failed" in outcome.text


def test_a_version_is_not_overwritten(publishing: Publishing, name: str) -> None:
    first, second = chart(name), chart(name, text="kind: Secret\n")
    assert publishing.submit(first).verdict == PUBLISHED
    outcome = publishing.submit(second)
    assert outcome.verdict == REFUSED
    assert "a version is never replaced: raise `version` in Chart.yaml" in outcome.text
    assert status(publishing, name)["digest"] == first[0].digest
    publishing.stop()
    publishing.local_builds = True
    publishing.start()
    assert publishing.submit(second).verdict == PUBLISHED
    with registry_of(publishing.installation, "argocd") as registry:
        for packed, _ in (first, second):
            assert registry.manifest_digest(f"verified/{name}", packed.digest) == packed.digest


def overwrite(installation: Installation, name: str, tag: str, packed: PackedChart) -> None:
    """The publisher writes its tag again with another chart, by which Gitea deletes the manifest from before."""
    who = ("publisher", installation.passwords["publisher"])
    with http_calls.client(base_url=f"{installation.url}/v2/{PLACE}/{name}", auth=who, timeout=30) as registry:
        for data in (packed.config, packed.archive):
            assert registry.post("/blobs/uploads/", params={"digest": sha256(data)}, content=data).status_code == 201
        kind = {"Content-Type": "application/vnd.oci.image.manifest.v1+json"}
        assert registry.put(f"/manifests/{tag}", content=packed.manifest, headers=kind).status_code == 201


@pytest.mark.parametrize("when", ["tried", "checked"])
def test_a_publisher_who_writes_a_tag_again_changes_nothing_that_is_tried(
    publishing: Publishing, name: str, when: str
) -> None:
    (packed, spec), (other, _) = chart(name), chart(name, text="kind: Secret\n")
    outcomes: list[SubmissionOutcome] = []
    publishing.runner.progress[SUITES[-1]] = SuiteProgress("running")
    if when == "checked":
        publishing.stop()
    thread = threading.Thread(target=lambda: outcomes.append(publishing.submit((packed, spec))))
    thread.start()
    until(lambda: any(line.startswith("pull request") for line in publishing.lines), "open")
    if when == "tried":
        until(lambda: bool(publishing.runner.requests), "its suites run")
    overwrite(publishing.installation, name, build_tag("0.1.0", packed.digest), other)
    with registry_of(publishing.installation, "gate") as registry:
        assert registry.manifest_digest(f"{PLACE}/{name}", packed.digest) is None
    publishing.runner.progress.clear()
    if when == "checked":
        publishing.start()
    thread.join(2 * WAIT_SECONDS)
    assert outcomes[0].verdict == (PUBLISHED if when == "tried" else REFUSED), outcomes[0].text
    if when == "checked":
        assert f"{PLACE}/{name} has no digest {packed.digest}; submit it again" in outcomes[0].text
        shown("gate", outcomes[0].text, "staged-tag-overwritten")
    else:
        with registry_of(publishing.installation, "argocd") as registry:
            assert registry.pull_chart(f"verified/{name}", packed.digest).digest == packed.digest


def test_two_submissions_at_once_are_both_published(publishing: Publishing) -> None:
    names = [f"chart-{secrets.token_hex(4)}" for _ in range(2)]
    outcomes: dict[str, SubmissionOutcome] = {}

    def submit(one: str) -> None:
        outcomes[one] = publishing.submit(chart(one))

    threads = [threading.Thread(target=submit, args=(one,)) for one in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(2 * WAIT_SECONDS)
    assert {one: outcome.verdict for one, outcome in outcomes.items()} == dict.fromkeys(names, PUBLISHED)
    assert all(status(publishing, one)["state"] == "verified" for one in names)


def test_the_same_submission_twice_is_one_pull_request(publishing: Publishing, name: str) -> None:
    publishing.runner.progress[SUITES[-1]] = SuiteProgress("running")
    packed, spec = chart(name)
    outcomes: list[SubmissionOutcome] = []
    first = threading.Thread(target=lambda: outcomes.append(publishing.submit((packed, spec))))
    first.start()
    until(lambda: any("pull request" in line for line in publishing.lines), "the first is open")
    second = threading.Thread(target=lambda: outcomes.append(publishing.submit((packed, spec))))
    second.start()
    until(lambda: sum("pull request" in line for line in publishing.lines) == 2, "the second follows it")
    publishing.runner.progress.clear()
    for thread in (first, second):
        thread.join(2 * WAIT_SECONDS)
    assert [outcome.verdict for outcome in outcomes] == [PUBLISHED, PUBLISHED]
    assert outcomes[0].number == outcomes[1].number


def test_the_publisher_can_only_propose(publishing: Publishing, name: str) -> None:
    installation = publishing.installation
    packed, _ = chart(name)
    with (
        registry_of(installation, "publisher") as registry,
        pytest.raises(InputError, match="account publisher may not do this"),
    ):
        registry.push_chart("verified", packed, "0.1.0")
    clone = installation.clone("publisher", CATALOGUE)
    tip = clone.tip()
    commit = clone.commit({"policies/release.yaml": "assurance: none\n"}, "mine\n", [tip])
    assert clone.push(commit, "refs/heads/main") != ""
    assert clone.push(commit, "refs/for/main", [f"topic=by-hand-{name}", "title=mine"]) == ""
    assert "policies/release.yaml: a publisher may only touch" in closing_comment(installation, commit)
    assert publishing.main()["policies/release.yaml"] == "assurance: verified\n"


def closing_comment(installation: Installation, head: str) -> str:
    """The gate's comment once it has closed the pull request."""
    base = f"{installation.url}/api/v1/repos/{CATALOGUE}"
    with http_calls.client(base_url=base, auth=("gate", installation.passwords["gate"]), timeout=30) as client:
        closed = client.get("/pulls", params={"state": "all", "sort": "recentupdate", "limit": 20}).json()
        number = next(item["number"] for item in closed if item["head"]["sha"] == head)
        until(lambda: client.get(f"/pulls/{number}").json()["state"] == "closed", "closed by the gate")
        assert client.get(f"/pulls/{number}").json()["merged"] is False
        return "\n".join(item["body"] for item in client.get(f"/issues/{number}/comments").json())


def test_an_entry_that_calls_itself_verified_is_refused(publishing: Publishing, name: str) -> None:
    installation = publishing.installation
    packed, spec = chart(name)
    clone = installation.clone("publisher", CATALOGUE)
    text = write_mapping(
        {
            "apiVersion": "registry.robotkube.io/v1alpha1",
            "kind": "ChartVersion",
            "metadata": {"name": name},
            "spec": spec,
            "status": {"state": "verified", "digest": packed.digest, "images": [IMAGE]},
        }
    )
    commit = clone.commit({f"charts/{name}/0.1.0.yaml": text}, "mine\n", [clone.tip()])
    assert clone.push(commit, "refs/for/main", [f"topic=verified-{name}", "title=mine"]) == ""
    assert "must be 'staged'; only the gate calls a version verified" in closing_comment(installation, commit)


@pytest.mark.thorough
@pytest.mark.parametrize("point", ["sign", "attach 1", "attach 2", "attach 4", "copy_chart 1", "push_main 1"])
def test_a_gate_killed_anywhere_is_finished_by_the_next(
    installation: Installation, tmp_path: Path, name: str, point: str
) -> None:
    publishing = Publishing(installation, tmp_path)
    packed, spec = chart(name)
    outcomes: list[SubmissionOutcome] = []
    submission = threading.Thread(target=lambda: outcomes.append(publishing.submit((packed, spec))))
    submission.start()
    until(lambda: any("pull request" in line for line in publishing.lines), "the submission is open")
    doomed = publishing.make()
    kill_at(doomed, point)
    with pytest.raises(KilledError):
        rounds(doomed)
    disconnect(doomed)
    publishing.registry.disconnect()
    assert status(publishing, name) == {}
    publishing.start()
    try:
        submission.join(2 * WAIT_SECONDS)
    finally:
        publishing.stop()
    assert [outcome.verdict for outcome in outcomes] == [PUBLISHED]
    with registry_of(installation, "manager") as registry:
        attached = {sha256(attachment.data) for attachment in registry.attachments(f"verified/{name}", packed.digest)}
    assert {sha256(text.encode()) for text in outcomes[0].evidence.values()} <= attached


def rounds(publication: PublicationLoop) -> None:
    for _ in range(20):
        publication.round()


class _Killing:
    """Everything of `inner`, but the process ends before the given call of one method."""

    def __init__(self, inner: Any, method: str, call: int) -> None:
        self._inner, self._method, self._left = inner, method, call

    def __getattr__(self, name: str) -> Any:
        if name == self._method:
            self._left -= 1
            if self._left <= 0:
                raise KilledError
        return getattr(self._inner, name)


def kill_at(publication: PublicationLoop, point: str) -> None:
    method, _, call = point.partition(" ")
    verifying = publication._verifying
    if method == "sign":
        verifying._signer = _Killing(verifying._signer, "sign", 1)
    elif method == "push_main":
        publication._main = _Killing(publication._main, "push_main", int(call))
    else:
        verifying._oci_registry = _Killing(verifying._oci_registry, method, int(call))


def test_the_public_key_is_in_the_catalogue(publishing: Publishing) -> None:
    path = f"keys/{gate_key().key_id}.pem"
    until(lambda: path in publishing.main(), "the key is published")
    assert publishing.main()[path] == gate_key().public_key


def test_a_comment_of_somebody_else_is_not_taken_for_the_gates(publishing: Publishing, name: str) -> None:
    """The gate edits its own comment only, and a publisher's look-alike is not believed by the command."""
    publishing.runner.progress[SUITES[-1]] = SuiteProgress("running")
    installation = publishing.installation
    outcomes = []
    thread = threading.Thread(target=lambda: outcomes.append(publishing.submit(chart(name))))
    thread.start()
    until(lambda: any(line.startswith("pull request") for line in publishing.lines), "open")
    url = next(line for line in publishing.lines if line.startswith("pull request"))
    number = int(url.rpartition("/")[2])
    where = f"{installation.url}/api/v1/repos/{CATALOGUE}/issues/{number}/comments"
    token = base64.b64encode(f"publisher:{installation.passwords['publisher']}".encode()).decode()
    body = {"body": "<!-- robotkube: publication -->\n## Verified: everything\n"}
    assert http_calls.post(where, json=body, headers={"Authorization": f"Basic {token}"}).status_code == 201
    publishing.runner.progress.clear()
    thread.join(2 * WAIT_SECONDS)
    assert outcomes[0].verdict == PUBLISHED
    assert "everything" not in outcomes[0].text
