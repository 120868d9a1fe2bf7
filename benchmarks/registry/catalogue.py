"""What the registry costs: validating sources, and reading a catalogue whose evidence was verified before.

Besides the ratios, the seconds go to build/bench/registry.json; `record` adds to that file.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from benchmarks.measuring import comparisons
from benchmarks.measuring.comparisons import Comparison, seconds
from ci.folders import PROJECT
from robotkube.foundation.documents.core.digests import sha256
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.registry.catalogue.core.versions import version_key
from robotkube.registry.catalogue.loops.verified_catalogue import EvidenceReader
from robotkube.registry.charts.core.packing import published_digest
from robotkube.registry.evidence.adapters.dsse import KeyFile, TrustedKeys
from robotkube.registry.evidence.core.statements import (
    Artefact,
    Check,
    Listing,
    SuiteResult,
    suite_statement,
    summary_statement,
)
from robotkube.registry.evidence.core.verification_policy import PATH, VerificationPolicy, read_verification_policy

RECORD = PROJECT / "build" / "bench" / "registry.json"
CHARTS, VERSIONS = 50, 10
PLATFORM = "linux/amd64"
CHECKS = tuple(Check(f"check-{number}", True) for number in range(20))
REPETITIONS = 20
WARM_RATIO_MAX = 0.1  # of verifying everything
VALIDATIONS = 3
VALIDATE_SECONDS_MAX = 60
VALIDATE_RATIO_MAX = 1.5
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
    """Add values to the record of registry and gate, replacing those of the same name."""
    comparisons.record(RECORD, values)


def source(chart: str, version: str) -> dict[str, Any]:
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
    listing = Listing(published_digest(source(chart, version)["spec"], []))
    statement = summary_statement(artefact, policy, PATH, uri, "gate", "2026-11-21T10:00:00Z", digests, listing)
    summary = key.sign(statement)
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


def verifying() -> Comparison:
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
    return Comparison(name, "ms", ours * 1000, cold * 1000, WARM_RATIO_MAX, "verify all of it")


def sources(folder: Path) -> list[Path]:
    """The project's registry with 500 more chart versions, each as long as that of the bridge and replacing the one
    before; the files of charts."""
    shutil.copytree(PROJECT / "registry", folder)
    newest = max((folder / "charts" / "mqtt-bridge").iterdir(), key=lambda path: version_key(path.stem))
    model = yaml.safe_load(newest.read_text(encoding="utf-8"))
    for key in ("replaces", "skips"):
        model["spec"].pop(key, None)
    for number in range(CHARTS):
        chart = folder / "charts" / f"chart-{number}"
        chart.mkdir()
        for minor in range(VERSIONS):
            before = {"replaces": f"0.{minor - 1}.0"} if minor else {}
            spec = {**model["spec"], **before, "version": f"0.{minor}.0", "provides": [f"benchmark/{number}"]}
            document = {**model, "metadata": {"name": chart.name}, "spec": spec}
            (chart / f"0.{minor}.0.yaml").write_text(write_mapping(document), encoding="utf-8")
    return sorted(folder.glob("charts/*/*.yaml"))


def validating() -> Comparison:
    """The command `registry validate` on them, from its start to its end."""
    with tempfile.TemporaryDirectory() as place:
        paths = sources(Path(place) / "registry")
        command = [sys.executable, "-m", "robotkube.cli", "registry", "validate"]

        def ours() -> None:
            subprocess.run(command, cwd=place, check=True, capture_output=True, timeout=VALIDATE_SECONDS_MAX)

        def baseline() -> None:
            for path in paths:
                yaml.safe_load(path.read_text(encoding="utf-8"))

        mine, theirs = seconds(ours, VALIDATIONS), seconds(baseline, VALIDATIONS)
    record({"validate_500_s": round(mine, 2)})
    name = f"validate {CHARTS * VERSIONS} chart versions"
    return Comparison(name, "s", mine, theirs, VALIDATE_RATIO_MAX, "read them with PyYAML")


def compare() -> list[Comparison]:
    """All."""
    return [verifying(), validating()]
