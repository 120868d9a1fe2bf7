"""A bootstrapped forge for tests: accounts, repositories, clones that propose, a listener that plays Argo CD."""

import hashlib
import hmac
import json
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import pygit2
import yaml

from robotkube.delivery.deployment.adapters.ssh_keys import holds
from robotkube.delivery.deployment.core.commit_messages import CommitMessage, write_message
from robotkube.delivery.deployment.core.merge_records import REFERENCE
from robotkube.delivery.deployment.core.releases import Release, Source, TaskCause, write_release, write_source
from robotkube.delivery.deployment.loops.unchecked_commits import Trust, UncheckedWatch
from robotkube.delivery.gate.__main__ import OBJECTS_PATH, objects_posts
from robotkube.delivery.gate.core.proposal_checks import Proposer
from robotkube.delivery.gate.loops.gate import Gate
from robotkube.delivery.gate.loops.gate_statistics import gate_metrics
from robotkube.delivery.gate.loops.merge_records import MergeRecorder
from robotkube.delivery.gate.loops.rules import GateSettings
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.foundation.forge.adapters.git import GitClone, GitNotes, ProposalWriter
from robotkube.foundation.forge.adapters.hosts.gitea import GiteaForge
from robotkube.foundation.forge.adapters.push_hooks import ObjectsRelay, PushRelay, SignedPushHook
from robotkube.foundation.runtime.adapters.prometheus_series import series_text
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.charts.ports import RenderedImages
from robotkube.setup.loops.bootstrap import ForgeAccount, ForgeSetup, Organisation, Repository, Webhook
from tests.stages import http_calls
from tests.stages.delivery.manager.manager_process import Outside
from tests.stages.forge.catalogue_evidence import (
    applications,
    key_folder,
    policies,
    published_chart,
    trusted_keys,
    unproved_chart,
)
from tests.stages.paths import REPOSITORY
from tests.stages.programs import free_port

END_SECONDS_MAX = 20.0
VIEWER = "viewer"  # of the embedded cluster alone
ACCOUNTS = (
    *("manager", "gate", "argocd", "publisher", "image-publisher", "suite-runner", "inspector", "nodes", "rights"),
    *("operator-team", "reviewer", VIEWER),
)
PACKAGES: Mapping[str, Mapping[str, str]] = {
    "robotkube": {"image-publisher": "write", "gate": "read", "suite-runner": "read", "nodes": "read"},
    "staging-publisher": {"publisher": "write", "gate": "read", "suite-runner": "read"},
    "staging": {"gate": "write", "suite-runner": "read"},
    "own-images": {"gate": "write", "suite-runner": "read", "nodes": "read"},
    "verified": {"gate": "write", "manager": "read", "argocd": "read", "suite-runner": "read", "inspector": "read"},
}
CHARTS_URL = "oci://forge.robotkube.svc.cluster.local:3000/verified"
WEBHOOK_SECRET = "webhook secret of the gate"  # noqa: S105
HOOK_SECRET = "hook secret"  # noqa: S105
DIGESTS = {
    name: "sha256:" + hashlib.sha256(name.encode()).hexdigest() for name in ("mqtt-bridge", "event-detector", "old")
}
PARAMETERS = '{"vehicles":["vehicle-00","vehicle-01"]}'
CAUSE = TaskCause("cloud-0/pose-1", "e1", "proximity", "0" * 32, "pose-point-cloud-recording", PARAMETERS)
CATALOGUE = {
    "README.md": "catalogue\n",
    **policies(),
    **applications(),
    **published_chart("mqtt-bridge", "0.2.3", DIGESTS["mqtt-bridge"]),
    **published_chart("event-detector", "0.2.3", DIGESTS["event-detector"]),
    **unproved_chart("event-detector", "0.0.9", DIGESTS["old"], "withdrawn"),
}
EVIDENCE = {
    entry["status"]["digest"]: entry["status"].get("evidence", "none")
    for path, text in CATALOGUE.items()
    if path.startswith("charts/") and path.endswith(".yaml") and (entry := yaml.safe_load(text))
}
MERGE_POLICY = (REPOSITORY / "gitops" / "deployment" / "policies" / "merge.yaml").read_text()
DEPLOYMENT = {
    "README.md": "deployment\n",
    "policies/initial.yaml": "add: []\nremove: []\n",
    "policies/merge.yaml": MERGE_POLICY,
    "releases/.gitkeep": "",
}
TERM = 1  # of everybody in these tests; where terms rise, a test has a forge of its own
RESERVED = frozenset({"vehicle-16"})
PROPOSERS = (Proposer("manager", frozenset({"cloud-0", "vehicle-00", "vehicle-01"}) | RESERVED),)


def forge_setup(passwords: Mapping[str, str], gate_url: str, webhook_secret: str = WEBHOOK_SECRET) -> ForgeSetup:
    """The installation as the platform chart declares it."""
    events = ("push", "pull_request")
    return ForgeSetup(
        accounts=tuple(ForgeAccount(name, passwords[name]) for name in ACCOUNTS),
        organisations=tuple(Organisation(name, packages) for name, packages in PACKAGES.items()),
        repositories=(
            Repository(
                "robotkube/deployment",
                "What runs on the fleet",
                "main",
                {path: text.encode() for path, text in DEPLOYMENT.items()},
                {
                    "manager": "read",
                    "gate": "write",
                    "argocd": "read",
                    VIEWER: "pulls",
                    "operator-team": "write",
                    "reviewer": "write",
                },
                ("gate",),
            ),
            Repository(
                "robotkube/catalogue",
                "What may be deployed",
                "main",
                {path: text.encode() for path, text in CATALOGUE.items()},
                {
                    "manager": "read",
                    "gate": "write",
                    "publisher": "read",
                    VIEWER: "pulls",
                    "operator-team": "write",
                    "reviewer": "write",
                },
                ("gate",),
            ),
        ),
        webhooks=(
            Webhook("robotkube/deployment", gate_url, events, webhook_secret),
            Webhook("robotkube/catalogue", gate_url, events, webhook_secret),
        ),
    )


class ApplicationSetController:
    """Takes the push hook as Argo CD's controller does: the signature decides; keeps what it accepted with its time."""

    def __init__(self) -> None:
        self.accepted: list[tuple[float, dict[str, Any]]] = []
        self.refused = 0
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                wanted = "sha256=" + hmac.new(HOOK_SECRET.encode(), body, hashlib.sha256).hexdigest()
                genuine = hmac.compare_digest(self.headers.get("X-Hub-Signature-256", ""), wanted)
                if genuine and self.headers.get("X-GitHub-Event") == "push" and self.path == "/api/webhook":
                    outer.accepted.append((time.monotonic(), json.loads(body)))
                    self.send_response(200)
                else:
                    outer.refused += 1
                    self.send_response(400)
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/api/webhook"

    def announced(self, commit: str) -> bool:
        """Return whether a genuine hook named `commit` as main's new tip."""
        return any(event["after"] == commit for _, event in self.accepted)

    def stop(self) -> None:
        self._server.shutdown()
        self._server.server_close()


class _Account(pygit2.RemoteCallbacks):
    def __init__(self, username: str, password: str) -> None:
        super().__init__(credentials=pygit2.UserPass(username, password))
        self.refusal = ""
        self.words = ""

    def push_update_reference(self, refname: str, message: str | None) -> None:
        self.refusal = message or ""

    def sideband_progress(self, string: str) -> None:
        self.words += string


class Clone:
    """Git as one account uses it: commits made in memory, pushed anywhere, with push options."""

    def __init__(self, url: str, repository: str, username: str, password: str, folder: Path) -> None:
        self.repository = pygit2.init_repository(str(folder), bare=True)
        self.repository.remotes.create("origin", f"{url}/{repository}.git")
        self._account = (username, password)
        self.username = username

    def tip(self) -> str:
        """Main's tip, fetched."""
        main = "+refs/heads/main:refs/heads/main"
        self.repository.remotes["origin"].fetch([main], callbacks=_Account(*self._account))
        return str(self.repository.references["refs/heads/main"].target)

    def commit(self, changes: Mapping[str, str | None], message: str, parents: list[str], mode: int = 0o100644) -> str:
        """A commit on the first of `parents`."""
        index = pygit2.Index()
        index.read_tree(self.repository[parents[0]].tree)
        for path, text in changes.items():
            if text is None:
                index.remove(path)
            else:
                index.add(
                    pygit2.IndexEntry(path, self.repository.create_blob(text.encode()), pygit2.enums.FileMode(mode))
                )
        who = pygit2.Signature(self.username, f"{self.username}@forge.invalid")
        tree = index.write_tree(self.repository)
        return str(self.repository.create_commit(None, who, who, message, tree, parents))

    def push(self, commit: str, reference: str, options: list[str] | None = None, force: bool = False) -> str:
        """Push; the server's refusal with what its hooks said, or empty when it took it."""
        self.repository.references.create("refs/heads/pushed", commit, force=True)
        return self._push(("+" if force else "") + f"refs/heads/pushed:{reference}", options)

    def delete(self, reference: str) -> str:
        """Delete it at the server; its refusal as above."""
        return self._push(f":{reference}", None)

    def _push(self, specification: str, options: list[str] | None) -> str:
        callbacks = _Account(*self._account)
        try:
            self.repository.remotes["origin"].push([specification], callbacks=callbacks, push_options=options)
        except pygit2.GitError as error:
            return (str(error) or "refused") + callbacks.words
        return callbacks.refusal and callbacks.refusal + callbacks.words


@dataclass
class Installation:
    """One forge with everything on it; `client(account)` speaks its API."""

    url: str
    passwords: Mapping[str, str]
    gate_port: int
    folder: Path
    setup: ForgeSetup
    plans: int = 0
    clients: dict[str, httpx.Client] = field(default_factory=dict)

    def client(self, account: str) -> httpx.Client:
        """The API of robotkube/deployment as `account`."""
        if account not in self.clients:
            base = f"{self.url}/api/v1/repos/robotkube/deployment"
            self.clients[account] = http_calls.client(
                base_url=base, auth=(account, self.passwords[account]), timeout=30
            )
        return self.clients[account]

    def disconnect(self) -> None:
        for client in self.clients.values():
            client.close()

    def clone(self, account: str, repository: str = "robotkube/deployment") -> Clone:
        """A new clone as `account`."""
        folder = self.folder / f"clone-{account}-{time.monotonic_ns()}"
        return Clone(self.url, repository, account, self.passwords[account], folder)

    def plan(self) -> str:
        """A plan id nobody had before."""
        self.plans += 1
        return f"20261121-100000-{self.plans:06x}"

    def pull_request(self, number: int) -> dict[str, Any]:
        """As the forge shows it."""
        answer = self.client("gate").get(f"/pulls/{number}")
        answer.raise_for_status()
        return dict(answer.json())

    def close_pull_requests(self) -> None:
        """Close those that are open in either repository, but for what the forge is just marking as merged."""
        client = self.client("gate")
        for repository in ("deployment", "catalogue"):
            pulls = f"{self.url}/api/v1/repos/robotkube/{repository}/pulls"
            for pull in client.get(pulls, params={"state": "open", "limit": 50}).raise_for_status().json():
                answer = client.patch(f"{pulls}/{pull['number']}", json={"state": "closed"})
                if answer.status_code != httpx.codes.PRECONDITION_FAILED:  # merged meanwhile
                    answer.raise_for_status()

    def close(self, number: int) -> None:
        """Close a pull request as its proposer would."""
        self.client("gate").patch(f"/pulls/{number}", json={"state": "closed"}).raise_for_status()

    def comments(self, number: int) -> str:
        """All comments as one text."""
        return "\n".join(item["body"] for item in self.client("gate").get(f"/issues/{number}/comments").json())

    def publish(self, files: Mapping[str, str | None]) -> str:
        """Push files to main of the catalogue as the gate does; the evidence that a chart entry among them names."""
        gate = self.clone("gate", "robotkube/catalogue")
        assert gate.push(gate.commit(files, "publish\n", [gate.tip()]), "refs/heads/main") == ""
        entries = [yaml.safe_load(t) for p, t in files.items() if t and p.startswith("charts/") and p.endswith(".yaml")]
        return next((entry["status"].get("evidence", "none") for entry in entries), "none")

    def propose(self, clone: Clone, commit: str, topic: str) -> int:
        """AGit push; the number of the pull request that opened."""
        refusal = clone.push(commit, "refs/for/main", [f"topic={topic}", "title=a plan"])
        assert refusal == "", refusal
        pulls = self.client("gate").get("/pulls", params={"state": "all", "sort": "recentupdate", "limit": 10}).json()
        return next(int(item["number"]) for item in pulls if item["head"]["sha"] == commit)


def outside(installation: Installation) -> Outside:
    """What a manager's settings name."""
    nowhere = f"http://127.0.0.1:{free_port()}"
    password = installation.passwords["manager"]
    objects = objects_url(installation)
    return Outside(installation.url, password, manager_secret(), key_folder(), CHARTS_URL, nowhere, objects)


def manager_secret(account: str = "manager") -> str:
    """What that manager shares with the forge and the gate."""
    return f"webhook secret of {account}"


def objects_url(installation: Installation, account: str = "manager") -> str:
    """Where the installation's gate takes that manager's objects."""
    return f"http://127.0.0.1:{installation.gate_port}{OBJECTS_PATH}/{account}"


def objects_relay(installation: Installation, account: str = "manager") -> ObjectsRelay:
    """What hands that manager's objects to the installation's gate."""
    return ObjectsRelay(objects_url(installation, account), manager_secret(account).encode(), "robotkube/deployment")


def release_files(made_by: str, name: str = "recorder", **changes: Any) -> dict[str, str | None]:
    """A release of the recorder and its source."""
    release = Release(
        **{
            "namespace": "cloud-0",
            "name": name,
            "chart": "event-detector",
            "version": "0.2.3",
            "digest": DIGESTS["event-detector"],
            "values": {"placement": {"agent": "cloud-0"}},
            "causes": (CAUSE,),
            "plan": made_by,
            "evidence": EVIDENCE.get(changes.get("digest", DIGESTS["event-detector"]), "none"),
            **changes,
        }
    )
    source = Source(release.namespace, release.chart, release.digest, f"{CHARTS_URL}/{release.chart}")
    return {release.path: write_release(release), source.path: write_source(source)}


def message(plan: str, **changes: Any) -> str:
    """The commit message that goes with `release_files`."""
    chart = ChartReference("event-detector", "0.2.3", DIGESTS["event-detector"])
    fields = {
        "verb": "deploy",
        "area": "recording",
        "reason": "test",
        "plan": plan,
        "causes": (CAUSE,),
        "charts": (chart,),
        "manager": "manager",
        "term": TERM,
    }
    evidence = tuple(EVIDENCE.get(one.digest, "none") for one in changes.get("charts", (chart,)))
    return write_message(CommitMessage(**{**fields, "evidence": evidence, **changes}))


def no_images(*_: object) -> tuple[str, ...]:
    """The port RenderedImages where charts have a digest and nothing else: their pods run nothing."""
    return ()


@dataclass
class RunningGate:
    """The gate as its entry point wires it: web server, loop on a thread; `stop` ends both."""

    gate: Gate
    server: WebServer
    thread: threading.Thread
    stopping: threading.Event
    connections: tuple[GiteaForge | SignedPushHook | PushRelay, ...]

    def stop(self) -> None:
        self.gate.stop(self.stopping)
        self.thread.join(END_SECONDS_MAX)
        self.server.stop()
        for connection in self.connections:
            connection.disconnect()


def watch_main(installation: Installation, clone: GitClone, folder: Path) -> UncheckedWatch:
    """A watch on main of the deployment repository for what the gate did not check."""
    repository = "robotkube/deployment"
    account = ("gate", installation.passwords["gate"])
    notes = GitNotes(installation.url, repository, *account, folder / "records-read", REFERENCE)
    return UncheckedWatch(clone, notes, Trust(repository, trusted_keys(), holds), time.monotonic)


def start_gate(
    installation: Installation,
    hook_url: str,
    folder: Path,
    webhooks: bool = True,
    managers: Sequence[str] = (),
    proposers: tuple[Proposer, ...] = PROPOSERS,
    images: RenderedImages = no_images,
    recorder: MergeRecorder | None = None,
) -> RunningGate:
    """A new gate on `folder`; without `webhooks` it only polls; `managers` are the webhooks of account manager's
    processes, which it tells of main; `images` renders releases; `recorder` gets what it merges."""
    account = ("gate", installation.passwords["gate"])
    forge = GiteaForge(installation.url, "robotkube/deployment", *account)
    hook = SignedPushHook(hook_url, HOOK_SECRET.encode(), f"{installation.url}/robotkube/deployment")
    relays = [PushRelay(url, manager_secret().encode(), "robotkube/deployment") for url in managers]
    clone = GitClone(installation.url, "robotkube/deployment", *account, folder / "deployment")
    gate = Gate(
        forge,
        clone,
        ProposalWriter(folder / "deployment", *account, "gate", time.time),
        AssuredCatalogue(
            GitClone(installation.url, "robotkube/catalogue", *account, folder / "catalogue"), trusted_keys()
        ),
        hook,
        GateSettings("gate", "robotkube/deployment", "robotkube/catalogue", proposers, CHARTS_URL, RESERVED),
        validate,
        images,
        time.monotonic,
        relays,
        recorder,
        watch_main(installation, clone, folder),
    )
    server = WebServer(
        "127.0.0.1",
        installation.gate_port if webhooks else 0,
        gate.reasons_not_ready,
        lambda: series_text(gate_metrics(gate.statistics)),
        WEBHOOK_SECRET.encode(),
        lambda delivery: gate.wake(delivery.event, delivery.payload),
        signed=objects_posts(gate, "robotkube/deployment", {p.account: manager_secret(p.account) for p in proposers}),
    )
    stopping = threading.Event()
    thread = threading.Thread(target=gate.run, args=(stopping,), daemon=True)
    server.start()
    thread.start()
    return RunningGate(gate, server, thread, stopping, (forge, hook, *relays))
