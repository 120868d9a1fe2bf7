"""The task gateway's broker session in memory, and writing of tasks in memory: ports GatewayChannel and TaskWriter."""

from __future__ import annotations

import copy
import json
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.delivery.tasks.ports.mqtt_gateway import GatewayMessage
from robotkube.errors import RobotKubeError
from robotkube.testing.clusters import MemoryTasks


@dataclass
class MemoryGatewayChannel:
    """A broker session in memory: messages of operators, acknowledged or left to come again, and the answers."""

    connected: bool = True
    topics: list[str] = field(default_factory=list)
    waiting: deque[GatewayMessage] = field(default_factory=deque)
    acknowledged: list[GatewayMessage] = field(default_factory=list)
    left: list[GatewayMessage] = field(default_factory=list)
    answers: list[tuple[str, dict[str, Any]]] = field(default_factory=list)

    @property
    def complaint(self) -> str:
        """The reason why it is not connected; empty while it is."""
        return "" if self.connected else "not connected"

    def send(self, operator: str, document: Any) -> GatewayMessage:
        """Publish a JSON document, or bytes as they are, for an operator."""
        payload = document if isinstance(document, bytes) else json.dumps(document).encode()
        message = GatewayMessage(f"robotkube/tasks/{operator}", payload, len(payload))
        self.waiting.append(message)
        return message

    def start(self, topics: Sequence[str]) -> None:
        """Subscribe to topics."""
        self.topics = list(topics)

    def receive(self, seconds: float) -> GatewayMessage | None:
        """The next message; waits for none."""
        return self.waiting.popleft() if self.waiting else None

    def acknowledge(self, message: GatewayMessage) -> None:
        """Remember an acknowledged message."""
        self.acknowledged.append(message)

    def leave(self, message: GatewayMessage) -> None:
        """Remember a message that is left to come again."""
        self.left.append(message)

    def publish(self, topic: str, payload: bytes) -> bool:
        """Keep an answer, while connected."""
        if self.connected:
            self.answers.append((topic, json.loads(payload)))
        return self.connected

    def close(self) -> None:
        """Leave the session."""
        self.connected = False


@dataclass
class MemoryTaskWriter:
    """Writes into tasks in memory; errors put into `faults` are raised first, one per call."""

    tasks: MemoryTasks
    faults: list[RobotKubeError] = field(default_factory=list)

    def find(self, namespace: str, name: str) -> Mapping[str, Any] | None:
        """A copy of the task's object, or None."""
        self._fail()
        return copy.deepcopy(self.tasks.objects.get(f"{namespace}/{name}"))

    def create(self, document: Mapping[str, Any]) -> bool:
        """Create a task as the API server does; False when there is one."""
        self._fail()
        metadata = document["metadata"]
        key = f"{metadata['namespace']}/{metadata['name']}"
        if key in self.tasks.objects:
            return False
        self.tasks.create(metadata["namespace"], metadata["name"], document["spec"])
        self.tasks.objects[key]["metadata"]["labels"] = dict(metadata.get("labels", {}))
        return True

    def patch_spec(self, namespace: str, name: str, spec: Mapping[str, Any]) -> bool:
        """Replace a spec; one that differs is a new generation. False when there is no task."""
        self._fail()
        task = self.tasks.objects.get(f"{namespace}/{name}")
        if task is not None and task["spec"] != spec:
            task["spec"] = copy.deepcopy(dict(spec))
            task["metadata"]["generation"] += 1
        return task is not None

    def annotate(self, namespace: str, name: str, annotations: Mapping[str, str]) -> bool:
        """Merge annotations; False when there is no task."""
        self._fail()
        task = self.tasks.objects.get(f"{namespace}/{name}")
        if task is not None:
            task["metadata"].setdefault("annotations", {}).update(annotations)
        return task is not None

    def delete(self, namespace: str, name: str) -> bool:
        """Delete a task; False when there is none."""
        self._fail()
        return self.tasks.objects.pop(f"{namespace}/{name}", None) is not None

    def _fail(self) -> None:
        if self.faults:
            raise self.faults.pop(0)
