"""Ports of suites: the gate's suite-runner, the chart under test, and the test namespace that a suite may use."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from robotkube.registry.evidence.core.statements import Artefact, Check, SuiteResult
from robotkube.registry.suites.core.image_contents import LayerContents
from robotkube.registry.suites.core.memory_growth import MemorySample
from robotkube.registry.suites.core.requests import Replaced, SuiteProgress, SuiteRequest

__all__ = [
    "Executor",
    "LayerReader",
    "MemoryReader",
    "NamespaceCleaner",
    "NamespaceObjects",
    "Object",
    "PodEnd",
    "PodRun",
    "Render",
    "Replaced",
    "Subject",
    "Suite",
    "SuiteAccount",
    "SuiteNamespace",
    "SuiteProgress",
    "SuiteRequest",
    "SuiteRunner",
]

Object = Mapping[str, Any]
"""A Kubernetes object."""

Render = Callable[[Mapping[str, Any], str], list[dict[str, Any]]]
"""Values and release name -> the chart's objects, as `helm template` gives them; InputError with helm's words."""


class SuiteRunner(Protocol):
    """The suite-runner as the gate uses it."""

    def run(self, request: SuiteRequest) -> SuiteProgress:
        """Ask for a run, or for its progress: the same key again starts nothing new. UnavailableError when the runner
        does not answer or has no place in its queue, InputError when it refuses the request."""
        ...


@dataclass(frozen=True)
class Subject:
    """The chart under test. `files`: path inside the chart -> content; `archive`: the chart's tgz, byte for byte;
    `images`: image name -> reference, from the chart's images.yaml; `entry`: the ChartVersion document."""

    artefact: Artefact
    entry: Mapping[str, Any]
    files: Mapping[str, bytes]
    archive: bytes
    images: Mapping[str, str]
    render: Render
    replaced: Subject | None = None


@dataclass(frozen=True)
class SuiteAccount:
    """A throw-away account of a broker or database that was started in the test namespace; also in its
    Secret `broker-account` or `database-account`, which the chart may mount. `authority`: the PEM of who signed its
    certificate, which is for `server_name`; empty: it speaks clear text."""

    username: str
    password: str
    host: str
    port: int
    database: str = ""
    server_name: str = ""
    authority: str = ""


@dataclass(frozen=True)
class PodRun:
    """A pod that ran to its end. `log` is its stdout and stderr (bounded: the end is kept); `exit_code` is None when
    it did not end within its time; `problem` is then, or when it never started, what was seen."""

    log: str
    exit_code: int | None
    problem: str = ""

    @property
    def succeeded(self) -> bool:
        """Return whether it ended with 0."""
        return self.exit_code == 0


@dataclass(frozen=True)
class PodEnd:
    """How a pod of the chart went when it was deleted: after how many seconds its containers had ended, with which exit
    codes (None = not seen), and the grace it had asked for. `gone` is False when it was still there at the end."""

    name: str
    seconds: float
    grace_seconds: float
    exit_codes: Mapping[str, int | None]
    gone: bool = True


class SuiteNamespace(Protocol):
    """One emptied namespace of the pool; every method raises UnavailableError when the cluster does not answer, or
    when the time of the whole run is over, and InputError when the API server refuses an object."""

    @property
    def namespace(self) -> str:
        """The namespace."""
        ...

    @property
    def agent(self) -> str:
        """The agent on whose node everything in the test namespace runs."""
        ...

    @property
    def domain_id(self) -> int:
        """ROS_DOMAIN_ID of everything in the test namespace."""
        ...

    @property
    def seconds_left(self) -> float:
        """Seconds until the run's time is over."""
        ...

    def provide(self, config_maps: Mapping[str, Mapping[str, str]]) -> None:
        """Make ConfigMaps (name -> data) that the chart finds there; they count as no leftovers."""
        ...

    def apply(self, objects: Sequence[Object]) -> None:
        """Make the objects, or replace those that are there; in the test namespace, with its domain and label."""
        ...

    def delete(self, objects: Sequence[Object], seconds: float) -> Sequence[PodEnd]:
        """Delete the objects and wait, at most `seconds`, until their pods are gone; how each pod ended."""
        ...

    def wait_ready(self, kind: str, name: str, seconds: float) -> str:
        """Wait until the Deployment's newest pods (kind Deployment) or the Pod are ready: empty when they are, else
        what was seen in words: states, reasons, events and the last lines of the log."""
        ...

    def pods(self) -> Sequence[Object]:
        """The pods of the chart under test (not those of the broker, the database and other helpers)."""
        ...

    def logs(self, pod: str) -> str:
        """The last lines of a pod's log (bounded); empty when it has none."""
        ...

    def run_pod(
        self,
        name: str,
        image: str,
        command: Sequence[str],
        files: Mapping[str, bytes],
        seconds: float,
        volume_claim: bool = False,
        accounts: bool = False,
    ) -> PodRun:
        """Run a pod on the test namespace's node to its end: without a token, Pod Security restricted, `files` (flat
        names) read-only in /suite, at most 900 KiB; an empty command is the image's own. `volume_claim`: the volume
        claim `scratch` at /var/lib/robotkube/scratch; `accounts`: the started broker's account in
        /var/run/secrets/robotkube/broker (username, password, host, port)."""
        ...

    def start_broker(self) -> SuiteAccount:
        """Start an MQTT broker with one account that may do everything; Secret `broker-account`. It takes connections
        when this returns; called again, it gives the same account."""
        ...

    def start_database(self) -> SuiteAccount:
        """Start a database with one account; Secret `database-account`. It answers when this returns; called
        again, it gives the same account."""
        ...

    def broker_log(self) -> str:
        """The broker's whole log since its start (bounded: the end is kept), subscriptions and publications included
        (mosquitto, log_type all)."""
        ...

    def leftovers(self) -> list[str]:
        """The objects of the chart under test that are still there, as `Kind name`, sorted."""
        ...


class NamespaceObjects(Protocol):
    """Kubernetes objects of one namespace of the pool. Kinds: Deployment, ConfigMap, Pod, Secret (no reading).
    UnavailableError when the API server does not answer, InputError when it refuses."""

    def list(self, kind: str) -> tuple[Sequence[Object], str]:
        """The objects, and the position from which changes can be watched."""
        ...

    def get(self, kind: str, name: str) -> Object | None:
        """One object."""
        ...

    def create(self, kind: str, body: Object) -> None:
        """A new object."""
        ...

    def apply(self, body: Object) -> None:
        """Make the object, or make it so; fields that an earlier one of ours had and this has not go."""
        ...

    def delete(self, kind: str, name: str, grace_seconds: int | None = None) -> None:
        """Delete it and what it owns; one that is not there is success."""
        ...

    def log(self, pod: str, container: str, bytes_max: int, lines_max: int = 0, previous: bool = False) -> str:
        """The end of a container's log (`previous`: of its last but one start); empty when there is none."""
        ...

    def events(self, kind: str, name: str) -> Sequence[Object]:
        """The Events of an object, oldest first."""
        ...

    def changes(self, kind: str, version: str, seconds: float) -> Iterator[tuple[str, Object]]:
        """ADDED, MODIFIED or DELETED with the object, from `version` on; ends after `seconds` or sooner."""
        ...


class NamespaceCleaner(Protocol):
    """Empties one test namespace."""

    @property
    def name(self) -> str:
        """The name of the test namespace."""
        ...

    def empty(self, seconds: float) -> None:
        """Delete everything that any run left; returns when nothing is there. UnavailableError when that takes longer,
        or the cluster does not answer."""
        ...


class Executor(Protocol):
    """Runs suites, each so that neither its crash nor its hanging harms the suite-runner."""

    def execute(self, request: SuiteRequest, namespace: str) -> SuiteResult:
        """Run the request's suite, in the test namespace `namespace` (empty: it needs none); its result. Ended when its
        rule's time is over, and then `unfinished`."""
        ...

    def stop(self) -> None:
        """End what runs."""
        ...


class LayerReader(Protocol):
    """Reads what is in layers of container images."""

    def contents(self, digest: str, blob: Callable[[], Iterator[bytes]]) -> LayerContents:
        """The contents of the layer `digest`, whose bytes `blob` gives, as they are stored, when they are needed.
        InputError: they are no layer, or beyond a bound; and whatever `blob` raises."""
        ...


class MemoryReader(Protocol):
    """Measures the memory of pods."""

    def read(self, pods: Sequence[Object]) -> Sequence[MemorySample]:
        """The last measured working set of each of the pods' containers. InputError: this cluster does not let it be
        read; UnavailableError: not now."""
        ...


class Suite(Protocol):
    """One kind of verification."""

    @property
    def name(self) -> str:
        """The suite as the policy names it."""
        ...

    @property
    def version(self) -> str:
        """Changes whenever the suite may judge differently: a kept result counts for one version only."""
        ...

    @property
    def needs_namespace(self) -> bool:
        """Return whether it installs or runs something, and so needs a test namespace."""
        ...

    def run(self, subject: Subject, test_namespace: SuiteNamespace | None) -> Sequence[Check]:
        """Every check with its outcome, at least one. An exception makes the run `unfinished` with its message."""
        ...
