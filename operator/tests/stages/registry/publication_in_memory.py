"""A stage for publication in memory: catalogue, forge, registry, suite-runner and keys, and gates that come and go."""

from pathlib import Path
from typing import Any

from robotkube.foundation.documents.core.digests import sha256
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.registry.catalogue.core.catalogue import read_chart_version
from robotkube.registry.charts.core.packing import PackedChart
from robotkube.registry.evidence.adapters.dsse import KeyFile, TrustedKeys
from robotkube.registry.evidence.core.statements import Artefact, Listing, assess
from robotkube.registry.evidence.core.verification_policy import PATH as POLICY_PATH
from robotkube.registry.evidence.core.verification_policy import read_verification_policy
from robotkube.registry.publication.adapters.submission_folders import validation_tools
from robotkube.registry.publication.loops.application_verification import ApplicationVerification
from robotkube.registry.publication.loops.publication import PublicationLoop
from robotkube.registry.publication.loops.submission_reader import PublicationSettings
from robotkube.registry.publication.loops.verification import ChartVerification, VerifyingSettings
from robotkube.testing.publishing import (
    MemoryCatalogue,
    MemoryCatalogueForge,
    MemoryChartRegistry,
    ScriptedRunner,
    ScriptedTrials,
)
from tests.stages.registry.submissions import CATALOGUE, entry, entry_path, key, trusted

CHARTS_URL = "oci://forge.invalid/verified"
POLICY = read_verification_policy(CATALOGUE[POLICY_PATH])
ROUNDS_MAX = 20


class PublicationStage:
    """Forge, catalogue and OCI registry in memory, which outlive gates: `gate` starts another one."""

    def __init__(self, folder: Path) -> None:
        self.signer = key(folder)
        self.keys = folder / "trusted"
        self.verifier = trusted(self.keys, self.signer)
        self.catalogue = MemoryCatalogue(CATALOGUE)
        self.forge = MemoryCatalogueForge(self.catalogue)
        self.registry = MemoryChartRegistry()
        self.runner = ScriptedRunner()
        self.trials = ScriptedTrials()
        self.now = 100.0
        self.published = 0
        self.local_builds = False
        self.tools = validation_tools()
        self.start().round()  # writes the key

    def start(self, signer: KeyFile | None = None, verifier: TrustedKeys | None = None) -> PublicationLoop:
        settings = VerifyingSettings("staging", "verified", CHARTS_URL, "http://forge/robotkube/catalogue", "the-gate")
        signer = signer or self.signer
        verifying = ChartVerification(
            self.registry,
            signer,
            verifier or self.verifier,
            self.runner,
            settings,
            lambda: self.now,
            lambda: "2026-11-21T10:00:00Z",
        )
        self.gate = PublicationLoop(
            self.forge,
            self.catalogue,
            self.catalogue,
            self.registry,
            verifying,
            ApplicationVerification(self.trials, signer, verifier or self.verifier),
            signer,
            PublicationSettings(
                "robotkube/catalogue", ("publisher",), "gate", "staging", "verified", CHARTS_URL, self.local_builds
            ),
            self.tools,
            lambda: self.now,
            self._count,
        )
        return self.gate

    def _count(self) -> None:
        self.published += 1

    def submit(self, *charts: tuple[PackedChart, dict[str, Any]], push: bool = True, **files: str) -> int:
        """A pull request with these charts and other files."""
        changes: dict[str, str | None] = {entry_path(packed): entry(packed, spec) for packed, spec in charts}
        changes |= files
        for packed, _ in charts if push else ():
            self.registry.push_chart("staging-publisher", packed, f"{packed.version}_{packed.digest[7:19]}")
        message = f"submit {len(self.forge.pulls)}"
        return self.forge.open(self.catalogue.commit(self.catalogue.tip, changes, message))

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


def status_of(stage: PublicationStage, packed: PackedChart) -> dict[str, Any]:
    return read_mapping(stage.main()[entry_path(packed)], "entry")["status"]


def assured(stage: PublicationStage, packed: PackedChart) -> bool:
    """Return whether the catalogue's evidence stands as a manager sees it."""
    artefact = Artefact(packed.name, packed.version, packed.digest, "linux/amd64")
    files = {p: t for p, t in stage.main().items() if p.startswith(artefact.folder)}
    statements = {
        p.rpartition("/")[2].removesuffix(".json"): stage.verifier.verify(t.encode()) for p, t in files.items()
    }
    path = entry_path(packed)
    schema = stage.main()[path.removesuffix(".yaml") + ".schema.json"]
    listing = Listing(read_chart_version(stage.main()[path], path).entry, sha256(schema.encode()))
    return assess(artefact, POLICY, status_of(stage, packed)["evidence"], statements, listing).assured
