"""Test namespaces in which suites run: one run at a time uses one. Every wait ends with the run's time at the
latest."""

from __future__ import annotations

import math
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.core.lives import Issued
from robotkube.registry.suites.core import namespace_contents as contents
from robotkube.registry.suites.core import pod_descriptions
from robotkube.registry.suites.core.namespace_contents import (
    BROKER_SECRET,
    DATABASE_SECRET,
    HELPER,
    HELPER_PREFIX,
    LABEL,
    HelperPod,
)
from robotkube.registry.suites.ports.suites import NamespaceObjects, Object, PodEnd, PodRun, SuiteAccount

POLL_SECONDS = 0.5
HELPER_START_SECONDS_MAX = 120.0
LOG_BYTES_MAX = 4 * 1024 * 1024
BEGINNING_CHARACTERS = 200
CHART_LOG_BYTES_MAX = 64 * 1024
CHART_LOG_LINES_MAX = 100
PODS_DESCRIBED_MAX = 2
EMPTY_GRACE_SECONDS = 1
BROKER = "suite-broker"
DATABASE = "suite-database"
SCRATCH_USED = "suite-scratch-used"
KEPT_CONFIG_MAPS = frozenset({"kube-root-ca.crt"})


@dataclass(frozen=True)
class SuiteNamespaceSettings:
    """One test namespace, and the images that helpers run there; `database_kind` is mongo, ferretdb or empty (there is
    none). `certify` makes certificates of its broker and database; None: both listen in clear text."""

    namespace: str
    domain_id: int
    agent: str
    observer_image: str
    broker_image: str
    database_kind: str = ""
    database_image: str = ""
    database_arguments: tuple[str, ...] = ()
    certify: Callable[[str], Issued] | None = None


class ClusterTestNamespace:
    """The port SuiteNamespace for one run of at most `seconds`. `make_account` makes `account` in the database at host
    and port, whose administrator is given."""

    def __init__(
        self,
        api: NamespaceObjects,
        settings: SuiteNamespaceSettings,
        seconds: float,
        make_account: Callable[[SuiteAccount, SuiteAccount], None],
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._api = api
        self._settings = settings
        self._make_account = make_account
        self._clock = clock
        self._sleep = sleep
        self._deadline = clock() + seconds
        self._broker: SuiteAccount | None = None
        self._broker_began = ""
        self._database: SuiteAccount | None = None
        self._authorities: list[str] = []
        self._pods_run = 0

    @property
    def namespace(self) -> str:
        """The namespace."""
        return self._settings.namespace

    @property
    def agent(self) -> str:
        """The agent on whose node everything in the test namespace runs."""
        return self._settings.agent

    @property
    def domain_id(self) -> int:
        """ROS_DOMAIN_ID of everything in the test namespace."""
        return self._settings.domain_id

    @property
    def seconds_left(self) -> float:
        """Seconds until the run's time is over."""
        return max(self._deadline - self._clock(), 0.0)

    def provide(self, config_maps: Mapping[str, Mapping[str, str]]) -> None:
        """Make ConfigMaps that the chart finds in the test namespace."""
        for name, data in config_maps.items():
            contents.refuse_name("ConfigMap", name)
            metadata = contents.own_metadata(name)
            self._api.apply({"apiVersion": "v1", "kind": "ConfigMap", "metadata": metadata, "data": dict(data)})

    def apply(self, objects: Sequence[Object]) -> None:
        """Make or replace a chart's objects, none before all of them are known to be allowed."""
        if len(objects) > contents.OBJECTS_MAX:
            raise InputError(f"{len(objects)} objects; a chart may have {contents.OBJECTS_MAX}")
        placed = [contents.placed(item, self.namespace, self.domain_id, self.agent) for item in objects]
        if any(contents.mounts_scratch(_pod_spec(item)) for item in placed):
            self._mark_scratch()
        for item in sorted(placed, key=lambda item: item["kind"] != "ConfigMap"):
            self._api.apply(item)

    def delete(self, objects: Sequence[Object], seconds: float) -> Sequence[PodEnd]:
        """Delete a chart's objects; how its pods went within the time."""
        pods, version = self._api.list("Pod")
        last = {item["metadata"]["name"]: item for item in pods if _is_subject(item)}
        deadline = self._clock() + min(seconds, self.seconds_left)
        for item in objects:
            if item.get("kind") in contents.KINDS:
                self._api.delete(item["kind"], item["metadata"]["name"])
        left = set(last)
        while left and self._clock() < deadline:
            version = self._watch(last, left, version, deadline)
        return [_pod_end(item, item["metadata"]["name"] not in left) for item in last.values()]

    def _watch(self, last: dict[str, Object], left: set[str], version: str, deadline: float) -> str:
        """Watch changes of pods until nothing is left or the watch ends; then list the pods that are still there."""
        for kind, item in self._api.changes("Pod", version, max(deadline - self._clock(), 1.0)):
            name = item["metadata"]["name"]
            if not _is_subject(item):
                continue
            last[name] = item
            left.add(name)
            if kind == "DELETED":
                left.discard(name)
            if not left:
                return version
        pods, version = self._api.list("Pod")
        present = {item["metadata"]["name"]: item for item in pods if _is_subject(item)}
        last.update(present)
        left.intersection_update(present)
        return version

    def wait_ready(self, kind: str, name: str, seconds: float) -> str:
        """Empty when it got ready in time, else what was seen; at once when waiting will not help."""
        judge = pod_descriptions.deployment_ready if kind == "Deployment" else pod_descriptions.pod_ready
        lines = [f"{kind} {name} was not ready after {seconds:.0f} s"]

        def decided() -> bool:
            if self._fits(kind, name, judge):
                lines.clear()
            elif any(map(pod_descriptions.pod_hopeless, self._concerned(kind, name))):
                lines[0] = f"{kind} {name} cannot get ready"
            else:
                return False
            return True

        self._until(decided, seconds)
        if not lines:
            return ""
        if kind == "Deployment":
            lines += pod_descriptions.describe_deployment(self._api.get(kind, name), name)
        return "\n".join([*lines, *self._described(self._concerned(kind, name), kind, name)])

    def _concerned(self, kind: str, name: str) -> list[Object]:
        if kind == "Pod":
            return [item for item in (self._api.get("Pod", name),) if item]
        return [item for item in self.pods() if item["metadata"]["name"].startswith(f"{name}-")]

    def _described(self, pods: Sequence[Object], kind: str, name: str) -> list[str]:
        if not pods:
            reasons = [f"event {item.get('reason')}: {item.get('message')}" for item in self._api.events(kind, name)]
            return list(dict.fromkeys(reasons))[-pod_descriptions.EVENTS_MAX :] or [f"{kind} {name} has no pod"]
        shown = pod_descriptions.in_trouble_last(pods)[-PODS_DESCRIBED_MAX:]
        states = [line for item in shown for line in self._states(item)]
        logs = dict.fromkeys(tuple(pod_descriptions.last_lines(self._container_logs(item))) for item in shown)
        return [*dict.fromkeys(states), *(line for log in logs for line in log)]

    def _states(self, item: Object) -> list[str]:
        return pod_descriptions.describe_pod(item, self._api.events("Pod", item["metadata"]["name"]))

    def pods(self) -> Sequence[Object]:
        """The chart's pods."""
        items, _ = self._api.list("Pod")
        return [item for item in items if _is_subject(item)]

    def logs(self, pod: str) -> str:
        """The last lines of all its containers."""
        item = self._api.get("Pod", pod)
        return self._container_logs(item) if item else ""

    def _container_logs(self, item: Object) -> str:
        """The ends of the logs of all its containers, that of one in trouble last."""
        statuses = pod_descriptions.container_statuses(item)
        statuses.sort(key=lambda status: (not status.get("ready"), status.get("restartCount", 0)))
        logs = (self._container_log(item["metadata"]["name"], status).rstrip("\n") for status in statuses)
        return "".join(f"{log}\n" for log in logs if log)

    def _container_log(self, pod: str, status: Object) -> str:
        """The end of a container's log: of the start that ended, when it runs again and says nothing of that."""
        orders = [False]
        if status.get("restartCount"):
            orders.insert(0 if "running" in (status.get("state") or {}) else 1, True)
        logs = (
            self._api.log(pod, status["name"], CHART_LOG_BYTES_MAX, CHART_LOG_LINES_MAX, previous=previous)
            for previous in orders
        )
        return next(filter(None, logs), "")

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
        """Run a helper pod to its end."""
        self._pods_run += 1
        name = f"{HELPER_PREFIX}{name}-{self._pods_run}"
        volumes = []
        if files:
            self._api.create("ConfigMap", contents.files_map(name, files))
            volumes.append(contents.files_volume(name))
        if volume_claim:
            self._mark_scratch()
            volumes.append(contents.scratch_volume())
        if accounts:
            volumes.append(contents.account_volume())
        seconds = min(seconds, self.seconds_left)
        pod = HelperPod(
            name, image, self.agent, self.domain_id, command,
            volumes=[volume for volume, _ in volumes], mounts=[mount for _, mount in volumes],
            seconds=math.ceil(seconds) + 1,
        )  # fmt: skip
        self._api.create("Pod", pod.document())
        ended = self._until(lambda: self._fits("Pod", name, pod_descriptions.pod_ended), seconds)
        run = self._pod_run(name, bool(ended))
        self._api.delete("Pod", name, EMPTY_GRACE_SECONDS)
        return run

    def _pod_run(self, name: str, ended: bool) -> PodRun:
        item = self._api.get("Pod", name)
        if item is None:
            return PodRun("", None, f"pod {name} is gone")
        log = self._api.log(name, name, LOG_BYTES_MAX)
        codes = pod_descriptions.exit_codes(item)
        if ended and codes.get(name) is not None:
            return PodRun(log, codes[name])
        description = pod_descriptions.describe_pod(item, self._api.events("Pod", name))
        return PodRun(log, None, "\n".join(["it did not end in its time", *description]))

    def start_broker(self) -> SuiteAccount:
        """Start a broker, or the one that runs."""
        if self._broker is None:
            password = secrets.token_urlsafe(24)
            line = contents.password_line("suite", password, secrets.token_bytes(12))
            issued = self._certified(BROKER)
            files = contents.broker_files(line, issued.pair if issued else None)
            self._api.create("Secret", contents.secret(BROKER, files))
            image = self._settings.broker_image
            port = contents.MQTT_TLS_PORT if issued else contents.MQTT_PORT
            host = self._start(contents.broker_pod(BROKER, image, self.agent, self.domain_id, port))
            self._broker = SuiteAccount("suite", password, host, port)
            self._broker_began = self._api.log(BROKER, BROKER, LOG_BYTES_MAX)[:BEGINNING_CHARACTERS]
            self._write_broker_account(self._broker, issued)
        return self._broker

    def _write_broker_account(self, broker: SuiteAccount, issued: Issued | None) -> None:
        """Make what the chart finds in an agent's namespace: the account, and how the broker proves who it is."""
        self._trust(issued)
        self._api.create("Secret", contents.secret(BROKER_SECRET, _account_data(broker) | _proof(BROKER, issued)))

    def _certified(self, name: str) -> Issued | None:
        return self._settings.certify(name) if self._settings.certify is not None else None

    def _trust(self, issued: Issued | None) -> None:
        """Write into the test namespace who signed, beside whoever did before."""
        if issued:
            self._authorities.append(issued.authority)
            self._api.apply(contents.authorities("".join(self._authorities)))

    def start_database(self) -> SuiteAccount:
        """Start a database, or the one that runs."""
        if self._database is None:
            settings = self._settings
            if not settings.database_image:
                raise InputError(
                    "the chart needs a database, and this platform has no image of one to start in a test namespace"
                )
            administrator = {"username": "administrator", "password": secrets.token_urlsafe(24)}
            issued = self._certified(DATABASE)
            self._api.create("Secret", contents.secret(DATABASE, administrator | contents.database_files(issued)))
            pod = contents.database_pod(
                DATABASE, settings.database_kind, settings.database_image, settings.database_arguments, self.agent,
                self.domain_id, tls=issued is not None,
            )  # fmt: skip
            host = self._start(pod)
            name = contents.SUITE_DATABASE
            proof = (DATABASE, issued.authority) if issued else ("", "")
            account = SuiteAccount(name, secrets.token_urlsafe(24), host, pod.port, name, *proof)
            who = (administrator["username"], administrator["password"])
            administrating = SuiteAccount(*who, host, pod.port, "admin", *proof)
            self._make_account(administrating, account)
            self._database = account
            self._trust(issued)
            data = {**_account_data(account), "database": name, "authenticationDatabase": name}
            self._api.create("Secret", contents.secret(DATABASE_SECRET, data | _proof(DATABASE, issued)))
        return self._database

    def _start(self, pod: HelperPod) -> str:
        """Start a helper that stays; its address when it is ready."""
        self._api.create("Pod", pod.document())
        problem = self.wait_ready("Pod", pod.name, HELPER_START_SECONDS_MAX)
        if problem:
            raise UnavailableError(problem)
        return str((self._api.get("Pod", pod.name) or {}).get("status", {}).get("podIP", ""))

    def broker_log(self) -> str:
        """All that the broker wrote; empty without a broker. InputError when its beginning is gone: it shows which
        topics a chart opens, and a flood of messages could hide one."""
        if not self._broker:
            return ""
        text = self._api.log(BROKER, BROKER, LOG_BYTES_MAX)
        if not text.startswith(self._broker_began):
            raise InputError(
                f"the test namespace's broker wrote more than {LOG_BYTES_MAX >> 20} MiB about what the chart does, so "
                "not all of it can be seen; let the chart send less with its test values"
            )
        return text

    def leftovers(self) -> list[str]:
        """The objects in the test namespace that are no helpers'."""
        names = []
        for kind in (*contents.KINDS, "Pod"):
            items, _ = self._api.list(kind)
            names += [f"{kind} {item['metadata']['name']}" for item in items if not _is_own(kind, item)]
        return sorted(names)

    def _mark_scratch(self) -> None:
        """Mark the volume claim as used, so that it is emptied with the test namespace."""
        metadata = contents.own_metadata(SCRATCH_USED)
        self._api.apply({"apiVersion": "v1", "kind": "ConfigMap", "metadata": metadata, "data": {"used": "true"}})

    def _fits(self, kind: str, name: str, judge: Callable[[Object], bool]) -> bool:
        item = self._api.get(kind, name)
        return item is not None and judge(item)

    def _until(self, condition: Callable[[], bool], seconds: float) -> bool:
        deadline = self._clock() + seconds
        while not condition():
            if self.seconds_left <= 0:
                raise UnavailableError(f"{self.namespace}: the time of the whole run is over")
            if self._clock() >= deadline:
                return False
            self._sleep(POLL_SECONDS)
        return True


def _is_subject(item: Object) -> bool:
    return ((item["metadata"].get("labels") or {}).get(LABEL)) not in (None, HELPER)


def _is_own(kind: str, item: Object) -> bool:
    name = item["metadata"]["name"]
    return (item["metadata"].get("labels") or {}).get(LABEL) == HELPER or (
        kind == "ConfigMap" and name in KEPT_CONFIG_MAPS
    )


def _pod_spec(item: Object) -> Object:
    return ((item.get("spec") or {}).get("template") or {}).get("spec") or {}


def _account_data(account: SuiteAccount) -> dict[str, str]:
    return {
        "username": account.username,
        "password": account.password,
        "host": account.host,
        "port": str(account.port),
    }


def _proof(name: str, issued: Issued | None) -> dict[str, str]:
    """How a helper proves who it is: there is no name service in a test namespace, so its certificate is for a name,
    and the account has an address."""
    return {"tls": "required", "server_name": name} if issued else {"tls": "off"}


def _pod_end(item: Object, gone: bool) -> PodEnd:
    metadata = item["metadata"]
    grace = float(metadata.get("deletionGracePeriodSeconds") or item["spec"].get("terminationGracePeriodSeconds") or 0)
    return PodEnd(metadata["name"], _stop_seconds(item, grace), grace, pod_descriptions.exit_codes(item), gone)


def _stop_seconds(item: Object, grace_seconds: float) -> float:
    """Seconds from the request to delete until the last container had ended; 0 when that was not seen."""
    states = [status.get("state") or {} for status in pod_descriptions.container_statuses(item)]
    ends = [state["terminated"]["finishedAt"] for state in states if (state.get("terminated") or {}).get("finishedAt")]
    deletion = item["metadata"].get("deletionTimestamp")
    if not ends or not deletion:
        return 0.0
    requested = datetime.fromisoformat(deletion).timestamp() - grace_seconds
    return max(datetime.fromisoformat(max(ends)).timestamp() - requested, 0.0)
