"""What the scenario takes from release files and from the catalogue's summaries: signed ones by trusted keys only."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import InputError
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.registry.evidence.adapters.dsse import KeyFile, TrustedKeys
from robotkube.registry.evidence.core.statements import VerifiedStatement, suite_statement
from scenarios.runner.inputs import ReleasedChart
from scenarios.runner.judging import evidence
from tests.stages.registry.signed_evidence import POLICY, Signing, artefact, result, signing_key, trusting

HEX = "d" * 64
PATH = "evidence/app/0.1.0_dddddddddddd/summary.json"


@pytest.fixture
def key(tmp_path: Path) -> KeyFile:
    return signing_key(tmp_path / "key")


@pytest.fixture
def keys(tmp_path: Path, key: KeyFile) -> TrustedKeys:
    return trusting(tmp_path / "trusted", key)


def summary(key: KeyFile) -> bytes:
    return Signing(key).sign(artefact())["summary"]


def changed(envelope: bytes, **values: Any) -> bytes:
    return canonical_json({**json.loads(envelope), **values})


def payload(statement: Any) -> str:
    return base64.b64encode(canonical_json(statement)).decode()


def statement(envelope: bytes) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(base64.b64decode(json.loads(envelope)["payload"]))
    return document


def released(envelope: bytes) -> ReleasedChart:
    return ReleasedChart("app", "0.1.0", artefact().digest, sha256(envelope), "a/app")


def test_summaries_are_known_by_their_bytes_and_name_the_chart(key: KeyFile, keys: TrustedKeys) -> None:
    data = summary(key)
    files = {PATH: data, "evidence/app/x/static.json": data}
    assert evidence.summaries(files, keys.verify) == {sha256(data): artefact().digest}
    assert list(evidence.problems(files, keys.verify, [released(data)])) == []


def test_what_nobody_signed_or_others_signed_is_not_believed(tmp_path: Path, key: KeyFile, keys: TrustedKeys) -> None:
    """The form and the digests are right in all of them."""
    good, foreign = summary(key), summary(signing_key(tmp_path / "foreign"))
    other = {**statement(good), "subject": [{"name": "app", "digest": {"sha256": HEX}}]}
    forged = {
        "no signature": changed(good, signatures=[]),
        "another key": foreign,
        "another key under the trusted one's name": changed(
            foreign, signatures=[{**json.loads(foreign)["signatures"][0], "keyid": key.key_id}]
        ),
        "about another chart": changed(good, payload=payload(other)),
        "of an earlier form": json.dumps(json.loads(good)).encode(),
    }
    for name, data in forged.items():
        assert evidence.summaries({PATH: data}, keys.verify) == {sha256(data): ""}, name
        [problem] = evidence.problems({PATH: data}, keys.verify, [released(data)])
        assert problem.startswith(f"evidence {sha256(data)}: it"), name
        assert list(evidence.problems({PATH: data}, keys.verify, [])) == []


def test_a_signed_statement_that_is_no_summary_of_a_pass_is_none(key: KeyFile, keys: TrustedKeys) -> None:
    suite = key.sign(suite_statement(artefact(), POLICY.digest, result(POLICY.suites[0])))
    failed = statement(summary(key))
    failed["predicate"]["verificationResult"] = "FAILED"
    for data in (suite, key.sign(failed)):
        assert evidence.summaries({PATH: data}, keys.verify) == {sha256(data): ""}
        [problem] = evidence.problems({PATH: data}, keys.verify, [released(data)])
        assert "does not say that a chart has passed" in problem


@pytest.mark.parametrize("subjects", [[], [{"name": "a", "digest": {"sha256": HEX}}] * 2])
def test_a_summary_is_about_one_chart(subjects: list[Any]) -> None:
    predicate = {"verificationResult": "PASSED"}
    document = {"predicateType": evidence.SUMMARY_PREDICATE, "predicate": predicate, "subject": subjects}
    assert evidence.summaries({PATH: b"x"}, lambda _: VerifiedStatement(document, "", "")) == {sha256(b"x"): ""}


@pytest.mark.parametrize(
    "data",
    [b"", b"\xff\xfe", b"[]", b"{}", b'{"payload": 1}', b'{"payload": "no base64"}', b"[" * 100_000],
)
def test_a_broken_summary_is_about_nothing(keys: TrustedKeys, data: bytes) -> None:
    assert evidence.summaries({PATH: data}, keys.verify) == {sha256(data): ""}


@pytest.mark.parametrize("content", [[], {"subject": []}, {"subject": [{"digest": {}}]}, {"subject": ["a", "b"]}])
def test_a_summary_with_a_broken_statement_is_about_nothing(key: KeyFile, keys: TrustedKeys, content: Any) -> None:
    """The envelope is of the right form."""
    data = changed(summary(key), payload=payload(content), signatures=[])
    assert evidence.summaries({PATH: data}, keys.verify) == {sha256(data): ""}


def test_the_keys_that_count_are_those_of_the_platform(tmp_path: Path, key: KeyFile) -> None:
    verify = evidence.trusted_keys({"gate.pem": key.public_key}).verify
    assert verify(summary(key)).key_id == key.key_id
    with pytest.raises(InputError, match="not trusted"):
        verify(summary(signing_key(tmp_path / "foreign")))


@pytest.mark.parametrize("texts", [{}, {"gate.txt": "x"}, {"gate.pem": "x"}])
def test_without_a_public_key_nothing_is_verified(texts: dict[str, str]) -> None:
    with pytest.raises(InputError, match=r"no (PEM )?public key"):
        evidence.trusted_keys(texts)


def test_releases_without_annotations_have_no_evidence() -> None:
    keys = {"chart": "bridge", "chart-version": "0.1.0", "chart-digest": f"sha256:{HEX}", "evidence": "none"}
    good = {"metadata": {"annotations": {f"robotkube.io/{key}": value for key, value in keys.items()}}}
    nothing = ReleasedChart("", "", "", "", "b/x")
    releases = evidence.released(
        [("a/bridge", good), ("a/bridge", good), *(("b/x", bad) for bad in (None, [], {}, "x"))]
    )
    assert releases == (nothing, ReleasedChart("bridge", "0.1.0", f"sha256:{HEX}", "none", "a/bridge"))
