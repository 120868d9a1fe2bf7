"""Applications with their evidence: what is assured, and what the release policy forbids then."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from robotkube.errors import DocumentError, RefusalError
from robotkube.registry.catalogue.core.catalogue import Catalogue, ReleasePolicy, read_release_policy
from robotkube.registry.catalogue.core.entry_documents import entry_documents
from robotkube.registry.catalogue.loops.verified_catalogue import EvidenceReader
from robotkube.registry.evidence.adapters.dsse import KeyFile, TrustedKeys
from tests.stages.attacks import shown
from tests.stages.registry.signed_evidence import (
    POLICY_TEXT,
    application_evidence,
    artefact,
    catalogue,
    published,
    signing_key,
    trusting,
)
from tests.stages.registry.submissions import application

PATH, STATEMENT = "applications/relaying.yaml", "evidence/applications/relaying.json"
TEXT = application(chart_name="app")
EDITED = application(chart_name="app", description="Relays, and more")
RELEASE_POLICY = "policies/release.yaml"
MISSING = "no valid evidence: there is no evidence that it was composed and checked; publish it again"


@pytest.fixture
def key(tmp_path: Path) -> KeyFile:
    return signing_key(tmp_path / "gate")


@pytest.fixture
def trusted(tmp_path: Path, key: KeyFile) -> TrustedKeys:
    return trusting(tmp_path / "keys", key)


def files(key: KeyFile, text: str = TEXT, applications: str = "verified", **more: str) -> dict[str, str]:
    policy = {RELEASE_POLICY: f"assurance: verified\napplications: {applications}\n"}
    return {
        **catalogue(published(key, artefact()), application_evidence(key, "relaying", TEXT), policy),
        PATH: text,
        **more,
    }


def forbidden(trusted: TrustedKeys, found: Mapping[str, str]) -> str:
    """Why `relaying` may not be deployed; empty when it may."""
    read = EvidenceReader(trusted).read(found)
    assert read.problems == ()
    return read.forbids(read.applications["relaying"])


def test_an_application_with_its_statement_is_assured(key: KeyFile, trusted: TrustedKeys) -> None:
    read = EvidenceReader(trusted).read(files(key))
    assert read.applications["relaying"].assured
    assert read.applications["relaying"].evidence_problem == ""
    read.admit(read.applications["relaying"])


@pytest.mark.parametrize("applications", ["verified", "transition"])
def test_one_edited_after_signing_is_forbidden_also_in_transition(
    key: KeyFile, trusted: TrustedKeys, applications: str
) -> None:
    text = forbidden(trusted, files(key, EDITED, applications))
    assert text.startswith(f"no valid evidence: {PATH} is not what was verified (sha256:")
    shown("selection", text, "application-edited")
    assert forbidden(trusted, files(key, EDITED, "none")) == ""
    read = EvidenceReader(trusted).read(files(key, EDITED, applications))
    with pytest.raises(RefusalError, match="application relaying: no valid evidence") as caught:
        read.admit(read.applications["relaying"])
    assert caught.value.reason == "ApplicationNotVerified"


def test_the_statement_of_another_application_and_of_another_key_are_forbidden(
    tmp_path: Path, key: KeyFile, trusted: TrustedKeys
) -> None:
    other = application_evidence(key, "other", TEXT)["evidence/applications/other.json"]
    text = forbidden(trusted, files(key, **{STATEMENT: other}))
    assert text == "no valid evidence: the evidence is about application 'other', not 'relaying'"
    stranger = signing_key(tmp_path / "stranger")
    text = forbidden(trusted, files(key, **application_evidence(stranger, "relaying", TEXT)))
    assert "which is not trusted here" in text
    text = forbidden(trusted, files(key, applications="transition", **{STATEMENT: "{}"}))
    assert text.startswith("no valid evidence: the evidence cannot be believed: ")


def test_without_a_statement_only_the_transition_lets_it_through(key: KeyFile, trusted: TrustedKeys) -> None:
    evidence = files(key)
    del evidence[STATEMENT]
    assert forbidden(trusted, evidence) == MISSING
    evidence[RELEASE_POLICY] = "assurance: verified\n"
    assert forbidden(trusted, evidence) == ""
    evidence[RELEASE_POLICY] = "assurance: verified\napplications: transition\n"
    assert forbidden(trusted, evidence) == ""


def test_another_verification_policy_makes_it_doubtful(key: KeyFile, trusted: TrustedKeys) -> None:
    changed = POLICY_TEXT.replace("seconds: 240", "seconds: 300")
    text = forbidden(trusted, files(key, **{"policies/verification.yaml": changed}))
    assert "made under another policy" in text
    missing = files(key)
    del missing["policies/verification.yaml"]
    assert "has no policies/verification.yaml" in forbidden(trusted, missing)


def test_a_withdrawn_version_leaves_the_statement_as_it_is(key: KeyFile, trusted: TrustedKeys) -> None:
    evidence = files(key)
    entry = "charts/app/0.1.0.yaml"
    evidence[entry] = evidence[entry].replace("state: verified", "state: withdrawn")
    assert forbidden(trusted, evidence) == ""
    read = EvidenceReader(trusted).read(evidence)
    with pytest.raises(RefusalError, match="state withdrawn is not allowed"):
        read.select(read.applications["relaying"].services[0].chart)


def test_a_bridge_that_is_forbidden_bridges_nothing(key: KeyFile, trusted: TrustedKeys) -> None:
    evidence = files(key, application(chart_name="app", provides=["link/mqtt"]))
    with pytest.raises(RefusalError) as caught:
        EvidenceReader(trusted).read(evidence).bridge("mqtt")
    assert caught.value.reason == "ApplicationNotVerified"


def test_the_policy_says_which_applications_and_nothing_else() -> None:
    def read(text: str) -> ReleasePolicy:
        return read_release_policy(f"assurance: verified\n{text}", RELEASE_POLICY)

    assert read("").applications == "transition"
    assert read("applications: verified\n").applications == "verified"
    assert read("applications: none\n").applications == "none"
    with pytest.raises(DocumentError, match="applications"):
        read("applications: some\n")
    assert Catalogue().application_assurance == "transition"


def test_entries_show_state_digest_and_why_not(key: KeyFile, trusted: TrustedKeys) -> None:
    shown = entry_documents(EvidenceReader(trusted).read(files(key)))[0]
    assert (shown["kind"], shown["state"], shown["assured"], shown["evidence_problem"]) == (
        "application", "verified", True, "",
    )  # fmt: skip
    assert shown["evidence"].startswith("sha256:")
    edited = entry_documents(EvidenceReader(trusted).read(files(key, EDITED)))[0]
    assert (edited["state"], edited["assured"]) == ("unverified", False)
    assert "is not what was verified" in edited["evidence_problem"]
    source = entry_documents(EvidenceReader(trusted).read(files(key)), published=False)[0]
    assert source["state"] == "source"
