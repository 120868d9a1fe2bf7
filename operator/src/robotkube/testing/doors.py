"""A broker session in memory, and writing of tasks in memory: ports DoorChannel and TaskWriter."""

from __future__ import annotations

import copy
import json
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.domain.errors import RobotKubeError
from robotkube.ports.doors import DoorMessage
from robotkube.testing.clusters import MemoryTasks


@dataclass
class MemoryDoor:
    """What operators sent, what was acknowledged or left to come again, and what was answered."""

    connected: bool = True
    topics: list[str] = field(default_factory=list)
    waiting: deque[DoorMessage] = field(default_factory=deque)
    acknowledged: list[DoorMessage] = field(default_factory=list)
    left: list[DoorMessage] = field(default_factory=list)
    answers: list[tuple[str, dict[str, Any]]] = field(default_factory=list)

    @property
    def complaint(self) -> str:
        """Empty while connected."""
        return "" if self.connected else "not connected"

    def send(self, operator: str, document: Any) -> DoorMessage:
        """An operator publishes a JSON document, or bytes as they are."""
        payload = document if isinstance(document, bytes) else json.dumps(document).encode()
        message = DoorMessage(f"robotkube/tasks/{operator}", payload, len(payload))
        self.waiting.append(message)
        return message

    def start(self, topics: Sequence[str]) -> None:
        """Heard from now on."""
        self.topics = list(topics)

    def take(self, seconds: float) -> DoorMessage | None:
        """The next message; waits for none."""
        return self.waiting.popleft() if self.waiting else None

    def acknowledge(self, message: DoorMessage) -> None:
        """Remembered."""
        self.acknowledged.append(message)

    def leave(self, message: DoorMessage) -> None:
        """Remembered."""
        self.left.append(message)

    def publish(self, topic: str, payload: bytes) -> bool:
        """Kept, while connected."""
        if self.connected:
            self.answers.append((topic, json.loads(payload)))
        return self.connected

    def close(self) -> None:
        """The session is left."""
        self.connected = False


@dataclass
class MemoryTaskWriter:
    """Writes into tasks in memory; errors put into `faults` are raised first, one per call."""

    tasks: MemoryTasks
    faults: list[RobotKubeError] = field(default_factory=list)

    def find(self, namespace: str, name: str) -> Mapping[str, Any] | None:
        """The object as it is."""
        self._fail()
        return copy.deepcopy(self.tasks.objects.get(f"{namespace}/{name}"))

    def create(self, document: Mapping[str, Any]) -> bool:
        """As the API server does."""
        self._fail()
        metadata = document["metadata"]
        key = f"{metadata['namespace']}/{metadata['name']}"
        if key in self.tasks.objects:
            return False
        self.tasks.create(metadata["namespace"], metadata["name"], document["spec"])
        self.tasks.objects[key]["metadata"]["labels"] = dict(metadata.get("labels", {}))
        return True

    def patch_spec(self, namespace: str, name: str, spec: Mapping[str, Any]) -> bool:
        """A spec that differs is a new generation."""
        self._fail()
        found = self.tasks.objects.get(f"{namespace}/{name}")
        if found is not None and found["spec"] != spec:
            found["spec"] = copy.deepcopy(dict(spec))
            found["metadata"]["generation"] += 1
        return found is not None

    def annotate(self, namespace: str, name: str, annotations: Mapping[str, str]) -> bool:
        """Merged."""
        self._fail()
        found = self.tasks.objects.get(f"{namespace}/{name}")
        if found is not None:
            found["metadata"].setdefault("annotations", {}).update(annotations)
        return found is not None

    def delete(self, namespace: str, name: str) -> bool:
        """Gone."""
        self._fail()
        return self.tasks.objects.pop(f"{namespace}/{name}", None) is not None

    def _fail(self) -> None:
        if self.faults:
            raise self.faults.pop(0)
