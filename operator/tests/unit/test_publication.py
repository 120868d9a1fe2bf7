"""The gate's publication loop with everything in memory but the keys: verdicts, kept results, kill points, moved heads."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import submitted
from submitted import CATALOGUE, SUITES, application, chart, entry, entry_path, key, trusted

from robotkube.adapters.evidence_dsse import KeyFile, TrustedKeys
from robotkube.domain.catalogue import read_catalogue
from robotkube.domain.charts_packing import PackedChart, sha256
from robotkube.domain.errors import InputError, UnavailableError
from robotkube.domain.evidence import Artefact, Check, SuiteResult, assess, suite_statement
from robotkube.domain.suite_requests import SuiteProgress
from robotkube.domain.texts import read_mapping, write_mapping
from robotkube.domain.verification import PATH as POLICY_PATH
from robotkube.domain.verification import read_verification_policy
from robotkube.services.publication import Publication, PublicationSettings, publication_metrics
from robotkube.services.verifying import MARGIN_SECONDS, Verifying, VerifyingSettings
from robotkube.testing.publishing import MemoryCatalogue, MemoryCatalogueForge, MemoryChartRegistry, ScriptedRunner

CHARTS_URL = "oci://forge.invalid/verified"
POLICY = read_verification_policy(CATALOGUE[POLICY_PATH])
ROUNDS_MAX = 20


class KilledError(BaseException):
    """The process ends here; nothing catches it."""


class World:
    """The world outlives gates: `gate` starts another one."""

    def __init__(self, folder: Path) -> None:
        self.signer = key(folder)
        self.keys = folder / "trusted"
        self.verifier = trusted(self.keys, self.signer)
        self.catalogue = MemoryCatalogue(CATALOGUE)
        self.forge = MemoryCatalogueForge(self.catalogue)
        self.registry = MemoryChartRegistry()
        self.runner = ScriptedRunner()
        self.now = 100.0
        self.published = 0
        self.local_builds = False
        self.gate = self.start()

    def start(self, signer: KeyFile | None = None, verifier: TrustedKeys | None = None) -> Publication:
        settings = VerifyingSettings("staging", "verified", CHARTS_URL, "http://forge/robotkube/catalogue", "the-gate")
        signer = signer or self.signer
        verifying = Verifying(
            self.registry,
            signer,
            verifier or self.verifier,
            self.runner,
            settings,
            lambda: self.now,
            lambda: "2026-11-21T10:00:00Z",
        )
        self.gate = Publication(
            self.forge,
            self.catalogue,
            self.catalogue,
            self.registry,
            verifying,
            signer,
            PublicationSettings(
                "robotkube/catalogue", ("publisher",), "gate", "staging", "verified", CHARTS_URL, self.local_builds
            ),
            lambda: self.now,
            self._count,
        )
        return self.gate

    def _count(self) -> None:
        self.published += 1

    def submit(self, *charts: tuple[PackedChart, dict], push: bool = True, **files: str) -> int:
        """A pull request with these charts and other files (path with / written as __)."""
        changes: dict[str, str | None] = {entry_path(packed): entry(packed, spec) for packed, spec in charts}
        changes |= {path.replace("__", "/"): text for path, text in files.items()}
        for packed, _ in charts if push else ():
            self.registry.push_chart("staging", packed, f"{packed.version}_{packed.digest[7:19]}")
        return self.forge.open(self.catalogue.commit(self.catalogue.tip, changes, "submit"))

    def settle(self, number: int) -> str:
        """Rounds until the pull request is closed; the one comment."""
        for _ in range(ROUNDS_MAX):
            self.gate.round()
            if self.forge.pull_requests("all") and self.forge.pulls[number].state == "closed":
                break
        assert self.forge.pulls[number].state == "closed", self.text(number)
        return self.text(number)

    def text(self, number: int) -> str:
        comments = self.forge.said[number]
        assert len(comments) <= 1
        return comments[0].text if comments else ""

    def merged(self, number: int) -> bool:
        return self.forge.pulls[number].merged

    def main(self) -> dict[str, str]:
        return self.catalogue.trees[self.catalogue.tip]


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    yield World(tmp_path)


def status_of(world: World, packed: PackedChart) -> dict:
    return read_mapping(world.main()[entry_path(packed)], "entry")["status"]


def assured(world: World, packed: PackedChart) -> bool:
    """Whether the catalogue's evidence stands as a manager sees it."""
    artefact = Artefact(packed.name, packed.version, packed.digest, "linux/amd64")
    files = {p: t for p, t in world.main().items() if p.startswith(artefact.folder)}
    statements = {
        p.rpartition("/")[2].removesuffix(".json"): world.verifier.verify(t.encode()) for p, t in files.items()
    }
    return assess(artefact, POLICY, status_of(world, packed)["evidence"], statements).assured


# -- published -------------------------------------------------------------------------------------------------------


def test_a_submission_that_passes_is_published_with_its_evidence(world: World) -> None:
    packed, spec = chart()
    head = world.submit((packed, spec), **{"applications/relaying.yaml": application()})
    text = world.settle(head)
    assert world.merged(head)
    assert "## Verified: relay 0.1.0, application relaying" in text
    assert status_of(world, packed)["state"] == "verified"
    assert status_of(world, packed)["policy"] == POLICY.digest
    assert assured(world, packed)
    assert read_catalogue(world.main()).problems == ()
    schema = json.loads(world.main()["charts/relay/0.1.0.schema.json"])
    assert schema["default"] == {"rate": 10}
    assert schema["required"] == ["rate"]
    assert world.main()[f"keys/{world.signer.key_id}.pem"] == world.signer.public_key
    assert world.registry.manifest_digest("verified/relay", f"0.1.0_{packed.digest[7:19]}") == packed.digest
    attached = world.registry.attachments("verified/relay", packed.digest)
    assert {one.annotations["robotkube.io/suite"] for one in attached} == {*SUITES, "summary"}
    folder = f"evidence/relay/0.1.0_{packed.digest[7:19]}"
    assert {sha256(one.data) for one in attached} == {
        sha256(text.encode()) for path, text in world.main().items() if path.startswith(folder)
    }
    assert world.published == 1
