"""The walk of a submission to a publication: a gate and a suite-runner, whose one suite passes."""

from __future__ import annotations

import json
import tempfile
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import patch

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from ci.reference.walks.recording import Route, WalkRecorder
from robotkube.foundation.documents.core.digests import canonical_json
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter
from robotkube.foundation.forge.adapters.hosts.gitea import GiteaForge
from robotkube.foundation.forge.ports.pull_requests import PullRequest
from robotkube.foundation.forge.ports.repositories import Commit
from robotkube.foundation.runtime.settings_file import Credentials, Listen
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.core.packing import PackedChart, PulledChart, pack_chart
from robotkube.registry.evidence.adapters.dsse import KeyFile, TrustedKeys
from robotkube.registry.evidence.core.statements import Check, SuiteResult, VerifiedStatement
from robotkube.registry.publication.adapters.submission_folders import validation_tools
from robotkube.registry.publication.core.submissions import (
    STAGING,
    Submission,
    SubmittedChart,
    VerifiedChart,
    publisher_place,
)
from robotkube.registry.publication.loops.application_verification import ApplicationVerification
from robotkube.registry.publication.loops.chart_in_progress import ChartInProgress
from robotkube.registry.publication.loops.publication import PublicationLoop
from robotkube.registry.publication.loops.submission_reader import PublicationSettings, SubmissionInProgress
from robotkube.registry.publication.loops.verification import ChartVerification, VerifyingSettings
from robotkube.registry.suites import run_process
from robotkube.registry.suites.adapters.forked_runs import ForkedSuites
from robotkube.registry.suites.adapters.runner_protocol import RUNS, RunsEndpoint, SuiteRunnerClient
from robotkube.registry.suites.core.requests import (
    SuiteProgress,
    SuiteRequest,
    progress_document,
    read_progress,
    read_request,
    request_document,
)
from robotkube.registry.suites.loops.queue import SuiteQueue
from robotkube.registry.suites.loops.static import StaticSuite
from robotkube.registry.suites.ports.suites import Subject
from robotkube.registry.suites.settings import RunnerConfiguration
from robotkube.testing.publishing import (
    PUBLISHER,
    MemoryCatalogue,
    MemoryCatalogueForge,
    MemoryChartRegistry,
    ScriptedTrials,
)

CHART = "chart-of-the-walk"
VERSION = "0.1.0"
VERIFIED = "verified"
CHARTS = f"oci://forge.example/{VERIFIED}"
TOKEN = "token of the walk"  # noqa: S105
SECONDS_MAX = 30.0
PAUSE_SECONDS = 0.01
SCHEMA = {"type": "object", "properties": {"rate": {"type": "integer"}}}
POLICY = {
    "apiVersion": "registry.robotkube.io/v1alpha1",
    "kind": "VerificationPolicy",
    "metadata": {"name": "default"},
    "spec": {"suites": [{"name": StaticSuite.name, "version": StaticSuite.version, "seconds": 60}]},
}


class Runner:
    """The suite-runner's protocol without a network between."""

    def __init__(self, endpoint: RunsEndpoint) -> None:
        self._endpoint = endpoint

    def run(self, request: SuiteRequest) -> SuiteProgress:
        """Ask as the client does."""
        headers = {"authorization": f"Bearer {TOKEN}"}
        status, answer = self._endpoint.put(f"{RUNS}{request.key}", headers, canonical_json(request_document(request)))
        assert status == 200, answer
        return read_progress(answer)


class Executor:
    """What runs a suite in a process of its own, without one."""

    def __init__(self, configuration: RunnerConfiguration) -> None:
        self._configuration = configuration

    def execute(self, request: SuiteRequest, namespace: str) -> SuiteResult:
        """Run as the process does."""
        document = json.loads(canonical_json(request_document(request)))
        result = run_process.run(self._configuration, read_request(document), namespace)
        progress = read_progress(json.loads(canonical_json(progress_document(SuiteProgress("finished", result)))))
        assert progress.result is not None
        return progress.result

    def stop(self) -> None:
        """Nothing runs beside."""


class Suite:
    """The static suite, which passes."""

    name, version = StaticSuite.name, StaticSuite.version

    def run(self, subject: Subject, namespace: object) -> list[Check]:
        """One check."""
        return [Check("files", True)]


def route() -> Route:
    """The forms of a submission."""
    submitted = (PullRequest, Commit, SubmissionInProgress, Submission, SubmittedChart, PulledChart, ChartInProgress)
    tried = (SuiteRequest, Subject, SuiteResult, VerifiedStatement, VerifiedChart)
    adapters = {
        MemoryCatalogueForge: (GiteaForge,),
        MemoryCatalogue: (ProposalWriter, GitClone),
        MemoryChartRegistry: (OciRegistry,),
        Runner: (SuiteRunnerClient,),
        Executor: (ForkedSuites,),
        Suite: (StaticSuite,),
    }
    trying = (Runner.run, SuiteQueue.put, Executor.execute, Suite.run)
    publishing = (MemoryChartRegistry.copy_chart, MemoryCatalogue.commit)
    return Route((*submitted, *tried), MemoryCatalogue.push_main, adapters, (*trying, *publishing))


def run(recorder: WalkRecorder) -> None:
    """Submit a chart, and record what gate and suite-runner do until it is published."""
    catalogue = MemoryCatalogue(
        {"policies/release.yaml": "assurance: verified\n", "policies/verification.yaml": write_mapping(POLICY)}
    )
    forge = MemoryCatalogueForge(catalogue)
    registry = MemoryChartRegistry()
    queue = SuiteQueue(Executor(_configuration()), [], lambda rule: False)
    with tempfile.TemporaryDirectory() as folder, _without_programs(registry):
        gate = _gate(Path(folder), forge, registry, Runner(RunsEndpoint(TOKEN, queue.put)))
        gate.round()  # writes the key
        packed, entry = _chart()
        registry.push_chart(publisher_place(STAGING, PUBLISHER), packed, f"{VERSION}_{packed.digest[7:19]}")
        submitted = catalogue.commit(catalogue.tip, {f"charts/{CHART}/{VERSION}.yaml": entry}, "submit")
        number = forge.open(submitted)
        deadline = time.monotonic() + SECONDS_MAX
        with recorder.recording():
            queue.start()
            while not recorder.ended and forge.pulls[number].state == "open" and time.monotonic() < deadline:
                gate.round()
                time.sleep(PAUSE_SECONDS)
        queue.stop()


def _gate(folder: Path, forge: MemoryCatalogueForge, registry: MemoryChartRegistry, runner: Runner) -> PublicationLoop:
    private = folder / "gate.key"
    pem = Ed25519PrivateKey.generate().private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    private.write_bytes(pem)
    key = KeyFile(private)
    (folder / "gate.pem").write_text(key.public_key)
    names = VerifyingSettings(STAGING, VERIFIED, CHARTS, "http://forge.example/robotkube/catalogue", "gate")
    verifying = ChartVerification(
        registry, key, TrustedKeys(folder), runner, names, time.monotonic, lambda: "2026-11-21T10:00:00Z"
    )
    settings = PublicationSettings("robotkube/catalogue", (PUBLISHER,), "gate", STAGING, VERIFIED, CHARTS)
    catalogue: Any = forge.catalogue  # of the port it has what publication needs
    tools = validation_tools()
    applications = ApplicationVerification(ScriptedTrials(), key, TrustedKeys(folder))
    return PublicationLoop(
        forge, catalogue, catalogue, registry, verifying, applications, key, settings, tools, time.monotonic
    )


def _without_programs(registry: MemoryChartRegistry) -> Any:
    """A suite's process with the registry in memory, without Helm, and with a suite that passes."""
    return patch.multiple(
        run_process,
        OciRegistry=lambda *account: nullcontext(registry),
        HelmProgram=lambda *place: None,
        static_suite=Suite,
    )


def _configuration() -> RunnerConfiguration:
    nobody = Credentials("", "")
    images = "oci://forge.example/robotkube"
    staging = f"oci://forge.example/{STAGING}"
    forge = "http://forge.example"
    return RunnerConfiguration(Listen("", 0), "info", forge, nobody, staging, CHARTS, images, TOKEN, (), "")


def _chart() -> tuple[PackedChart, str]:
    """A chart, and its entry as it is submitted."""
    spec = {"version": VERSION, "description": "d", "channel": "stable", "platforms": ["linux/amd64"], "images": []}
    metadata = {"apiVersion": "v2", "name": CHART, "version": VERSION}
    files = {
        "Chart.yaml": json.dumps(metadata).encode(),
        "values.yaml": b"rate: 10\n",
        "values.schema.json": json.dumps(SCHEMA).encode(),
        "templates/object.yaml": b"kind: ConfigMap\n",
    }
    packed = pack_chart(CHART, metadata, files, spec)
    status = {"state": "staged", "digest": packed.digest, "images": []}
    head = {"apiVersion": "registry.robotkube.io/v1alpha1", "kind": "ChartVersion", "metadata": {"name": CHART}}
    return packed, write_mapping({**head, "spec": spec, "status": status})
