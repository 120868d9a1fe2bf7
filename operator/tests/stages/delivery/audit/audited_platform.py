"""The two repositories and the registry of a platform, as real clones in a folder: a short story of releases, signed
for by the gate's own recorder; and the means to manipulate them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pygit2
from pygit2.enums import FileMode

from robotkube.delivery.audit.adapters.manifests import SavedManifests, SavingManifests
from robotkube.delivery.audit.core.report import seconds_text
from robotkube.delivery.audit.loops.auditor import Auditor, Sources
from robotkube.delivery.deployment.adapters.ssh_keys import holds
from robotkube.delivery.deployment.core.break_glass import SIGNERS_PATH
from robotkube.delivery.deployment.core.commit_messages import CommitMessage, write_message
from robotkube.delivery.deployment.core.merge_records import REFERENCE, MergeRecord
from robotkube.delivery.deployment.core.plan_notes import PlanOutcome, ReleaseOutcome, note_text
from robotkube.delivery.deployment.core.releases import Release, Source, TaskCause, write_release, write_source
from robotkube.delivery.gate.adapters.merge_journal import FileJournal
from robotkube.delivery.gate.loops.merge_records import MergeRecorder
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.foundation.forge.adapters.git import GitClone, GitHistory, GitNotes
from robotkube.foundation.forge.adapters.git.notes import REFERENCE as OUTCOMES
from robotkube.registry.charts.core.packing import build_tag
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.evidence.adapters.dsse import TrustedKeys
from robotkube.registry.evidence.core.statements import Artefact
from tests.stages.delivery.gate.people import People
from tests.stages.registry.signed_evidence import (
    CHARTS_URL,
    PLATFORM,
    Remembering,
    application_evidence,
    catalogue,
    published,
    signing_key,
    trusting,
)
from tests.stages.registry.submissions import application

BEGAN = 1_795_000_000  # 2026-11-18T11:06:40Z
NOW = BEGAN + 86_400
MINUTE = 60
SEED_OF_GATE, SEED_OF_STRANGER = 11, 12
SIGN = ("ada", "grace")  # in policies/signers
RECORDER_IMAGE = f"forge.example:3000/robotkube/detector@sha256:{'d' * 64}"
MERGE_POLICY = """\
automatic:
- {author: manager, paths: [releases/, sources/]}
person:
- {paths: [policies/]}
"""
STRICTER = MERGE_POLICY.replace("[policies/]", "[policies/, releases/]")
MEETING = TaskCause("cloud-0/meeting", "event-1", "proximity", "a" * 32, "recording", '{"vehicles":["vehicle-00"]}')
SECOND = TaskCause("cloud-0/second", "event-2", "proximity", "b" * 32, "recording", "{}")


def manifest_of(chart: str) -> bytes:
    """The bytes of a chart's manifest; its digest names the chart."""
    return canonical_json({"schemaVersion": 2, "annotations": {"org.opencontainers.image.title": chart}})


def about(chart: str, version: str = "0.1.0") -> Artefact:
    """A chart version that stands in the registry."""
    return Artefact(chart, version, sha256(manifest_of(chart)), PLATFORM)


APPLICATION = "applications/recording.yaml"
RECORDING = application("recording", "recorder")
RECORDER, BRIDGE = about("recorder"), about("bridge")


class Repository:
    """A bare repository that anybody may write: commits at any time by anybody, references anywhere."""

    def __init__(self, folder: Path) -> None:
        self.git = pygit2.init_repository(str(folder), bare=True, initial_head="main")
        self.folder = folder

    @property
    def tip(self) -> str:
        return str(self.git.references["refs/heads/main"].target)

    def main(self) -> list[str]:
        """Main's commits along first parents, oldest first."""
        commits = [self.tip]
        while self.git[commits[-1]].parent_ids:
            commits.append(str(self.git[commits[-1]].parent_ids[0]))
        return commits[::-1]

    def commit(
        self,
        changes: Mapping[str, str | None],
        message: str,
        at: int,
        author: str = "manager",
        parents: Sequence[str] | None = None,
        move: bool = True,
    ) -> str:
        """A commit on main's tip (or on `parents`); with `move` main goes there, whatever it had."""
        tip = self.git.references.get("refs/heads/main")
        parents = ([str(tip.target)] if tip else []) if parents is None else list(parents)
        tree = self._tree(self.git[parents[0]].tree if parents else None, changes)
        who = pygit2.Signature(author, f"{author}@robotkube.invalid", at, 0)
        commit = str(self.git.create_commit(None, who, who, message, tree, parents))
        if move:
            self.move(commit)
        return commit

    def _tree(self, before: pygit2.Tree | None, changes: Mapping[str, str | None]) -> pygit2.Oid:
        index = pygit2.Index()
        if before is not None:
            index.read_tree(before)
        for path, text in changes.items():
            if text is None:
                index.remove(path)
            else:
                index.add(pygit2.IndexEntry(path, self.git.create_blob(text.encode()), FileMode.BLOB))
        return index.write_tree(self.git)

    def move(self, commit: str, reference: str = "refs/heads/main") -> None:
        self.git.references.create(reference, pygit2.Oid(hex=commit), force=True)

    def text(self, path: str) -> str:
        """A file of main."""
        return bytes(self.git[self.git[self.tip].tree[path].id].data).decode()

    def note(self, reference: str, commit: str) -> str:
        return str(self.git.lookup_note(commit, reference).message)

    def write_note(self, reference: str, commit: str, text: str) -> None:
        """Write a note as anybody with the right could, over an older one too."""
        who = pygit2.Signature("somebody", "somebody@robotkube.invalid", BEGAN, 0)
        self.git.create_note(text, who, who, commit, reference, True)

    def remove_note(self, reference: str, commit: str) -> None:
        who = pygit2.Signature("somebody", "somebody@robotkube.invalid", BEGAN, 0)
        self.git.lookup_note(commit, reference).remove(who, who, reference)

    def rewrite_notes(self, reference: str, texts: Mapping[str, str | None]) -> None:
        """The notes with these changed (None: gone), in a new history of one commit: no trace is left."""
        builder = self.git.TreeBuilder()
        for commit, text in {**self.all_notes(reference), **texts}.items():
            if text is not None:
                builder.insert(commit, self.git.create_blob(text.encode()), FileMode.BLOB)
        who = pygit2.Signature("somebody", "somebody@robotkube.invalid", BEGAN, 0)
        made = self.git.create_commit(None, who, who, "Notes", builder.write(), [])
        self.git.references.create(reference, made, force=True)

    def all_notes(self, reference: str) -> dict[str, str]:
        tree = self.git[self.git.references[reference].target].tree
        return {str(entry.name): bytes(entry.data).decode() for entry in tree}


def release(
    chart: Artefact, evidence: str, namespace: str, name: str, plan: str, *causes: TaskCause, **values: Any
) -> Release:
    return Release(namespace, name, chart.chart, chart.version, chart.digest, values, causes, plan, evidence)


def files_of(found: Release) -> dict[str, str]:
    """A release's file and its source's."""
    source = Source(found.namespace, found.chart, found.digest, f"{CHARTS_URL}/{found.chart}")
    return {found.path: write_release(found), source.path: write_source(source)}


def message_of(found: Release, verb: str = "deploy", kinds: tuple[str, ...] = ()) -> str:
    """The message of a plan that changes one release."""
    chart = ChartReference(found.chart, found.version, found.digest)
    bare = tuple(replace(cause, application="", parameters="{}") for cause in found.causes)
    text = CommitMessage(
        verb, "recording", "vehicle-00 and vehicle-01 are near", found.plan, bare, kinds, (chart,), (found.evidence,)
    )
    return write_message(text.signed("manager", 1))


def plan_id(number: int) -> str:
    return f"20261118-1200{number:02d}-{number:06x}"


@dataclass
class Platform:
    """A platform in `folder`: `forge/robotkube/{deployment,catalogue}.git`, the registry as a layout in `oci`, keys in
    `keys`. `names` are commits of both mains by what they are in the story."""

    folder: Path
    names: dict[str, str] = field(default_factory=dict)

    @property
    def deployment(self) -> Repository:
        return Repository(self.folder / "forge" / "robotkube" / "deployment.git")

    @property
    def catalogue(self) -> Repository:
        return Repository(self.folder / "forge" / "robotkube" / "catalogue.git")

    @property
    def people(self) -> People:
        """Who may sign break-glass commits."""
        return People(self.folder / "people")

    @property
    def index(self) -> Path:
        return self.folder / "oci" / "index.json"

    def copy(self, folder: Path) -> Platform:
        """The same platform once more, to be manipulated."""
        shutil.copytree(self.folder, folder, copy_function=shutil.copyfile)
        return Platform(folder, dict(self.names))

    def audit(
        self,
        word: str = "",
        since: Sequence[str] = (),
        now: int = NOW,
        registry: bool = True,
        former: Sequence[str] = (),
    ) -> dict[str, Any]:
        """The document of an audit."""
        manifests = SavedManifests(self.folder / "oci") if registry else None
        sources = Sources(
            GitHistory(self.deployment.folder),
            GitHistory(self.catalogue.folder),
            Remembering(TrustedKeys(self.folder / "keys")),
            holds,
            manifests,
            "oci" if registry else "",
            since,
            former,
        )
        return Auditor(sources, now).audit(word)

    def recorder(self, at: int) -> MergeRecorder:
        """The gate's recorder, which takes it to be `at` (seconds since 1970)."""
        work = self.folder / "gate"
        forge = (str(self.folder / "forge"), "robotkube/deployment", "gate", "")
        return MergeRecorder(
            GitNotes(*forge, work / "records", REFERENCE),
            GitClone(*forge, work / "records"),
            FileJournal(work / "merges"),
            signing_key(self.folder / "gate-key", SEED_OF_GATE),
            "http://forge.example/robotkube/deployment",
            "robotkube-gate",
            lambda: seconds_text(at),
        )

    def record(self, commit: str, at: int, previous: str = "", way: str = "automatic", *approvals: str) -> None:
        """Have the gate record that it merged a commit."""
        parent = previous or str(self.deployment.git[commit].parent_ids[0])
        author = "operator-team" if approvals else "manager"
        recorder = self.recorder(at)
        record = MergeRecord(commit, parent, author, way, "7", approvals, "", self.catalogue.tip)
        recorder.merged(recorder.expect(record))
        recorder.round()

    def merge(
        self, changes: Mapping[str, str | None], message: str, at: int, way: str = "automatic", *people: str
    ) -> str:
        """A commit that the gate merged and recorded; of `people` the first is its author, the others approved."""
        commit = self.deployment.commit(changes, message, at, people[0] if people else "manager")
        self.record(commit, at + 1, "", way, *people[1:])
        return commit

    def outcome(self, commit: str, found: Release, node: str, images: Sequence[str] = (), at: int = BEGAN) -> None:
        """The outcome of a plan as the note of its commit."""
        seen = ReleaseOutcome(found.key, "Synced", "Healthy", (node,), tuple(images))
        outcome = PlanOutcome(found.plan, commit, at * 10**9, at * 10**9, at * 10**9, (seen,), ())
        self.deployment.write_note(OUTCOMES, commit, note_text(outcome) + "\n")


def make_platform(folder: Path) -> Platform:
    """The story: a bridge from the beginning; a recorder that a task asks for, and withdraws; a person's change of
    policy, approved; a recorder that another task asks for and that runs still."""
    platform = Platform(folder)
    gate = signing_key(folder / "gate-key", SEED_OF_GATE)
    trusting(folder / "keys", gate)
    platform.people.add(*SIGN)
    (folder / "forge" / "robotkube").mkdir(parents=True)
    _publish(platform)
    _deploy(platform)
    _fill_registry(platform)
    return platform


def _publish(platform: Platform) -> None:
    gate = signing_key(platform.folder / "gate-key", SEED_OF_GATE)
    offered = platform.catalogue
    policy = {"policies/release.yaml": "assurance: verified\napplications: verified\n"}
    offered.commit({**catalogue(), **policy}, "seed\n", BEGAN, "administrator")
    for number, (chart, images) in enumerate(((BRIDGE, ()), (RECORDER, (RECORDER_IMAGE,))), 1):
        files = published(gate, chart, images=images)
        if chart is RECORDER:
            tried = ChartReference(chart.chart, chart.version, chart.digest)
            files |= {APPLICATION: RECORDING, **application_evidence(gate, "recording", RECORDING, charts=[tried])}
        platform.names[f"evidence of {chart.chart}"] = sha256(files[f"{chart.folder}/summary.json"].encode())
        message = f"publish: {chart.chart}\n"
        platform.names[f"publish {chart.chart}"] = offered.commit(files, message, BEGAN + number * MINUTE, "gate")


def _deploy(platform: Platform) -> None:
    names, main = platform.names, platform.deployment
    bridge = release(BRIDGE, names["evidence of bridge"], "vehicle-00", "mqtt-bridge", plan_id(1))
    first = release(RECORDER, names["evidence of recorder"], "cloud-0", "recorder-a", plan_id(2), MEETING, seconds=1)
    second = release(RECORDER, names["evidence of recorder"], "cloud-0", "recorder-b", plan_id(5), SECOND)
    at = BEGAN + 10 * MINUTE
    seed = {"policies/merge.yaml": MERGE_POLICY, "releases/.gitkeep": "", SIGNERS_PATH: platform.people.signers(*SIGN)}
    names["seed"] = main.commit(seed, "seed\n", at, "administrator")
    names["bridge"] = platform.merge(files_of(bridge), message_of(bridge, kinds=("initial",)), at + MINUTE)
    platform.outcome(names["bridge"], bridge, "vehicle-00", at=at + 2 * MINUTE)
    names["recorder"] = platform.merge(files_of(first), message_of(first), at + 3 * MINUTE)
    platform.outcome(names["recorder"], first, "cloud-0-node", [RECORDER_IMAGE], at + 4 * MINUTE)
    policy = {"policies/merge.yaml": STRICTER}
    names["policy"] = platform.merge(policy, "policies: ask for more\n", at + 5 * MINUTE, "approval", "ada", "grace")
    gone: dict[str, str | None] = dict.fromkeys(files_of(first))
    withdrawn = replace(first, plan=plan_id(4))
    names["withdrawal"] = platform.merge(gone, message_of(withdrawn, "withdraw"), at + 6 * MINUTE)
    names["second"] = platform.merge(files_of(second), message_of(second), at + 7 * MINUTE)
    platform.outcome(names["second"], second, "cloud-0-node", [RECORDER_IMAGE], at + 8 * MINUTE)


class _Everything:
    def manifest(self, repository: str, reference: str) -> bytes | None:
        return manifest_of(repository.rpartition("/")[2])


def _fill_registry(platform: Platform) -> None:
    saving = SavingManifests(_Everything(), platform.folder / "oci")
    for chart in (RECORDER, BRIDGE):
        for reference in (chart.digest, build_tag(chart.version, chart.digest)):
            saving.manifest(f"verified/{chart.chart}", reference)
    saving.save()


def found(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The findings of a document: kind and what was found."""
    return [(one["finding"], one["what"]) for one in document["findings"]]


def edited(text: str, **changes: Any) -> str:
    """A JSON text with changed keys."""
    return json.dumps({**json.loads(text), **changes}, sort_keys=True)
