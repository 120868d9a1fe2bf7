"""What the registry costs: validating sources, and reading a catalogue whose evidence was verified before.

Besides the ratios, the figures in seconds go to build/bench/registry.json; `record` adds to that file.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path

import yaml
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from ci.benchmarks.measuring import Figure, seconds
from ci.folders import PROJECT
from robotkube.adapters.evidence_dsse import KeyFile, TrustedKeys
from robotkube.domain.charts_packing import sha256
from robotkube.domain.evidence import Artefact, Check, SuiteResult, suite_statement, summary_statement
from robotkube.domain.texts import write_mapping
from robotkube.domain.verification import PATH, VerificationPolicy, read_verification_policy
from robotkube.services.assured_catalogue import EvidenceReader

RECORD = PROJECT / "build" / "bench" / "registry.json"
CHARTS, VERSIONS = 50, 10
PLATFORM = "linux/amd64"
CHECKS = tuple(Check(f"check-{number}", True) for number in range(20))
REPETITIONS = 20
WARM_RATIO_MAX = 0.1  # of verifying everything
POLICY = {
    "apiVersion": "registry.robotkube.io/v1alpha1",
    "kind": "VerificationPolicy",
    "metadata": {"name": "release"},
    "spec": {
        "suites": [
            {"name": name, "version": "1", "seconds": 60} for name in ("static", "images", "interface", "install")
        ]
    },
}


def record(values: Mapping[str, float | Mapping[str, float]]) -> None:
    """Add figures to the record, replacing those of the same name."""
    kept = json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.exists() else {}
    RECORD.parent.mkdir(parents=True, exist_ok=True)
    RECORD.write_text(json.dumps(kept | dict(values), indent=1, sort_keys=True) + "\n", encoding="utf-8")


def source(chart: str, version: str) -> dict[str, object]:
    """A chart version as its source says it."""
    return {
        "apiVersion": "registry.robotkube.io/v1alpha1",
        "kind": "ChartVersion",
        "metadata": {"name": chart},
        "spec": {
            "version": version,
            "description": "A chart of the benchmark",
            "channel": "stable",
            "platforms": [PLATFORM],
            "images": [],
        },
    }


def published(key: KeyFile, policy: VerificationPolicy, chart: str, version: str) -> dict[str, str]:
    """The files of a chart version that was published with evidence: path -> text."""
    artefact = Artefact(chart, version, sha256(f"{chart} {version}".encode()), PLATFORM)
    envelopes = {
        rule.name: key.sign(
            suite_statement(artefact, policy.digest, SuiteResult(rule.name, rule.version, "passed", CHECKS, 1.0))
        )
        for rule in policy.suites
    }
    digests = {name: sha256(data) for name, data in envelopes.items()}
    uri = f"oci://forge.example/verified/{chart}"
    summary = key.sign(summary_statement(artefact, policy, PATH, uri, "gate", "2026-11-21T10:00:00Z", digests))
    status = {"state": "verified", "digest": artefact.digest, "images": [], "policy": policy.digest}
    entry = source(chart, version) | {"status": status | {"evidence": sha256(summary)}}
    files = {
        f"{artefact.folder}/{name}.json": data.decode() for name, data in (envelopes | {"summary": summary}).items()
    }
    return files | {f"charts/{chart}/{version}.yaml": write_mapping(entry)}


def keys(folder: Path) -> tuple[KeyFile, TrustedKeys]:
    """A new key, trusted."""
    private = Ed25519PrivateKey.generate()
    (folder / "key").write_bytes(private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    key = KeyFile(folder / "key")
    (folder / "public.pem").write_text(key.public_key, encoding="utf-8")
    return key, TrustedKeys(folder)


def verifying() -> Figure:
    """A new commit of a catalogue of 500 verified versions, read as manager and gate read it."""
    text = yaml.safe_dump(POLICY)
    policy = read_verification_policy(text, PATH)
    with tempfile.TemporaryDirectory() as folder:
        key, trusted = keys(Path(folder))
        files = {"policies/release.yaml": "assurance: verified\n", PATH: text}
        for number in range(CHARTS):
            for minor in range(VERSIONS):
                files |= published(key, policy, f"chart-{number}", f"0.{minor}.0")
        warm = EvidenceReader(trusted)
        assured = [version.assured for versions in warm.read(files).charts.values() for version in versions]
        if not (all(assured) and len(assured) == CHARTS * VERSIONS):
            raise AssertionError("the benchmark's own catalogue is not assured")
        cold = seconds(lambda: EvidenceReader(trusted).read(files), 1)
        ours = seconds(lambda: warm.read(dict(files)), REPETITIONS)
    record({"verify_warm_ms": round(ours * 1000, 2), "verify_cold_ms": round(cold * 1000, 1)})
    name = f"read {CHARTS * VERSIONS} versions with evidence, verified before"
    return Figure(name, "ms", ours * 1000, cold * 1000, WARM_RATIO_MAX, "verify all of it")


def figures() -> list[Figure]:
    """All."""
    return [verifying()]
