"""`python3 -m robotkube.delivery.gate`: the gate of the deployment repository, and publication to the catalogue.

Settings: docs/reference/settings.md. Ends with 0 on SIGTERM, 2 when the settings are wrong. The clones stand below
ROBOTKUBE_WORK (default /tmp/gate); they can be lost at any time. `merges` beside them holds records of merges until
their notes stand: for seconds.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotkube.delivery.deployment.adapters.ssh_keys import holds
from robotkube.delivery.deployment.core.merge_records import REFERENCE
from robotkube.delivery.deployment.loops.unchecked_commits import Trust, UncheckedWatch
from robotkube.delivery.gate.adapters.merge_journal import FileJournal
from robotkube.delivery.gate.core.proposal_checks import Proposer
from robotkube.delivery.gate.loops.application_trials import CompositionTrials
from robotkube.delivery.gate.loops.gate import Gate
from robotkube.delivery.gate.loops.gate_statistics import gate_metrics
from robotkube.delivery.gate.loops.merge_records import MergeRecorder
from robotkube.delivery.gate.loops.plan_notes import NoteWriter
from robotkube.delivery.gate.loops.rules import GateSettings
from robotkube.delivery.manager.core.placement.scopes import DeclaredManager, Scope, overlaps
from robotkube.errors import DocumentError, UnavailableError
from robotkube.foundation.certificates.adapters.certificate_authorities import trust
from robotkube.foundation.certificates.settings import read_authorities
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.core.patterns import CHARTS_URL, HTTP_URL, WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.times import second_text
from robotkube.foundation.forge.adapters.git import GitNotes
from robotkube.foundation.forge.adapters.push_hooks import PushRelay, SignedPushHook
from robotkube.foundation.forge.connect import ForgeAddress, read_forge
from robotkube.foundation.forge.core.commit_objects import read_objects
from robotkube.foundation.forge.ports.repositories import MainBranch
from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.adapters.prometheus_series import MetricsPage
from robotkube.foundation.runtime.adapters.webhook_server import Post, Signed, WebServer
from robotkube.foundation.runtime.core.webhook_deliveries import WebhookDelivery
from robotkube.foundation.runtime.process import Process, run
from robotkube.registry.catalogue.adapters.bounded_validation import BoundedSchemas
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue, EvidenceReader
from robotkube.registry.charts.adapters.chart_renderer import PROGRAM, PROGRAM_VARIABLE, ChartRenderer
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.loops.release_images import ReleaseImages, ReleaseObjects
from robotkube.registry.charts.ports import ChartProgram
from robotkube.registry.evidence.adapters.dsse import KeyFile, TrustedKeys
from robotkube.registry.publication.loops.application_verification import ApplicationVerification
from robotkube.registry.publication.loops.publication import PublicationLoop, publication_metrics
from robotkube.registry.publication.loops.submission_reader import PublicationSettings
from robotkube.registry.publication.loops.verification import ChartVerification, VerifyingSettings
from robotkube.registry.suites.adapters.runner_protocol import SuiteRunnerClient
from robotkube.registry.suites.core.requests import SuiteProgress, SuiteRequest
from robotkube.registry.suites.ports.suites import SuiteRunner

GRACE_SECONDS = 5.0
STOP_POLL_SECONDS = 0.2
OBJECTS_PATH = "/objects"
FORMER_KEYS = (files.OCI_REGISTRY,)


@dataclass(frozen=True)
class GateConfiguration:
    """The settings of the process, secrets included: `webhook_secret` is the forge's, `proposer_secrets` are what it
    shares with each account. `suites_url` is empty when there is no suite-runner. `authorities`: a file with those that
    may have signed certificates of suite-runner and managers."""

    listen: files.Listen
    log_level: str
    forge: ForgeAddress
    account: files.Credentials
    branch: str
    hook_url: str
    hook_secret: str
    webhook_secret: str
    proposer_secrets: Mapping[str, str]
    key: Path
    keys: Path
    verifier: str
    suites_url: str
    suites_token: str
    gate: GateSettings
    publication: PublicationSettings
    authorities: Path | None = None


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> GateConfiguration:
    """The configuration in the gate's settings document."""
    keys = ["listen", "log_level", "forge", "oci_registry", "local_builds", "evidence", "hook", "webhook"]
    root = reader.mapping(document, "", keys, ["suites", "reserved_agents", "authorities"])
    forge = root.get("forge") or {}
    access = read_forge(reader, forge, more=["proposers", "publishers"])
    registry = reader.mapping(root.get("oci_registry") or {}, "oci_registry", ["charts", "staging"])
    evidence = reader.mapping(root.get("evidence") or {}, "evidence", ["key", "keys", "verifier"])
    hook = reader.mapping(root.get("hook") or {}, "hook", ["url", "secret"])
    webhook = reader.mapping(root.get("webhook") or {}, "webhook", ["secret"])
    charts_url = reader.word(registry.get("charts"), "oci_registry.charts", CHARTS_URL)
    suites_url, suites_token = _suites(reader, root.get("suites"))
    webhook_secret = files.secret(reader, webhook.get("secret"), "webhook.secret")
    proposers = _proposers(reader, forge.get("proposers"), webhook_secret)
    return GateConfiguration(
        listen=files.listen(reader, root.get("listen"), encrypts=True),
        log_level=files.log_level(reader, root.get("log_level")),
        forge=access.address,
        account=access.account,
        branch=access.branch,
        hook_url=reader.word(hook.get("url"), "hook.url", HTTP_URL),
        hook_secret=files.secret(reader, hook.get("secret"), "hook.secret"),
        webhook_secret=webhook_secret,
        proposer_secrets={proposer.account: secret for proposer, secret in proposers},
        key=Path(reader.word(evidence.get("key"), "evidence.key", files.PATH)),
        keys=Path(reader.word(evidence.get("keys"), "evidence.keys", files.PATH)),
        verifier=reader.word(evidence.get("verifier"), "evidence.verifier", WORD),
        suites_url=suites_url,
        suites_token=suites_token,
        gate=GateSettings(
            account=access.account.username,
            deployment=access.deployment,
            catalogue=access.catalogue,
            proposers=tuple(proposer for proposer, _ in proposers),
            charts_url=charts_url,
            reserved=frozenset(_words(reader, root.get("reserved_agents") or [], "reserved_agents")),
        ),
        publication=PublicationSettings(
            catalogue=access.catalogue,
            publishers=tuple(_words(reader, forge.get("publishers"), "forge.publishers")),
            account=access.account.username,
            staging=_organisation(reader.word(registry.get("staging"), "oci_registry.staging", CHARTS_URL)),
            verified=_organisation(charts_url),
            charts_url=charts_url,
            local_builds=_yes_or_no(reader, root.get("local_builds"), "local_builds"),
        ),
        authorities=read_authorities(reader, root, ""),
    )


def _suites(reader: Reader, value: Any) -> tuple[str, str]:
    """The address and the token of the suite-runner; both empty when there is none."""
    if value is None:
        return "", ""
    suites = reader.mapping(value, "suites", ["url", "token"])
    url = reader.word(suites.get("url"), "suites.url", HTTP_URL)
    return url, files.secret(reader, suites.get("token"), "suites.token")


def _proposers(reader: Reader, value: Any, forge_secret: str) -> list[tuple[Proposer, str]]:
    """The proposers, each with its secret, which is nobody else's: who has it speaks in its name. No namespace has two
    proposers."""
    proposers: list[tuple[Proposer, str]] = []
    for index, item in enumerate(reader.sequence(value, "forge.proposers")):
        path = f"forge.proposers[{index}]"
        entry = reader.mapping(item, path, ["account", "namespaces", "secret"], ["webhook"])
        account = reader.word(entry.get("account"), f"{path}.account", WORD)
        namespaces = frozenset(_words(reader, entry.get("namespaces"), f"{path}.namespaces"))
        webhook = reader.word(entry.get("webhook"), f"{path}.webhook", HTTP_URL, default="")
        secret = files.secret(reader, entry.get("secret"), f"{path}.secret")
        if secret and secret in (forge_secret, *(known for _, known in proposers)):
            problem = "the forge (webhook.secret) or another proposer has the same one; give each a secret of its own"
            reader.problems.append(f"{path}.secret: {problem}")
        proposers.append((Proposer(account, namespaces, webhook), secret))
    scopes = [Scope(frozenset(), proposer.namespaces, frozenset()) for proposer, _ in proposers]
    accounts = [proposer.account for proposer, _ in proposers]
    managers = [DeclaredManager(account, scope) for account, scope in zip(accounts, scopes, strict=True)]
    reader.problems += [f"forge.proposers: {problem}" for problem in overlaps(managers)]
    return proposers


def _words(reader: Reader, value: Any, path: str) -> list[str]:
    items = enumerate(reader.sequence(value, path))
    return [reader.word(item, f"{path}[{index}]", WORD) for index, item in items]


def _organisation(url: str) -> str:
    return url.rpartition("/")[2]


def _yes_or_no(reader: Reader, value: Any, path: str) -> bool:
    if not isinstance(value, bool):
        reader.problems.append(f"{path}: must be true or false")
    return value is True


class _NoRunner:
    """The port SuiteRunner where suites are switched off: nothing new can be verified."""

    def run(self, request: SuiteRequest) -> SuiteProgress:
        """Refuse with UnavailableError, which says what to switch on."""
        raise UnavailableError("this installation has no suite-runner (charts/robotkube, values suites.enabled)")


def build_gate(
    configuration: GateConfiguration,
    work: Path,
    schemas: BoundedSchemas,
    renderer: ChartProgram,
    recorder: MergeRecorder | None = None,
) -> Gate:
    """The gate of the deployment repository on its adapters; nothing is sent yet."""
    forge = configuration.forge
    account = configuration.account
    branch = configuration.branch
    settings = configuration.gate
    secrets = configuration.proposer_secrets
    work.mkdir(parents=True, exist_ok=True)
    main = forge.clone(settings.deployment, account, work / "deployment", branch)
    catalogue = forge.clone(settings.catalogue, account, work / "catalogue", branch)
    hook_secret = configuration.hook_secret.encode()
    registry = OciRegistry(forge.url, account.username, account.password)
    pull_requests = forge.pull_requests(settings.deployment, account, branch)
    folder = work / "deployment"
    return Gate(
        pull_requests,
        main,
        forge.writer(pull_requests, folder, account, account.username, time.time, branch),
        AssuredCatalogue(catalogue, TrustedKeys(configuration.keys)),
        SignedPushHook(configuration.hook_url, hook_secret, f"{forge.url}/{settings.deployment}", branch=branch),
        settings,
        schemas.validate,
        ReleaseImages(registry, configuration.publication.verified, renderer),
        time.monotonic,
        [
            PushRelay(proposer.webhook, secrets[proposer.account].encode(), settings.deployment, branch=branch)
            for proposer in settings.proposers
            if proposer.webhook
        ],
        recorder,
        build_watch(configuration, work, main, recorder),
    )


def build_watch(
    configuration: GateConfiguration, work: Path, main: MainBranch, recorder: MergeRecorder | None
) -> UncheckedWatch:
    """The watch for commits that the gate did not check; what an earlier process was about to merge, it did check."""
    account = configuration.account
    repository = configuration.gate.deployment
    folder = work / "records-read"
    notes = GitNotes(configuration.forge.url, repository, account.username, account.password, folder, REFERENCE)
    watch = UncheckedWatch(main, notes, Trust(repository, TrustedKeys(configuration.keys), holds), time.monotonic)
    for commit in recorder.announced() if recorder else ():
        watch.expect(commit)
    return watch


def build_publication(
    configuration: GateConfiguration, work: Path, gate: Gate, schemas: BoundedSchemas, renderer: ChartProgram
) -> PublicationLoop:
    """The publication loop on adapters of its own, since it runs on a thread of its own; it wakes the gate after each
    publication."""
    url = configuration.forge.url
    account = configuration.account
    branch = configuration.branch
    settings = configuration.publication
    folder = work / "publication"
    work.mkdir(parents=True, exist_ok=True)
    clone = configuration.forge.clone(settings.catalogue, account, folder, branch)
    forge = configuration.forge.pull_requests(settings.catalogue, account, branch)
    signer = KeyFile(configuration.key)
    registry = OciRegistry(url, account.username, account.password, lock=threading.Lock())
    runner: SuiteRunner = _NoRunner()
    if configuration.suites_url:
        runner = SuiteRunnerClient(configuration.suites_url, configuration.suites_token)
    names = VerifyingSettings(
        settings.staging, settings.verified, settings.charts_url, f"{url}/{settings.catalogue}", configuration.verifier
    )
    keys = TrustedKeys(configuration.keys)
    objects = ReleaseObjects(registry, (settings.verified, settings.staging), renderer)
    render = Jinja2Templates().render
    trials = CompositionTrials(EvidenceReader(keys), render, schemas.validate, objects, time.monotonic)
    return PublicationLoop(
        forge,
        clone,
        configuration.forge.writer(forge, folder, account, account.username, time.time, branch),
        registry,
        ChartVerification(registry, signer, keys, runner, names, time.monotonic, _now),
        ApplicationVerification(trials, signer, keys),
        signer,
        settings,
        schemas.tools(),
        time.monotonic,
        lambda: gate.wake("push", {"repository": {"full_name": settings.catalogue}}),
    )


def build_notes(configuration: GateConfiguration, work: Path) -> NoteWriter:
    """The writer that copies managers' outcome comments to Git's notes, on adapters of its own as well."""
    repository = configuration.gate.deployment
    account = configuration.account
    notes = GitNotes(configuration.forge.url, repository, account.username, account.password, work / "notes")
    forge = configuration.forge.pull_requests(repository, account, configuration.branch)
    return NoteWriter(forge, notes, configuration.gate.accounts, time.monotonic)


def build_recorder(configuration: GateConfiguration, work: Path) -> MergeRecorder:
    """The recorder of what the gate merges, on adapters of its own, since it has a thread of its own."""
    address = configuration.forge
    account = configuration.account
    repository = configuration.gate.deployment
    work.mkdir(parents=True, exist_ok=True)
    folder = work / "records"
    return MergeRecorder(
        GitNotes(address.url, repository, account.username, account.password, folder, REFERENCE),
        address.clone(repository, account, folder, configuration.branch),
        FileJournal(work / "merges"),
        KeyFile(configuration.key),
        f"{address.url}/{repository}",
        configuration.verifier,
        _now,
    )


def objects_posts(gate: Gate, repository: str, secrets: Mapping[str, str]) -> dict[str, Signed]:
    """The posts `/objects/<account>`, one for each account that has a secret."""
    return {
        f"{OBJECTS_PATH}/{account}": Signed(secret.encode(), _receive_objects(gate, repository, account))
        for account, secret in secrets.items()
    }


def _receive_objects(gate: Gate, repository: str, account: str) -> Post:
    """The answer to commit objects of `account`: 200, or 400 with what is wrong."""

    def post(body: bytes) -> tuple[int, Mapping[str, Any]]:
        try:
            gate.add_objects(account, read_objects(body, repository))
        except DocumentError as error:
            return 400, {"problems": error.problems}
        return 200, {}

    return post


def build_server(
    configuration: GateConfiguration, gate: Gate, publication: PublicationLoop, notes: NoteWriter
) -> WebServer:
    """The web server: its deliveries wake the loops that they concern."""

    def deliver(delivery: WebhookDelivery) -> None:
        gate.wake(delivery.event, delivery.payload)
        number = (delivery.payload.get("issue") or {}).get("number")
        if delivery.repository == configuration.gate.deployment and isinstance(number, int):
            notes.commented(number)
        publication.wake(delivery.event, delivery.payload)

    return WebServer(
        configuration.listen.address,
        configuration.listen.port,
        lambda: [*gate.reasons_not_ready(), *publication.reasons_not_ready()],
        MetricsPage(lambda: gate_metrics(gate.statistics), lambda: publication_metrics(publication.statistics)).text,
        configuration.webhook_secret.encode(),
        deliver,
        pages={"/decisions": lambda: gate.decisions.as_json(), "/unchecked": lambda: gate.unchecked()},
        signed=objects_posts(gate, configuration.gate.deployment, configuration.proposer_secrets),
        health_port=configuration.listen.health_port,
        certificate=configuration.listen.certificate,
    )


def _now() -> str:
    return second_text(time.time_ns())


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Serve webhooks, health and metrics; run both loops on threads until the process shall end."""
    configuration = files.start_with_settings(process, read_configuration, environment, FORMER_KEYS)
    trust(configuration.forge.authorities, configuration.authorities)
    work = Path(environment.get("ROBOTKUBE_WORK", "/tmp/gate"))  # noqa: S108 - the pod's own volume
    program = environment.get(PROGRAM_VARIABLE, PROGRAM)
    # each loop has tools of its own, so that none waits for the other
    deployment_schemas = BoundedSchemas()
    renderer = ChartRenderer(program)
    catalogue_schemas = BoundedSchemas()
    trial_renderer = ChartRenderer(program)
    recorder = build_recorder(configuration, work)
    gate = build_gate(configuration, work, deployment_schemas, renderer, recorder)
    publication = build_publication(configuration, work, gate, catalogue_schemas, trial_renderer)
    notes = build_notes(configuration, work)
    server = build_server(configuration, gate, publication, notes)
    server.start()
    process.log("started", **server.ports, proposers=len(configuration.gate.proposers))
    stopping = threading.Event()
    runners = (gate, publication, notes, recorder)
    loops = [threading.Thread(target=loop.run, args=(stopping,), daemon=True) for loop in runners]
    for thread in loops:
        thread.start()
    while all(thread.is_alive() for thread in loops) and not process.stopping.wait(STOP_POLL_SECONDS):
        pass
    for loop in runners:
        loop.stop(stopping)
    for thread in loops:
        thread.join(GRACE_SECONDS)
    server.stop()
    deployment_schemas.close()
    catalogue_schemas.close()
    renderer.close()
    trial_renderer.close()


def main() -> None:
    """Run the process until SIGTERM or the end of the work; exit codes as in `foundation.runtime.process`."""
    run("gate", body, grace_seconds=GRACE_SECONDS)


if __name__ == "__main__":
    main()
