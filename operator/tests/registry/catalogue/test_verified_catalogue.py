"""The catalogue with its evidence: what is assured, what is doubtful and why, what stays when something breaks."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from robotkube.errors import InputError, RefusalError
from robotkube.foundation.documents.core.digests import sha256
from robotkube.registry.catalogue.core.catalogue import ChartRequirement
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue, EvidenceReader
from robotkube.registry.evidence.adapters.dsse import KeyFile, TrustedKeys
from robotkube.registry.evidence.core.statements import VerifiedStatement
from tests.stages.attacks import shown
from tests.stages.registry.signed_evidence import (
    POLICY,
    POLICY_TEXT,
    Signing,
    artefact,
    catalogue,
    entry,
    published,
    signing_key,
    trusting,
)

APP = artefact()
ANY = ChartRequirement("app", ">=0.1.0")


class Repository:
    """A catalogue repository in memory: one commit after the other."""

    def __init__(self) -> None:
        self.commits: list[Mapping[str, str]] = []

    def fetch(self) -> str:
        return f"{len(self.commits):040x}" if self.commits else ""

    def files(self, commit: str, folders: Sequence[str]) -> Mapping[str, str]:
        tree = self.commits[int(commit, 16) - 1]
        return {path: text for path, text in tree.items() if path.split("/")[0] in folders}


class Counting:
    """A verifier that counts what it is asked to verify."""

    def __init__(self, verifier: TrustedKeys) -> None:
        self._verifier = verifier
        self.verified = 0

    def trusted(self) -> frozenset[str]:
        return self._verifier.trusted()

    def verify(self, envelope: bytes) -> VerifiedStatement:
        self.verified += 1
        return self._verifier.verify(envelope)


@pytest.fixture
def key(tmp_path: Path) -> KeyFile:
    return signing_key(tmp_path / "gate")


@pytest.fixture
def trusted(tmp_path: Path, key: KeyFile) -> TrustedKeys:
    return trusting(tmp_path / "keys", key)


def evidence_problem(trusted: TrustedKeys, files: Mapping[str, str]) -> str:
    """Why the evidence of `app` does not hold; empty when it is assured."""
    version = EvidenceReader(trusted).read(files).version("app", "0.1.0")
    assert version
    assert version.assured is (version.evidence_problem == "")
    return version.evidence_problem


def test_a_published_version_is_assured_and_selected(key: KeyFile, trusted: TrustedKeys) -> None:
    read = EvidenceReader(trusted).read(catalogue(published(key, APP)))
    assert read.problems == ()
    chosen, reasons = read.select(ANY)
    assert (chosen.version, chosen.assured) == ("0.1.0", True)
    assert reasons == ("app 0.1.0 (verified): taken",)


def test_an_entry_edited_to_verified_is_not_selected(key: KeyFile, trusted: TrustedKeys) -> None:
    edited = EvidenceReader(trusted).read(catalogue(entry(APP, evidence=sha256(b"invented"))))
    with pytest.raises(RefusalError) as caught:
        edited.select(ANY)
    assert caught.value.reason == "NoVerifiedVersion"
    assert "no valid evidence: suite static: there is no evidence; a missing suite is not a passed one" in str(
        caught.value
    )
    shown("selection", str(caught.value), "entry-called-verified")


def test_a_withdrawn_version_is_not_selected(key: KeyFile, trusted: TrustedKeys) -> None:
    files = catalogue(published(key, APP))
    withdrawn = {**files, ENTRY: files[ENTRY].replace("state: verified", "state: withdrawn")}
    assert withdrawn != files
    with pytest.raises(RefusalError) as caught:
        EvidenceReader(trusted).read(withdrawn).select(ANY)
    shown("selection", str(caught.value), "withdrawn-version")


def test_evidence_of_another_build_of_the_version_does_not_count(key: KeyFile, trusted: TrustedKeys) -> None:
    other = artefact(content="one byte more")
    moved = {path.replace(APP.folder, other.folder): text for path, text in published(key, APP).items()}
    text = evidence_problem(trusted, catalogue(moved, entry(other, evidence=sha256(b"x"))))
    assert f"suite static: the evidence is about another digest ({APP.digest}, not {other.digest})" in text


ENTRY, SCHEMA = "charts/app/0.1.0.yaml", "charts/app/0.1.0.schema.json"


@pytest.mark.parametrize(
    ("path", "before", "after"),
    [
        (ENTRY, "description: A chart", "description: Another chart"),
        (
            ENTRY,
            "images: []\n  platforms",
            "guarantees: [{name: rate, atLeast: 9, unit: Hz}]\n  images: []\n  platforms",
        ),
        (ENTRY, "  platforms:", "  provides: [perception/everything]\n  platforms:"),
        (ENTRY, "  images: []\n  policy", f"  images: [forge.example/x@sha256:{'e' * 64}]\n  policy"),
        (SCHEMA, "maximum", "minimum"),
    ],
)
def test_what_people_change_beside_the_evidence_is_in_doubt(
    key: KeyFile, trusted: TrustedKeys, path: str, before: str, after: str
) -> None:
    files = catalogue(published(key, APP, schema='{"maximum": 3}'))
    assert evidence_problem(trusted, files) == ""
    reader = EvidenceReader(trusted)
    reader.read(files)
    assert files[path].count(before) == 1
    edited = {**files, path: files[path].replace(before, after)}
    version = reader.read(edited).version("app", "0.1.0")
    assert version
    assert f"{path} is not what was verified" in version.evidence_problem
    assert evidence_problem(trusted, edited) == version.evidence_problem


def test_without_its_values_schema_a_version_is_in_doubt(key: KeyFile, trusted: TrustedKeys) -> None:
    files = catalogue(published(key, APP, schema="{}"))
    del files[SCHEMA]
    assert f"{SCHEMA} is not what was verified (missing, not sha256:" in evidence_problem(trusted, files)


def test_evidence_by_another_key_does_not_count(tmp_path: Path, trusted: TrustedKeys) -> None:
    stranger = signing_key(tmp_path / "stranger")
    text = evidence_problem(trusted, catalogue(published(stranger, APP)))
    assert f"summary: it is signed with key '{stranger.key_id}', which is not trusted here" in text


def test_a_missing_suite_and_an_edited_envelope_are_named(key: KeyFile, trusted: TrustedKeys) -> None:
    files = catalogue(published(key, APP))
    del files[f"{APP.folder}/images.json"]
    path = f"{APP.folder}/install.json"
    files[path] = files[path].replace('"payload":"ey', '"payload":"eX')
    text = evidence_problem(trusted, files)
    assert "suite images: there is no evidence" in text
    assert f"suite install: its signature by key {key.key_id} does not fit" in text


def test_a_changed_policy_makes_evidence_doubtful(key: KeyFile, trusted: TrustedKeys) -> None:
    changed = POLICY_TEXT.replace("seconds: 240", "seconds: 300")
    assert "made under another policy" in evidence_problem(trusted, catalogue(published(key, APP), policy=changed))


def test_evidence_is_needed_for_every_platform_of_the_fleet(key: KeyFile, trusted: TrustedKeys) -> None:
    reader = EvidenceReader(trusted, ("linux/amd64", "linux/arm64"))
    version = reader.read(catalogue(published(key, APP))).version("app", "0.1.0")
    assert version
    assert "suite static: the evidence is for platform linux/amd64, not linux/arm64" in version.evidence_problem


def test_without_a_policy_nothing_is_assured(key: KeyFile, trusted: TrustedKeys) -> None:
    files = catalogue(published(key, APP))
    del files["policies/verification.yaml"]
    assert (
        evidence_problem(trusted, files) == "the catalogue has no policies/verification.yaml to assess its evidence by"
    )


def test_files_that_nobody_asks_for_change_nothing(key: KeyFile, trusted: TrustedKeys) -> None:
    strange = {f"{APP.folder}/older.json": "{", f"{APP.folder}/static.json.bak": "", "evidence/README": "words"}
    assert evidence_problem(trusted, catalogue(published(key, APP), strange)) == ""


def test_a_second_key_keeps_old_evidence_and_removing_the_old_key_makes_it_doubtful(
    tmp_path: Path, key: KeyFile, trusted: TrustedKeys
) -> None:
    second = signing_key(tmp_path / "second")
    newer = artefact("app", "0.2.0")
    repository = Repository()
    repository.commits.append(catalogue(published(key, APP), published(second, newer)))
    reading = AssuredCatalogue(repository, trusted)

    def assured() -> list[bool]:
        _, read = reading.read()
        return [version.assured for version in read.charts["app"]]

    assert assured() == [True, False]
    trusting(tmp_path / "keys", key, second)
    assert assured() == [True, True]
    trusting(tmp_path / "keys", second)
    assert assured() == [False, True]
    assert f"key '{key.key_id}', which is not trusted here" in reading.catalogue.charts["app"][0].evidence_problem


def test_what_was_verified_is_not_verified_again(key: KeyFile, trusted: TrustedKeys) -> None:
    verifier = Counting(trusted)
    repository = Repository()
    assured = AssuredCatalogue(repository, verifier)
    repository.commits.append(catalogue(published(key, APP)))
    assured.read()
    assert verifier.verified == len(POLICY.suites) + 1
    assured.read()
    repository.commits.append({**repository.commits[0], "applications/README.md": "words"})
    tip, _ = assured.read()
    assert tip == repository.fetch()
    assert verifier.verified == len(POLICY.suites) + 1
    repository.commits.append({**repository.commits[0], **published(key, artefact("other"))})
    assured.read()
    assert verifier.verified == 2 * (len(POLICY.suites) + 1)


def test_a_broken_file_leaves_the_last_good_catalogue_in_place(
    key: KeyFile, trusted: TrustedKeys, caplog: pytest.LogCaptureFixture
) -> None:
    repository = Repository()
    assured = AssuredCatalogue(repository, trusted)
    with pytest.raises(InputError, match="the catalogue repository has no main branch yet"):
        assured.read()
    repository.commits.append(catalogue({"charts/app/0.1.0.yaml": "{"}))
    with pytest.raises(InputError, match=r"charts/app/0\.1\.0\.yaml: .*nothing is planned until it is repaired"):
        assured.read()
    repository.commits.append(catalogue(published(key, APP)))
    good, _ = assured.read()
    repository.commits.append({**repository.commits[1], "policies/verification.yaml": "spec: {}\n"})
    with caplog.at_level(logging.ERROR):
        tip, kept = assured.read()
    assert tip == good == assured.tip
    assert kept.select(ANY)[0].assured
    assert assured.files == repository.commits[1]
    assert "policies/verification.yaml: apiVersion: missing" in caplog.text


def test_the_same_problem_is_logged_once_while_main_moves(
    key: KeyFile, trusted: TrustedKeys, caplog: pytest.LogCaptureFixture
) -> None:
    repository = Repository()
    assured = AssuredCatalogue(repository, trusted)
    good = catalogue(published(key, APP))
    broken = {**good, "applications/relaying.yaml": "{"}
    repository.commits.append(good)
    assured.read()
    for number in range(14):
        repository.commits.append({**broken, "applications/other.txt": str(number)})
        assured.read()
    assert len(caplog.records) == 1
    repository.commits.append(good)
    assured.read()
    repository.commits.append(broken)
    assured.read()
    assert len(caplog.records) == 2


def test_a_key_removed_while_the_newest_commit_is_broken_counts_at_once(
    tmp_path: Path, key: KeyFile, trusted: TrustedKeys
) -> None:
    repository = Repository()
    assured = AssuredCatalogue(repository, trusted)
    repository.commits.append(catalogue(published(key, APP)))
    assured.read()
    repository.commits.append(catalogue({"charts/app/0.1.0.yaml": "{"}))
    assured.read()
    trusting(tmp_path / "keys", signing_key(tmp_path / "second"))
    _, read = assured.read()
    assert not read.charts["app"][0].assured


def test_a_key_that_cannot_be_read_stops_everything(tmp_path: Path, key: KeyFile, trusted: TrustedKeys) -> None:
    repository = Repository()
    repository.commits.append(catalogue(published(key, APP)))
    assured = AssuredCatalogue(repository, trusted)
    assured.read()
    (tmp_path / "keys" / "broken.pem").write_text("no key")
    with pytest.raises(InputError, match=r"broken\.pem: no PEM public key"):
        assured.read()


def test_a_summary_signed_for_other_envelopes_does_not_count(key: KeyFile, trusted: TrustedKeys) -> None:
    signing = Signing(key)
    summary = signing.sign(APP)["summary"]
    files = catalogue(published(key, APP))
    again = Signing(key)
    again.sign(artefact(content="other"))
    files[f"{APP.folder}/static.json"] = again.envelopes["static"].decode()
    assert sha256(summary) in files["charts/app/0.1.0.yaml"]
    text = evidence_problem(trusted, files)
    assert "suite static: the evidence is about another digest" in text
    assert "summary: it lists another envelope of suite static" in text
    shown("selection", text, "verdict-overwritten")
