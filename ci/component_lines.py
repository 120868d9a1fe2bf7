"""A line for each component of an installation when its pods are ready, and what the others hang with, as their pods
and events say it.

with component_lines.following([kubectl, "--kubeconfig", file], ["robotkube"], print) as components:
    install()
    print(components.hanging())
"""

from __future__ import annotations

import codecs
import json
import os
import subprocess
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import IO, Any

from robotkube.registry.suites.core.pod_descriptions import describe_pod, pod_ready

NAME = "app.kubernetes.io/name"
PODS = "app.kubernetes.io/part-of in (robotkube,argocd)"
SILENT_SECONDS_MAX = 30.0  # then it is said what hangs, once for each reason
LOOK_SECONDS = 1.0
END_SECONDS_MAX = 5.0
READ_BYTES = 65536
EVENTS_SECONDS_MAX = 10
Object = Mapping[str, Any]
Events = Callable[[str, str], Sequence[Object]]


class ComponentLines:
    """What `say` is told of components; `events` are those of a pod (namespace, name), `monotonic` a clock in seconds.
    Safe from any thread."""

    def __init__(self, say: Callable[[str], None], events: Events, monotonic: Callable[[], float]) -> None:
        self._say, self._events, self._monotonic = say, events, monotonic
        self._began = self._spoken = monotonic()
        self._pods: dict[tuple[str, str], Object] = {}
        self._unready: set[str] = set()
        self._reasons: set[str] = set()
        self._lock = threading.Lock()

    def saw(self, kind: str, pod: Object) -> None:
        """A pod is there as it is now, or, of kind DELETED, is gone."""
        with self._lock:
            metadata = pod["metadata"]
            key, component = (metadata["namespace"], metadata["name"]), metadata["labels"][NAME]
            if kind == "DELETED" or "deletionTimestamp" in metadata:
                self._pods.pop(key, None)
            else:
                self._pods[key] = pod
            waiting = [one for one in self._pods.values() if not _done(one)]
            if any(one["metadata"]["labels"][NAME] == component for one in waiting):
                self._unready.add(component)
            elif component in self._unready and self._of(component):
                self._unready.remove(component)
                self._report(f"{component}: {self._word(component)} after {self._monotonic() - self._began:.1f} s")

    def look(self) -> None:
        """Say what hangs, when nothing was said for a while."""
        with self._lock:
            if self._monotonic() - self._spoken < SILENT_SECONDS_MAX:
                return
            self._spoken = self._monotonic()
            waiting = self._waiting()
        for line in self._described(waiting):
            if line not in self._reasons:
                self._reasons.add(line)
                self._say(line)

    def hanging(self) -> tuple[str, ...]:
        """A line for each pod that is not ready: its component, what its containers wait for, its last warnings."""
        with self._lock:
            waiting = self._waiting()
        return tuple(self._described(waiting))

    def _described(self, pods: Sequence[Object]) -> Iterator[str]:
        for pod in pods:
            metadata = pod["metadata"]
            said = describe_pod(pod, self._events(metadata["namespace"], metadata["name"]))
            yield f"{metadata['labels'][NAME]} is not ready: {'; '.join(said)}"

    def _waiting(self) -> list[Object]:
        waiting = (pod for pod in self._pods.values() if not _done(pod))
        return sorted(waiting, key=lambda pod: str(pod["metadata"]["labels"][NAME]))

    def _of(self, component: str) -> list[Object]:
        return [pod for pod in self._pods.values() if pod["metadata"]["labels"][NAME] == component]

    def _word(self, component: str) -> str:
        return "done" if all(_succeeded(pod) for pod in self._of(component)) else "ready"

    def _report(self, line: str) -> None:
        self._spoken = self._monotonic()
        self._say(line)


def _succeeded(pod: Object) -> bool:
    return bool(pod.get("status", {}).get("phase") == "Succeeded")


def _done(pod: Object) -> bool:
    """Return whether nothing more is to come of it: a Job's pod has to end."""
    owners = (owner.get("kind") for owner in pod["metadata"].get("ownerReferences", ()))
    return _succeeded(pod) or (pod_ready(pod) and "Job" not in owners)


@contextmanager
def following(
    kubectl: Sequence[str], namespaces: Collection[str], say: Callable[[str], None]
) -> Iterator[ComponentLines]:
    """Lines about the pods of platform and Argo CD in these namespaces meanwhile; `kubectl` is the command with its
    kubeconfig. When it cannot follow them, no line is said, and nothing fails by that."""

    def events(namespace: str, name: str) -> Sequence[Object]:
        asked = ["-n", namespace, "get", "events", f"--field-selector=involvedObject.name={name}", "-o", "json"]
        try:
            done = subprocess.run([*kubectl, *asked], capture_output=True, timeout=EVENTS_SECONDS_MAX, check=True)
        except (subprocess.SubprocessError, OSError):
            return ()
        items: Sequence[Object] = json.loads(done.stdout)["items"]
        return items

    lines = ComponentLines(say, events, time.monotonic)
    asked = ["get", "pods", "-A", "-l", PODS, "--watch", "--output-watch-events", "-o", "json"]
    watching = subprocess.Popen([*kubectl, *asked], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    stream = watching.stdout
    assert stream is not None
    ended = threading.Event()
    threads = [
        threading.Thread(target=_read, args=(stream, namespaces, lines), daemon=True),
        threading.Thread(target=_look, args=(lines, ended), daemon=True),
    ]
    for thread in threads:
        thread.start()
    try:
        yield lines
    finally:
        ended.set()
        watching.kill()  # it only reads
        watching.wait()
        for thread in threads:
            thread.join(END_SECONDS_MAX)
        stream.close()


def _look(lines: ComponentLines, ended: threading.Event) -> None:
    while not ended.wait(LOOK_SECONDS):
        lines.look()


def _read(stream: IO[bytes], namespaces: Collection[str], lines: ComponentLines) -> None:
    for event in documents(stream):
        metadata = event["object"].get("metadata", {})
        if metadata.get("namespace") in namespaces and NAME in metadata.get("labels", {}):
            lines.saw(event["type"], event["object"])


def documents(stream: IO[bytes]) -> Iterator[Any]:
    """The JSON documents of a stream, one after the other, each as soon as it is whole."""
    decode, reader, text = codecs.getincrementaldecoder("utf-8")("replace").decode, json.JSONDecoder(), ""
    while part := os.read(stream.fileno(), READ_BYTES):
        text += decode(part)
        while text := text.lstrip():
            try:
                document, end = reader.raw_decode(text)
            except ValueError:
                break  # the rest of it comes
            text = text[end:]
            yield document
