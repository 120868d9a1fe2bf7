"""The ports: what services need of the world, one marked section per part; adapters and `testing` implement them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from robotkube.domain.bags import BagTopic, LedgerState
from robotkube.domain.detector_settings import TopicSettings
from robotkube.domain.observation import ApplicationState, PodState
from robotkube.domain.placement import NodeState
from robotkube.domain.recordings import Received, SegmentPlace, Write

# ---------------------------------------------------------------------------------------------------------------------
# Git: deployment repository and catalogue repository
# ---------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Commit:
    """A commit as its reader sees it. `changes` is the difference to the first parent: path -> new text, None =
    removed; a path whose new content is not a text file of ordinary mode stands in `irregular`."""

    id: str
    parents: tuple[str, ...]
    message: str
    author: str
    changes: Mapping[str, str | None]
    irregular: tuple[str, ...] = ()


class RepositoryFiles(Protocol):
    """A branch `main` that can be read."""

    def fetch(self) -> str:
        """Bring main's tip here and return its commit id (40 hex). UnavailableError when the forge does not answer."""
        ...

    def files(self, commit: str, folders: Sequence[str]) -> Mapping[str, str]:
        """Path -> text of every file below `folders` in `commit`."""
        ...


class Catalogue(RepositoryFiles, Protocol):
    """The catalogue repository: applications/, charts/, policies/."""


class DeploymentRepository(RepositoryFiles, Protocol):
    """Main of the deployment repository as the manager reads it."""

    def contains(self, commit: str) -> bool:
        """Whether `commit`, which is here, is main's tip or one of its ancestors."""
        ...

    def log(self, since: str | None, commits_max: int) -> Sequence[Commit]:
        """The newest `commits_max` commits of main after `since` (exclusive; None = from the first), oldest first."""
        ...


class Proposals(Protocol):
    """What the manager may write: commits of its own, proposed as pull requests; never main."""

    def commit(self, parent: str, changes: Mapping[str, str | None], message: str) -> str:
        """Make a commit on `parent`, which was fetched (path -> text, None removes), in memory; its id."""
        ...

    def propose(self, commit: str, topic: str, title: str, body: str) -> int | None:
        """Open a pull request for exactly that commit; its number when the forge's answer names it, else None.

        UnavailableError when the forge does not answer, RefusalError(ProposalRefused) when it says no."""
        ...


class MainBranch(RepositoryFiles, Protocol):
    """The deployment repository as the gate sees it."""

    @property
    def tip(self) -> str:
        """Main's tip as last fetched or pushed; empty before the first fetch."""
        ...

    def proposal(self, number: int) -> Commit:
        """The head commit of a pull request, fetched together with main."""
        ...

    def contains(self, commit: str) -> bool:
        """Whether `commit` is main's tip or one of its ancestors."""
        ...

    def push_main(self, commit: str) -> bool:
        """Move main to `commit` (its parent must be main's tip); False when main has moved meanwhile."""
        ...

    def log(self, since: str | None, commits_max: int) -> Sequence[Commit]:
        """Commits of main after `since` (exclusive; None = from the first), oldest first."""
        ...


# ---------------------------------------------------------------------------------------------------------------------
# Forge
# ---------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PullRequest:
    """A pull request of the deployment repository. `state` is open or closed; `head` the proposed commit;
    `merge_commit` main's commit when merged; `topic` the plan's id for proposals of the manager."""

    number: int
    url: str
    title: str
    author: str
    state: str
    head: str
    merged: bool
    merge_commit: str = ""
    topic: str = ""


@dataclass(frozen=True)
class Comment:
    """A comment on a pull request."""

    author: str
    text: str


class Forge(Protocol):
    """Pull requests of the deployment repository; all methods raise UnavailableError when the forge is away."""

    def pull_request(self, number: int) -> PullRequest:
        """One pull request by its number."""
        ...

    def pull_requests(self, state: str = "open", author: str = "") -> Sequence[PullRequest]:
        """Pull requests against main, newest first, at most 50; `state` is open, closed or all; `author` narrows."""
        ...

    def comments(self, number: int) -> Sequence[Comment]:
        """Comments of a pull request, oldest first."""
        ...

    def comment(self, number: int, text: str) -> None:
        """Add a comment (Markdown)."""
        ...

    def close(self, number: int) -> None:
        """Close a pull request without merging it."""
        ...


# ---------------------------------------------------------------------------------------------------------------------
# Argo CD
# ---------------------------------------------------------------------------------------------------------------------


class PushHook(Protocol):
    """Telling Argo CD that main moved; best effort and bounded."""

    def hook(self, before: str, after: str) -> bool:
        """Send the signed, GitHub-shaped push event of main to the ApplicationSet controller; whether it was taken."""
        ...


class ArgoCD(Protocol):
    """Asking Argo CD to look again; both calls are best effort and bounded, and say whether they were heard."""

    def hook(self, before: str, after: str) -> bool:
        """Send the signed, GitHub-shaped push event of main to the ApplicationSet controller."""
        ...

    def refresh(self, application: str) -> bool:
        """GET the Application with refresh=normal."""
        ...


# ---------------------------------------------------------------------------------------------------------------------
# Cluster: what the manager reads of Kubernetes, and the tasks
# ---------------------------------------------------------------------------------------------------------------------


class TaskStore(Protocol):
    """TaskDescriptions of all agents' namespaces."""

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        """The objects as Kubernetes holds them now (those being deleted included)."""
        ...

    def patch_status(self, namespace: str, name: str, status: Mapping[str, Any]) -> bool:
        """Replace the given fields of the status; False when the task is gone."""
        ...


class Cluster(Protocol):
    """What the manager sees of the cluster; values are snapshots kept up to date by watches."""

    def nodes(self) -> Sequence[NodeState]:
        """Nodes of agents."""
        ...

    def applications(self) -> Mapping[str, ApplicationState]:
        """Argo CD Applications by name."""
        ...

    def pods(self, release: str) -> Sequence[PodState]:
        """Pods of a release, named `<namespace>/<release>` (label app.kubernetes.io/instance)."""
        ...


# ---------------------------------------------------------------------------------------------------------------------
# Recordings: database, segments on the claim, spool
# ---------------------------------------------------------------------------------------------------------------------


class RecordingStore(Protocol):
    """The database of one agent's recordings. Every method raises UnavailableError when it does not answer."""

    def begin(self, recording: str, document: Mapping[str, Any], volume: str) -> None:
        """Make the recording's document, or take up an existing one: `ended` becomes null, `volume` is added."""
        ...

    def known(self, recording: str) -> Iterable[tuple[str, int, str]]:
        """Topic, stamp and SHA-256 of every message that is stored already."""
        ...

    def write(self, writes: Sequence[Write]) -> None:
        """Do all writes; returns when the database has acknowledged them."""
        ...

    def ping(self) -> None:
        """Returns when the database answers with this account."""
        ...

    def close(self) -> None:
        """Give the connections back."""
        ...


class RecordingReader(Protocol):
    """Reading access to a database of recordings. Every method raises UnavailableError when it does not answer."""

    def recordings(self) -> Sequence[Mapping[str, Any]]:
        """The documents of `recordings`, oldest first."""
        ...

    def buckets(self, recording: str) -> Iterable[Mapping[str, Any]]:
        """The documents of `samples` that belong to the recording."""
        ...

    def index(self, recording: str) -> Iterable[Mapping[str, Any]]:
        """The documents of `segments_index` that belong to the recording."""
        ...


class Segments(Protocol):
    """Appends large messages to MCAP files of one recording."""

    def append(self, message: Received, type_name: str) -> SegmentPlace:
        """Write one message; it is safe only after the next `synchronise`. OSError when the volume refuses."""
        ...

    def synchronise(self) -> None:
        """Returns when everything appended is on the disk."""
        ...

    def close(self) -> None:
        """Finish the open file (index and footer)."""
        ...


class SegmentReader(Protocol):
    """Reads messages back from the segments of all volumes within reach."""

    def read(self, volume: str, place: SegmentPlace, size: int) -> bytes:
        """The message's bytes; UnavailableError when the volume is not within reach or the file has no such message."""
        ...


class Spool(Protocol):
    """Writes that the database has not taken yet, kept on the claim."""

    def put(self, recording: str, writes: Sequence[Write]) -> None:
        """Keep them; returns when they are on the disk. OSError when the volume refuses."""
        ...

    def batches(self) -> Sequence[str]:
        """Names of what is kept, oldest first."""
        ...

    def read(self, batch: str) -> Sequence[Write]:
        """The writes of one batch."""
        ...

    def remove(self, batch: str) -> None:
        """Forget a batch that was written."""
        ...


# ---------------------------------------------------------------------------------------------------------------------
# Bootstrap: every `make_*`, `patch_*`, `set_*` looks first and says whether it changed anything
# ---------------------------------------------------------------------------------------------------------------------


class ForgeAdministration(Protocol):
    """The forge as its administrator; UnavailableError when it does not answer, InputError when it refuses."""

    def answers(self) -> bool:
        """False (nothing changes) when it serves and knows the administrator; UnavailableError before."""
        ...

    def make_account(self, name: str, password: str) -> bool:
        """An account with that password."""
        ...

    def make_organisation(self, name: str) -> bool:
        """A private organisation."""
        ...

    def make_repository(self, repository: str, description: str, branch: str) -> bool:
        """A private, empty repository with pull requests and linear history."""
        ...

    def seed(self, repository: str, branch: str, files: Mapping[str, bytes]) -> bool:
        """The first commit, only when the repository is empty."""
        ...

    def protect(self, repository: str, branch: str, pushers: Sequence[str]) -> bool:
        """Only `pushers` push the branch, nobody by force; nobody makes tags."""
        ...

    def make_team(
        self, organisation: str, team: str, units: Mapping[str, str], members: frozenset[str], repository: str
    ) -> bool:
        """A team with exactly these members and units; for one repository, or for none when it is empty."""
        ...

    def make_webhook(self, repository: str, url: str, events: Sequence[str], secret: str) -> bool:
        """Signed deliveries, one webhook per repository and url."""
        ...


class DatabaseAdministration(Protocol):
    """The database as its administrator."""

    def answers(self) -> bool:
        """False (nothing changes) when it serves and knows the administrator; UnavailableError before."""
        ...

    def make_account(self, database: str, username: str, password: str) -> bool:
        """An account of `database` with readWrite on it and nothing else."""
        ...


class ArgoCDConfiguration(Protocol):
    """Argo CD's own objects in its namespace; UnavailableError when they or the API server are not there yet."""

    def answers(self) -> bool:
        """False (nothing changes) when Argo CD has made its secret's server.secretkey; UnavailableError before."""
        ...

    def patch_config_map(self, name: str, data: Mapping[str, str]) -> bool:
        """Set keys of a ConfigMap."""
        ...

    def patch_secret(self, data: Mapping[str, str]) -> bool:
        """Set keys of argocd-secret."""
        ...

    def set_password(self, account: str, password: str) -> bool:
        """Set a local account's password unless the stored hash fits it."""
        ...

    def close_project(self, name: str) -> bool:
        """Make an AppProject allow nothing."""
        ...

    def restart_on(self, deployment: str, secret: str) -> bool:
        """Restart a Deployment when, and only when, `secret` differs from the one it was last restarted for."""
        ...


# ---------------------------------------------------------------------------------------------------------------------
# Teardown: all releases end before the platform goes
# ---------------------------------------------------------------------------------------------------------------------


class InstalledReleases(Protocol):
    """What Argo CD made of the deployment repository; UnavailableError when the API server does not answer."""

    def withdraw(self) -> bool:
        """Delete the ApplicationSet, and by that its Argo CD Applications; False when there was none."""
        ...

    def remaining(self) -> Sequence[str]:
        """Names of the Argo CD Applications that are still there."""
        ...


# ---------------------------------------------------------------------------------------------------------------------
# Event detector: live topics, own tasks
# ---------------------------------------------------------------------------------------------------------------------


class TopicInput(Protocol):
    """One subscription."""

    @property
    def lost(self) -> int:
        """Messages that the middleware dropped before they were drained."""
        ...

    def drain(self, messages_max: int) -> Sequence[tuple[bytes, int]]:
        """What arrived since the last call, oldest first: serialised message and time of reception in ns."""
        ...

    def close(self) -> None:
        """Give the subscription back."""
        ...


class LiveTopics(Protocol):
    """The ROS graph as a detector sees it."""

    def subscribe(self, topic: str, settings: TopicSettings) -> TopicInput:
        """Subscribe; DocumentError when there is no such message type."""
        ...

    def visible(self) -> Mapping[str, Sequence[str]]:
        """Topic -> types of every topic that has a publisher or subscriber now."""
        ...


class OwnTasks(Protocol):
    """The TaskDescriptions of a detector's own namespace. UnavailableError when the API server does not answer,
    RefusalError when it says no."""

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        """All of them."""
        ...

    def create(self, task: Mapping[str, Any]) -> None:
        """Make the object; one of that name that is there already is success."""
        ...

    def delete(self, name: str) -> None:
        """Delete the object; one that is not there is success."""
        ...


# ---------------------------------------------------------------------------------------------------------------------
# Robots' data: topics of the node's ROS network
# ---------------------------------------------------------------------------------------------------------------------


class MessageSource(Protocol):
    """A subscription that hands out serialised messages (CDR with its encapsulation)."""

    @property
    def matched(self) -> int:
        """Publishers that are connected now."""
        ...

    def take(self, messages_max: int = 1000) -> list[bytes]:
        """The messages that wait, oldest first, at most `messages_max`; never blocks."""
        ...

    def close(self) -> None:
        """Stop receiving."""
        ...


class MessageSink(Protocol):
    """A publisher of serialised messages."""

    @property
    def matched(self) -> int:
        """Subscriptions that are connected now."""
        ...

    def publish(self, data: bytes) -> None:
        """Send one message. UnavailableError when the middleware cannot take it now."""
        ...

    def close(self) -> None:
        """Stop sending."""
        ...


class RobotNetwork(Protocol):
    """The ROS network of this node; all methods belong to one thread. InputError: unknown type or bad topic name."""

    def subscribe(
        self, topic: str, type_name: str, reliability: str = "reliable", durability: str = "volatile", depth: int = 1000
    ) -> MessageSource:
        """Begin to receive a topic."""
        ...

    def advertise(
        self, topic: str, type_name: str, reliability: str = "reliable", durability: str = "volatile", depth: int = 1000
    ) -> MessageSink:
        """Begin to offer a topic."""
        ...


# ---------------------------------------------------------------------------------------------------------------------
# MQTT: one connection of a bridge
# ---------------------------------------------------------------------------------------------------------------------


class ChannelEvents(Protocol):
    """What a connection tells its owner, from within `FrameChannel.turn`."""

    def connected(self, session_kept: bool) -> None:
        """The broker took the connection; `session_kept`: it still knows this client's subscriptions."""
        ...

    def disconnected(self) -> None:
        """The connection is gone."""
        ...

    def acknowledged(self, token: int, heard: bool) -> None:
        """The broker has the frame of this token; `heard`: it has subscribers for it."""
        ...

    def received(self, topic: str, payload: bytes) -> None:
        """A frame arrived."""
        ...

    def refused(self, topic: str, reason: str) -> None:
        """The broker refuses a subscription."""
        ...


class FrameChannel(Protocol):
    """A connection to the broker that is made, and made again, by turning it. One thread, nothing blocks."""

    @property
    def complaint(self) -> str | None:
        """None while connected, else why not."""
        ...

    def turn(self, now: float) -> None:
        """Connect when that is due, read all that arrived, write what waits. `now` in monotonic seconds."""
        ...

    def publish(self, topic: str, payload: bytes, retained: bool) -> int | None:
        """Hand over a frame with QoS 1; the token of its acknowledgement, or None when it was not taken."""
        ...

    def subscribe(self, topics: Sequence[str]) -> None:
        """Subscribe with QoS 1; subscriptions do not outlive a lost connection."""
        ...

    def unsubscribe(self, topics: Sequence[str]) -> None:
        """End subscriptions."""
        ...

    def flush(self) -> None:
        """Write what `publish`, `subscribe` and `unsubscribe` left, as far as the network takes it."""
        ...

    def close(self) -> None:
        """Say good-bye."""
        ...


# ---------------------------------------------------------------------------------------------------------------------
# Player: bag, ledgers, clock
# ---------------------------------------------------------------------------------------------------------------------


class Bag(Protocol):
    """Recorded messages with times from the start of the run."""

    @property
    def topics(self) -> Sequence[BagTopic]:
        """The topics in the bag."""
        ...

    def messages(self) -> Iterable[tuple[str, int, bytes]]:
        """Topic, offset in ns and serialised message, offsets ascending. InputError where the bag is damaged."""
        ...


class Ledgers(Protocol):
    """One append-only ledger per run and topic."""

    def open(self, run: str, topic: str) -> LedgerState:
        """Open for appending; what is there already. A torn last line is cut off. InputError when it cannot be."""
        ...

    def append(self, topic: str, line: str) -> None:
        """Add a line to the open ledger of the topic; kept in memory until `flush`."""
        ...

    def flush(self) -> None:
        """Write what was appended."""
        ...

    def close(self) -> None:
        """Flush and close all ledgers of the run."""
        ...


class Clock(Protocol):
    """The shared clock of all players."""

    def now(self) -> int:
        """Time in ns since 1970."""
        ...

    def sleep(self, nanoseconds: int) -> None:
        """Return after that time, or earlier."""
        ...
