"""Real keys and signed evidence for tests: a key pair per name, a policy, the files of a published chart version."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from robotkube.foundation.documents.core.digests import sha256
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.registry.charts.core.packing import published_digest
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.evidence.adapters.dsse import KeyFile, TrustedKeys
from robotkube.registry.evidence.core.application_statements import (
    TrialResult,
    application_statement,
    statement_path,
)
from robotkube.registry.evidence.core.statements import (
    Artefact,
    Check,
    Listing,
    SuiteResult,
    VerifiedStatement,
    suite_statement,
    summary_statement,
)
from robotkube.registry.evidence.core.verification_policy import (
    PATH,
    SuiteRule,
    VerificationPolicy,
    read_verification_policy,
)
from robotkube.registry.evidence.ports import Verifier

PLATFORM = "linux/amd64"
VERIFIED_AT = "2026-11-21T10:00:00Z"
CHARTS_URL = "oci://forge.example:3000/verified"
POLICY_TEXT = """\
apiVersion: registry.robotkube.io/v1alpha1
kind: VerificationPolicy
metadata: {name: release}
spec:
  suites:
  - {name: static, version: "1", seconds: 60}
  - {name: images, version: "2", seconds: 60}
  - {name: install, version: "2", seconds: 240}
"""
POLICY = read_verification_policy(POLICY_TEXT, PATH)


def signing_key(folder: Path, seed: int | None = None) -> KeyFile:
    """A key of its own in `folder`/key.pem; always the same one for a `seed`."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "key.pem"
    path.write_bytes(_pem(Ed25519PrivateKey.generate() if seed is None else _private(seed)))
    return KeyFile(path)


def seeded_key(seed: int) -> KeyFile:
    """The key of a `seed`, read from memory: no file stays, however the process ends."""
    memory = os.memfd_create("key")
    try:
        os.write(memory, _pem(_private(seed)))
        return KeyFile(Path(f"/proc/self/fd/{memory}"))
    finally:
        os.close(memory)


def _private(seed: int) -> Ed25519PrivateKey:
    return Ed25519PrivateKey.from_private_bytes(hashlib.sha256(str(seed).encode()).digest())


def _pem(key: Ed25519PrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def trusting(folder: Path, *keys: KeyFile) -> TrustedKeys:
    """Exactly these keys trusted, by the files in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.iterdir():
        path.unlink()
    for key in keys:
        (folder / f"{key.key_id}.pem").write_text(key.public_key)
    return TrustedKeys(folder)


class Remembering:
    """Port Verifier for tests of what is done with evidence: an envelope that was believed under the same keys by any
    test of this process is not verified again. What was refused is refused anew, in the verifier's words."""

    believed: ClassVar[dict[tuple[frozenset[str], bytes], VerifiedStatement]] = {}

    def __init__(self, verifier: Verifier) -> None:
        self._verifier = verifier
        self._keys = verifier.trusted()

    def trusted(self) -> frozenset[str]:
        self._keys = self._verifier.trusted()
        return self._keys

    def verify(self, envelope: bytes) -> VerifiedStatement:
        known = (self._keys, envelope)
        if known not in self.believed:
            self.believed[known] = self._verifier.verify(envelope)
        return self.believed[known]


def artefact(chart: str = "app", version: str = "0.1.0", content: str = "", platform: str = PLATFORM) -> Artefact:
    """A chart version; its digest follows from `content`, or from its name."""
    digest = sha256((content or f"{chart} {version}").encode())
    return Artefact(chart, version, digest, platform)


def result(rule: SuiteRule, *failed: str) -> SuiteResult:
    """What a run of a suite found: two checks, the named ones failed."""
    checks = [Check("first", True), Check("second", True), *(Check(name, False, "this", "do that") for name in failed)]
    return SuiteResult(rule.name, rule.version, "failed" if failed else "passed", tuple(checks), 1.5)


@dataclass
class Signing:
    """Signs all that a publication signs. `envelopes`: suite (or "summary") -> envelope; `schema` is the text of the
    values schema that is published beside, `listed` all that is said of the chart where it is not what `entry` says."""

    key: KeyFile
    policy: VerificationPolicy = POLICY
    schema: str = ""
    listed: Listing | None = None
    envelopes: dict[str, bytes] = field(default_factory=dict)

    def sign(self, about: Artefact, suites: Sequence[str] | None = None) -> Mapping[str, bytes]:
        """Envelopes that all suites passed, and the summary of them."""
        for rule in self.policy.suites:
            if suites is None or rule.name in suites:
                self.envelopes[rule.name] = self.key.sign(suite_statement(about, self.policy.digest, result(rule)))
        self.summarise(about)
        return self.envelopes

    def summarise(self, about: Artefact) -> bytes:
        """Sign the summary of the envelopes as they are."""
        digests = {name: sha256(data) for name, data in self.envelopes.items() if name != "summary"}
        uri = f"{CHARTS_URL}/{about.chart}"
        listed = self.listed or listing(about, self.schema)
        statement = summary_statement(about, self.policy, PATH, uri, "robotkube-gate", VERIFIED_AT, digests, listed)
        self.envelopes["summary"] = self.key.sign(statement)
        return self.envelopes["summary"]


def spec(about: Artefact) -> dict[str, Any]:
    """What the entry of a chart version says."""
    return {
        "version": about.version,
        "description": "A chart of the tests",
        "channel": "stable",
        "platforms": [PLATFORM],
        "images": [],
    }


def listing(about: Artefact, schema: str = "", images: Sequence[str] = ()) -> Listing:
    """What the catalogue says of a chart version with that entry, that values schema and these images."""
    return Listing(published_digest(spec(about), images), sha256(schema.encode()) if schema else "")


def entry(
    about: Artefact,
    state: str = "verified",
    evidence: str = "",
    policy: str = POLICY.digest,
    images: Sequence[str] = (),
) -> dict[str, str]:
    """The catalogue's file of a chart version (path -> text)."""
    status = {"state": state, "digest": about.digest, "images": list(images)}
    if evidence:
        status |= {"evidence": evidence, "policy": policy}
    document = {
        "apiVersion": "registry.robotkube.io/v1alpha1",
        "kind": "ChartVersion",
        "metadata": {"name": about.chart},
        "spec": spec(about),
        "status": status,
    }
    return {f"charts/{about.chart}/{about.version}.yaml": write_mapping(document)}


def published(
    key: KeyFile,
    about: Artefact,
    policy: VerificationPolicy = POLICY,
    schema: str = "",
    images: Sequence[str] = (),
) -> dict[str, str]:
    """The files of a chart version that was published with evidence: its entry, values schema and envelopes."""
    envelopes = Signing(key, policy, schema, listing(about, schema, images)).sign(about)
    files = {f"{about.folder}/{name}.json": data.decode() for name, data in envelopes.items()}
    if schema:
        files[f"charts/{about.chart}/{about.version}.schema.json"] = schema
    return files | entry(about, evidence=sha256(envelopes["summary"]), policy=policy.digest, images=images)


def application_evidence(
    key: KeyFile, name: str, text: str, policy: VerificationPolicy = POLICY, charts: Sequence[ChartReference] = ()
) -> dict[str, str]:
    """The statement (path -> envelope) that the application whose document is `text` passed its trial."""
    statement = application_statement(name, text, policy.digest, TrialResult((), tuple(charts), 3, 2))
    return {statement_path(name): key.sign(statement).decode()}


def catalogue(*parts: Mapping[str, str], assurance: str = "verified", policy: str = POLICY_TEXT) -> dict[str, str]:
    """The files of a catalogue repository with these chart versions."""
    files = {"policies/release.yaml": f"assurance: {assurance}\n", PATH: policy}
    for part in parts:
        files |= part
    return files
