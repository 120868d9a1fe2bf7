"""Test namespaces with the rights of a kubeconfig, through the API server."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.documents.core.json_codec import read_json_shortened
from robotkube.foundation.kubernetes.adapters.access_reviews import may
from robotkube.registry.suites.adapters.namespace_objects import ApiCall, KubernetesNamespaceObjects
from robotkube.registry.suites.core.own_namespaces import (
    KINDS,
    LABEL,
    copies,
    is_left_behind,
    namespace_document,
    needed_rights,
)
from robotkube.registry.suites.ports.suites import Object

NAMESPACES = "/api/v1/namespaces"
ACCOUNT_SECONDS_MAX = 20.0  # until a new namespace has the account `default`, and a quota its status
POLL_SECONDS = 0.2
DENIED = "denied request: "
NOT_YET = ("error looking up service account", "status unknown for quota")


class KubernetesOwnNamespaces:
    """The port OwnNamespaces: copies of the test namespace `source`. `now_ns` is the wall clock in ns since 1970."""

    def __init__(
        self,
        call: ApiCall,
        source: str,
        now_ns: Callable[[], int] = time.time_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._call = call
        self._source = source
        self._now_ns = now_ns
        self._sleep = sleep

    def missing_rights(self, namespace: str) -> Sequence[str]:
        """What the account may not do of what it takes, in words."""
        return [str(right) for right in needed_rights(namespace, self._source) if not may(self._call, right)]

    def remove_left_behind(self) -> Sequence[str]:
        """Remove those whose makers have ended, or whose time is over; their names."""
        items = self._read("GET", NAMESPACES, [("labelSelector", LABEL)]).get("items") or ()
        names = [item["metadata"]["name"] for item in items if is_left_behind(item, self._now_ns(), _lives)]
        for name in names:
            self.remove(name)
        return names

    def make(self, namespace: str, seconds: float) -> None:
        """Make it, with the objects of `source`."""
        document = namespace_document(namespace, _this(), self._now_ns() + int(seconds * 1e9))
        self._read("POST", NAMESPACES, body=document)
        for kind in KINDS:
            items = self._read("GET", kind.path.format(self._source)).get("items") or ()
            for copy in copies(kind, items, namespace):
                self._read("POST", kind.path.format(namespace), body=copy)

    def refusal(self, namespace: str, pod: Object) -> str:
        """Why the cluster would not take a pod there, asked by a dry run."""
        attempts = int(ACCOUNT_SECONDS_MAX / POLL_SECONDS)
        words = ""
        for _ in range(attempts):
            try:
                self._read("POST", f"{NAMESPACES}/{namespace}/pods", [("dryRun", "All")], pod)
                return ""
            except InputError as error:
                words = str(error)
            if not any(part in words for part in NOT_YET):
                break
            self._sleep(POLL_SECONDS)
        return words.partition(DENIED)[2] or words

    def objects(self, namespace: str) -> KubernetesNamespaceObjects:
        """What is in it."""
        return KubernetesNamespaceObjects(self._call, namespace)

    def remove(self, namespace: str) -> None:
        """Have it removed with all that is in it."""
        try:
            self._read("DELETE", f"{NAMESPACES}/{namespace}")
        except KeyError:
            return

    def is_gone(self, namespace: str) -> bool:
        """Return whether there is no such namespace."""
        try:
            self._read("GET", f"{NAMESPACES}/{namespace}")
        except KeyError:
            return True
        return False

    def _read(
        self, method: str, path: str, query: Sequence[tuple[str, str]] = (), body: Object | None = None
    ) -> Mapping[str, Any]:
        document = read_json_shortened(self._call(method, path, query, body).data)
        return document if isinstance(document, dict) else {}


def _this() -> str:
    """This program, as `_lives` knows it."""
    return f"{platform.node()}/{os.getpid()}"


def _lives(maker: str) -> bool:
    """Return whether a program may still run: one of another machine is believed until its time is over."""
    machine, _, number = maker.rpartition("/")
    if machine != platform.node() or not number.isdecimal():
        return True
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
