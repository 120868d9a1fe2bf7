"""What the images suite asks of a container image: its platform, user, entry point, labels and bill of materials.

Everything here works on documents that were read from the registry: manifest, configuration, attached bill.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.patterns import IMAGE_PARTS
from robotkube.registry.suites.core.pod_security import items, mapping

NUMERIC_USER = re.compile(r"[1-9][0-9]*(:[0-9]+)?", re.ASCII)
LABELS = ("org.opencontainers.image.title", "org.opencontainers.image.version")
BILL_TYPE = "application/vnd.cyclonedx+json"
SHELLS = frozenset({"sh", "ash", "bash", "dash", "ksh", "zsh"})
STARTERS = frozenset({"env", "busybox"})  # begin another program in their own place
SEPARATOR = re.compile(r"[();|&\n]+")


@dataclass(frozen=True)
class ImageReference:
    """The reference of an image: `<host>/<repository>@<digest>`."""

    host: str
    repository: str
    digest: str

    def __str__(self) -> str:
        return f"{self.host}/{self.repository}@{self.digest}"


def read_reference(text: str) -> ImageReference | None:
    """The parts of a reference by digest; None when it is none."""
    match = IMAGE_PARTS.fullmatch(text)
    return ImageReference(*match.groups()) if match else None


@dataclass(frozen=True)
class Started:
    """A container that runs an image: `place` in words, its `command` and `args` as Kubernetes takes them."""

    place: str
    image: str
    command: tuple[str, ...]
    args: tuple[str, ...]

    def words(self, configuration: Mapping[str, Any]) -> list[str]:
        """What PID 1 is: the container's command replaces both settings of the image, its args the second."""
        if self.command:
            return [*self.command, *self.args]
        return [*_texts(configuration.get("Entrypoint")), *(self.args or _texts(configuration.get("Cmd")))]


def _texts(value: Any) -> list[str]:
    return [str(word) for word in value] if isinstance(value, list) else []


def manifest_of(document: Mapping[str, Any], platform: str) -> str | None:
    """The digest that an index names for `platform` (`linux/amd64`); None when it names none."""
    for entry in items(document.get("manifests")):
        described = mapping(entry.get("platform"))
        if platform_of(described) == platform:
            return str(entry.get("digest"))
    return None


def platform_of(document: Mapping[str, Any]) -> str:
    """`linux/amd64` or `linux/arm/v7` of an image's configuration or an index's entry."""
    parts = [document.get("os"), document.get("architecture"), document.get("variant")]
    return "/".join(str(part) for part in parts if part)


def user_problems(image: str, settings: Mapping[str, Any]) -> Iterator[str]:
    """`settings` is `config` of the image's configuration."""
    user = str(settings.get("User") or "")
    if not NUMERIC_USER.fullmatch(user):
        root = user.partition(":")[0] in ("", "0", "root")
        why = "it runs as root" if root else "a name proves nothing: its number may be 0"
        yield f"{image}: user is {user or 'not set'}: {why}"


def label_problems(image: str, settings: Mapping[str, Any]) -> Iterator[str]:
    """Labels that say what the image is."""
    for label in LABELS:
        if not str(mapping(settings.get("Labels")).get(label) or "").strip():
            yield f"{image}: label {label} is missing"


def start_problems(started: Started, settings: Mapping[str, Any]) -> Iterator[str]:
    """Problems of what runs as PID 1: it has to get SIGTERM, which a shell that waits does not pass on."""
    words = started.words(settings)
    if not words:
        yield f"{started.place}: neither the chart nor the image says what to run"
    elif (script := shell_script(words)) is not None and not hands_over(script):
        shown = " ".join(script.split())[:80]
        yield f"{started.place}: a shell is PID 1 and passes no SIGTERM on to `{shown}`: it would be killed in mid-work"


def shell_script(words: Sequence[str]) -> str | None:
    """The script of `sh -c SCRIPT`, also behind env or busybox; None when no shell is given one."""
    rest = list(words)
    while rest and (_program(rest[0]) in STARTERS or ("=" in rest[0] and len(rest) < len(words))):
        rest = rest[1:]
    if not rest or _program(rest[0]) not in SHELLS:
        return None
    for number, word in enumerate(rest[1:], 1):
        if not word.startswith(("-", "+")):
            return None
        if word.startswith("-") and not word.startswith("--") and "c" in word:
            return rest[number + 1] if number + 1 < len(rest) else ""
    return None


def _program(word: str) -> str:
    return word.rpartition("/")[2]


def hands_over(script: str) -> bool:
    """Return whether the script's last command takes the shell's place (`exec program`), not in the background."""
    words = shlex.shlex(script, posix=True, punctuation_chars="();<>|&\n")
    words.whitespace = " \t\r"
    words.whitespace_split = True
    commands: list[list[str]] = [[]]
    try:
        for word in words:
            if not SEPARATOR.fullmatch(word):
                commands[-1].append(word)
            else:
                commands.append([])
    except ValueError:  # a quotation that does not end
        return False
    last = next((command for command in reversed(commands) if command), [])
    return last[:1] == ["exec"] and len(last) > 1 and not script.rstrip().endswith("&")


def bill_problems(data: bytes, digest: str) -> Iterator[str]:
    """A software bill of materials (CycloneDX, JSON) that was found attached to `digest`."""
    try:
        document = read_json(data)
    except ValueError as error:
        yield f"is not readable as JSON: {error}"
        return
    bill = mapping(document)
    if bill.get("bomFormat") != "CycloneDX":
        yield f"bomFormat is {bill.get('bomFormat')!r}, not CycloneDX"
    subject = mapping(mapping(bill.get("metadata")).get("component"))
    hashes = [entry.get("content") for entry in items(subject.get("hashes")) if entry.get("alg") == "SHA-256"]
    if digest.removeprefix("sha256:") not in hashes:
        yield f"describes another image: metadata.component.hashes does not hold {digest}"
