"""Evidence that does not hold, as somebody with write rights could put it into the catalogue: each refused in words."""

import json
from collections.abc import Callable, Iterator

import pytest
import yaml

from robotkube.foundation.documents.core.digests import sha256
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.evidence.core.statements import Artefact
from tests.stages.attacks import shown
from tests.stages.forge.catalogue_evidence import (
    OTHER_SEED,
    artefact,
    published_chart,
    schema_file,
    signing,
    unproved_chart,
)
from tests.stages.forge.installation import (
    ApplicationSetController,
    Installation,
    RunningGate,
    message,
    release_files,
    start_gate,
)
from tests.stages.registry.signed_evidence import POLICY, POLICY_TEXT, entry
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

CHART = "event-detector"


def files_of(about: Artefact, envelopes: dict[str, bytes]) -> dict[str, str]:
    """The catalogue's files of a chart version with these envelopes."""
    files = {f"{about.folder}/{name}.json": data.decode() for name, data in envelopes.items()}
    return {**files, **entry(about, evidence=sha256(envelopes["summary"])), **schema_file(about.chart, about.version)}


def of_another_digest(about: Artefact) -> dict[str, str]:
    other = artefact(about.chart, about.version, "sha256:" + "e" * 64)
    return files_of(about, dict(signing(about).sign(other)))


def of_another_key(about: Artefact) -> dict[str, str]:
    return files_of(about, dict(signing(about, OTHER_SEED).sign(about)))


def with_a_suite_missing(about: Artefact) -> dict[str, str]:
    files = published_chart(about.chart, about.version, about.digest)
    del files[f"{about.folder}/install.json"]
    return files


def edited_after_signing(about: Artefact) -> dict[str, str]:
    files = published_chart(about.chart, about.version, about.digest)
    path = f"{about.folder}/static.json"
    envelope = json.loads(files[path])
    payload = envelope["payload"]
    envelope["payload"] = ("B" if payload[40] == "A" else "A").join([payload[:40], payload[41:]])
    files[path] = json.dumps(envelope, sort_keys=True, separators=(",", ":"))
    return files


def with_another_summary(about: Artefact) -> dict[str, str]:
    own = signing(about)
    envelopes = dict(own.sign(about))
    own.envelopes["static"] = envelopes["images"]
    return files_of(about, {**envelopes, "summary": own.summarise(about)})


def without_any(about: Artefact) -> dict[str, str]:
    return unproved_chart(about.chart, about.version, about.digest)


def only_staged(about: Artefact) -> dict[str, str]:
    return published_chart(about.chart, about.version, about.digest) | entry(about, "staged")


def with_another_entry(about: Artefact) -> dict[str, str]:
    files = published_chart(about.chart, about.version, about.digest)
    path = entry_path(about.version)
    return {**files, path: files[path].replace("description: A chart", "description: The best chart")}


def with_another_schema(about: Artefact) -> dict[str, str]:
    files = published_chart(about.chart, about.version, about.digest)
    return {**files, f"charts/{about.chart}/{about.version}.schema.json": "{}\n"}


WRONG: dict[str, tuple[Callable[[Artefact], dict[str, str]], str]] = {
    "0.10.1": (of_another_digest, "the evidence is about another digest (sha256:" + "e" * 64),
    "0.10.2": (of_another_key, "which is not trusted here (trusted: "),
    "0.10.3": (with_a_suite_missing, "suite install: there is no evidence; a missing suite is not a passed one"),
    "0.10.4": (edited_after_signing, "does not fit: it was changed after signing"),
    "0.10.5": (with_another_summary, "it lists another envelope of suite static"),
    "0.10.6": (without_any, "suite static: there is no evidence; a missing suite is not a passed one"),
    "0.10.8": (with_another_entry, "charts/event-detector/0.10.8.yaml is not what was verified (sha256:"),
    "0.10.9": (with_another_schema, "charts/event-detector/0.10.9.schema.json is not what was verified (sha256:"),
    "0.10.7": (only_staged, "state staged is not allowed (release policy: assurance verified)"),
}


@pytest.fixture(scope="module")
def evidence(installation: Installation) -> Iterator[dict[str, str]]:
    """Every wrong version in the catalogue; version -> the evidence that its entry names."""
    files = {version: dict(make(about(version))) for version, (make, _) in WRONG.items()}
    installation.publish({path: text for texts in files.values() for path, text in texts.items()})
    yield {
        version: yaml.safe_load(texts[entry_path(version)])["status"].get("evidence", "none")
        for version, texts in files.items()
    }
    installation.publish({path: None for texts in files.values() for path in texts})


@pytest.fixture(scope="module")
def running(installation: Installation, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningGate]:
    """One gate for all of them."""
    controller = ApplicationSetController()
    started = start_gate(installation, controller.url, tmp_path_factory.mktemp("gate"))
    yield started
    started.stop()
    controller.stop()


def about(version: str) -> Artefact:
    return artefact(CHART, version, sha256(version.encode()))


def entry_path(version: str) -> str:
    return f"charts/{CHART}/{version}.yaml"


@pytest.mark.parametrize("version", WRONG)
def test_evidence_that_does_not_hold_is_refused(
    installation: Installation, evidence: dict[str, str], running: RunningGate, version: str
) -> None:
    _, expected = WRONG[version]
    digest = about(version).digest
    named = evidence[version]
    manager = installation.clone("manager")
    plan = installation.plan()
    text = message(plan, charts=(ChartReference(CHART, version, digest),), evidence=(named,))
    files = release_files(plan, "doubtful", version=version, digest=digest, evidence=named)
    commit = manager.commit(files, text, [manager.tip()])
    number = installation.propose(manager, commit, plan)
    until(lambda: installation.pull_request(number)["state"] == "closed", "closed")
    said = installation.comments(number)
    assert expected in said
    if version == "0.10.6":
        shown("gate", said, "entry-called-verified")
    if version == "0.10.5":
        shown("gate", said, "verdict-overwritten")
    assert not installation.pull_request(number)["merged"]
    assert manager.tip() != commit


def test_a_changed_policy_makes_all_evidence_doubtful_and_its_return_good_again(
    installation: Installation, running: RunningGate
) -> None:
    path = "policies/verification.yaml"
    manager = installation.clone("manager")

    def propose() -> int:
        plan = installation.plan()
        commit = manager.commit(release_files(plan, "later"), message(plan), [manager.tip()])
        return installation.propose(manager, commit, plan)

    def policy(text: str) -> None:
        """On main, and told to the gate: a proposal may be faster than the forge's word of a push."""
        installation.publish({path: text})
        running.gate.wake("push", {"repository": {"full_name": "robotkube/catalogue"}})

    policy(POLICY_TEXT.replace("seconds: 240", "seconds: 241"))
    try:
        refused = propose()
        until(lambda: installation.pull_request(refused)["state"] == "closed", "closed")
        assert f"the evidence was made under another policy ({POLICY.digest}" in installation.comments(refused)
    finally:
        policy(POLICY_TEXT)
    merged = propose()
    until(lambda: installation.pull_request(merged)["merged"], "merged")
