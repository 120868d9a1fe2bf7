"""Leader election between the processes of one manager, on a Lease (coordination.k8s.io/v1) with optimistic locking.

    holderIdentity    who leads and where it serves HTTP, `<pod>_<host>:<port>`; empty when it left in good order
    leaseTransitions  the term: one more at every take-over, also by another process of the same pod

charts/robotkube makes the Lease; the manager may only change it.

The client library's own election is not used: it works on a ConfigMap, counts no transitions and cannot be ended.
A leader writes as long as its last successful renewal began less than HOLD_SECONDS ago by its own clock; others wait
LEASE_SECONDS without any renewal, by theirs. So no two lead at once as long as clocks run alike, whatever they show.
A process that stood still in between is stopped by its term, which the gate compares with main.
"""

from __future__ import annotations

import logging
import random
import threading
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import urllib3
from kubernetes import client

from robotkube.backoffs import Random, backoff
from robotkube.errors import InputError, RobotKubeError, UnavailableError
from robotkube.writes import writes

LEASE_SECONDS = 8
HOLD_SECONDS = 6.0
RENEW_SECONDS = 2.0
RETRY_SECONDS_FIRST = 0.5  # after a failure, at most RENEW_SECONDS
REQUEST_SECONDS_MAX = 3.0
NOT_FOUND = 404
CONFLICT = 409

log = logging.getLogger(__name__)


def identity_of(pod: str, host: str, port: int) -> str:
    """The identity that a pod that serves HTTP at `host` (an address of IPv4 or IPv6, or a name) writes
    as holder."""
    return f"{pod}_[{host}]:{port}" if ":" in host else f"{pod}_{host}:{port}"


@dataclass(frozen=True)
class _LeaseState:
    """A Lease as it was read, and when it was first seen so (monotonic seconds)."""

    version: str
    holder: str
    term: int
    at: float


class LeaseElection:
    """The port Leadership for the Lease `namespace`/`name`; `identity` is this pod's (see `identity_of`). `monotonic`
    is a clock in seconds that never goes back, `now` the time of day, `changed` is called when this process begins or
    ceases to lead.

    `start` elects on a thread of its own; `stop` gives the Lease back."""

    def __init__(
        self,
        api: client.ApiClient,
        namespace: str,
        name: str,
        identity: str,
        monotonic: Callable[[], float],
        now: Callable[[], datetime],
        changed: Callable[[], None],
        jitter: Random = random.random,
    ) -> None:
        self._leases = client.CoordinationV1Api(api)
        self._namespace = namespace
        self._name = name
        self._identity = identity
        self._monotonic = monotonic
        self._now = now
        self._changed = changed
        self._jitter = jitter
        self._stopping = threading.Event()
        self._woken = threading.Event()
        self._thread: threading.Thread | None = None
        self._seen: _LeaseState | None = None
        self._term = 0
        self._held_until = float("-inf")
        self._floor = 0
        self.complaint = "no election was held yet"

    def term(self) -> int | None:
        """The term while this process leads."""
        leads = self._monotonic() < self._held_until and self._term > self._floor
        return self._term if leads else None

    def leader(self) -> str | None:
        """The address at which the holder serves, as long as its Lease lasts."""
        seen = self._seen
        if seen is None or seen.holder == self._identity or self._monotonic() - seen.at > LEASE_SECONDS:
            return None
        return seen.holder.rpartition("_")[2] or None

    def overtake(self, term: int) -> None:
        """Be elected with a term above this one."""
        if term > self._floor:
            self._floor = term
            self._woken.set()

    def start(self) -> None:
        """Begin on a thread of its own."""
        self._thread = threading.Thread(target=self._run, name=f"election {self._name}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the election; a leader gives its Lease back, so that the next one need not wait for its end."""
        self._stopping.set()
        self._woken.set()
        if self._thread is not None:
            self._thread.join(2 * REQUEST_SECONDS_MAX)
        if self.term() is not None and self._seen is not None:
            self._held_until = float("-inf")
            try:
                self._write(self._seen, "", self._term)
            except RobotKubeError as error:
                log.warning("lease not given back lease=%s reason=%s", self._name, error)

    def _run(self) -> None:
        failures = 0
        while not self._stopping.is_set():
            led = self.term()
            self._woken.clear()
            try:
                self.try_to_lead()
                failures = 0
            except RobotKubeError as error:
                failures += 1
                self.complaint = str(error)
                log.warning("election failed lease=%s reason=%s", self._name, error)
            if self.term() != led:
                log.info("leading lease=%s term=%s", self._name, self.term())
                self._changed()
            pause = (
                backoff(failures - 1, RETRY_SECONDS_FIRST, RENEW_SECONDS, self._jitter) if failures else RENEW_SECONDS
            )
            self._woken.wait(pause)

    def try_to_lead(self) -> None:
        """Renew, take over, or see that another one leads. UnavailableError, InputError: it is not known who leads."""
        began = self._monotonic()
        seen = self._seen = self._read()
        mine = seen.holder == self._identity and seen.term == self._term
        free = seen.holder in ("", self._identity) or began - seen.at > LEASE_SECONDS
        if mine and seen.term > self._floor:
            written = self._write(seen, self._identity, self._term)
        elif free:
            written = self._write(seen, self._identity, max(seen.term, self._floor) + 1)
        else:
            self.complaint = f"{seen.holder} leads"
            return
        if written is not None:
            self._seen = written
            self._term = written.term
            self._held_until = began + HOLD_SECONDS
            self.complaint = ""

    def _read(self) -> _LeaseState:
        lease = self._call(self._leases.read_namespaced_lease, self._name, self._namespace)
        if lease is None:
            raise UnavailableError(f"lease {self._namespace}/{self._name} is missing; charts/robotkube makes it")
        spec = lease.spec
        version = lease.metadata.resource_version
        if self._seen is not None and self._seen.version == version:
            return self._seen
        if spec is None:
            return _LeaseState(version, "", 0, self._monotonic())
        return _LeaseState(version, spec.holder_identity or "", spec.lease_transitions or 0, self._monotonic())

    @writes("lease")
    def _write(self, seen: _LeaseState, holder: str, term: int) -> _LeaseState | None:
        """Put holder and term into the Lease as it was seen; None when another process was faster."""
        now = self._now().strftime("%Y-%m-%dT%H:%M:%S.%fZ")
        spec = {"holderIdentity": holder, "leaseDurationSeconds": LEASE_SECONDS, "leaseTransitions": term}
        times = {"renewTime": now} | ({"acquireTime": now} if term != self._term else {})
        metadata = {"name": self._name, "namespace": self._namespace, "resourceVersion": seen.version}
        body = {"metadata": metadata, "spec": {**spec, **times}}  # a patch: the labels are the chart's
        lease = self._call(self._leases.patch_namespaced_lease, self._name, self._namespace, body)
        if lease is None:
            return None
        return _LeaseState(lease.metadata.resource_version, holder, term, self._monotonic())

    def _call(self, method: Callable[..., Any], *arguments: Any) -> Any:
        """Call the API; None: not there, or changed by another process meanwhile."""
        try:
            return method(*arguments, _request_timeout=REQUEST_SECONDS_MAX)
        except client.ApiException as error:
            if error.status in (NOT_FOUND, CONFLICT):
                return None
            text = f"lease {self._namespace}/{self._name}: {error.status} {error.reason}"
            passing = error.status in (0, 429) or error.status >= 500
            raise UnavailableError(text) if passing else InputError(text) from error
        except (urllib3.exceptions.HTTPError, OSError) as error:
            raise UnavailableError(f"lease {self._namespace}/{self._name}: {error}") from error
