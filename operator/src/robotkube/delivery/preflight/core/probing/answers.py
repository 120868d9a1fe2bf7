"""What a pod of the probe is told, and what it answers, as JSON: in an environment variable, and as the message with
which its container ends."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from robotkube.delivery.preflight.core.findings import Unread

VARIABLE = "ROBOTKUBE_PROBE"
MESSAGE_BYTES_MAX = 4096  # of a container's last words, by the kubelet
WORDS_MAX = 200
OPEN_PORT, CLOSED_PORT = 8080, 8081


@dataclass(frozen=True)
class ProbeQuestions:
    """What a pod is to find out: whose clock to compare with and which neighbour to reach (addresses of pods), names to
    resolve, and the broker's host and port; empty and 0 where there is none to reach."""

    clock: str
    neighbour: str
    names: Sequence[str] = ()
    broker_host: str = ""
    broker_port: int = 0

    @property
    def text(self) -> str:
        """The questions as the pod gets them."""
        return json.dumps(asdict(self))


@dataclass(frozen=True)
class DiskSpace:
    """A file system as a pod sees it, in bytes."""

    free: int
    total: int


@dataclass(frozen=True)
class ProbeAnswer:
    """What a pod found out; of what failed the words, empty where it went well. `clock_ahead` is how many seconds the
    clock asked is ahead of the pod's, within `clock_within` seconds; `closed` whether the port that must not be reached
    was."""

    names: Mapping[str, str] = field(default_factory=dict)
    clock_ahead: float = 0.0
    clock_within: float = 0.0
    clock_words: str = ""
    open_words: str = ""
    closed: bool = False
    broker_words: str = ""
    disks: Mapping[str, DiskSpace] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The answer as the pod gives it: words are cut where it would not fit."""
        text = json.dumps(asdict(self))
        if len(text.encode()) <= MESSAGE_BYTES_MAX:
            return text
        return json.dumps({**asdict(self), "names": {name: words[:40] for name, words in self.names.items()}})


def read_questions(text: str) -> ProbeQuestions:
    """The questions in a pod's environment; ValueError when it holds none."""
    try:
        return ProbeQuestions(**json.loads(text))
    except TypeError as error:
        raise ValueError(str(error)) from error


def read_answer(text: str) -> ProbeAnswer | Unread:
    """The answer in a container's last words. They are another's, so what has not its form is not read."""
    try:
        answer = json.loads(text)
        disks = {str(name): DiskSpace(int(one["free"]), int(one["total"])) for name, one in answer["disks"].items()}
        return ProbeAnswer(
            names={str(name): _words(words) for name, words in answer["names"].items()},
            clock_ahead=float(answer["clock_ahead"]),
            clock_within=float(answer["clock_within"]),
            clock_words=_words(answer["clock_words"]),
            open_words=_words(answer["open_words"]),
            closed=answer["closed"] is True,
            broker_words=_words(answer["broker_words"]),
            disks=disks,
        )
    except (ValueError, KeyError, TypeError, AttributeError):
        return Unread(f"its pod ended without an answer that can be read: {_words(text) or 'it said nothing'}")


def _words(value: Any) -> str:
    return " ".join(str(value).split())[:WORDS_MAX]
