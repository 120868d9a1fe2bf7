"""Break-glass: one commit that the forge takes on main without the gate, because two registered people have signed it.

What they sign is a statement about exactly this commit (tree, reason) on exactly this tip of this repository at this
time, with SSH signatures of namespace NAMESPACE. The commit's message carries statement and signatures, so that it is
recognised later from Git alone (unchecked_commits):

    <reason>

    RobotKube-Break-Glass: <time>
    RobotKube-Signed-By: <name> <signature>         two or more, by name

It stands out until main has other files in the place of those it brought, or until ACCEPTED_PATH on main names it; both
are the gate's to merge, and such a commit may not change the files that decide about it.

Registered are the people in policies/signers on main, in the form of OpenSSH's allowed signers, one key in each line:
`<name> ssh-ed25519 <key>`; a name is that of an account of the forge. Fewer than two people: it is off. The forge's
hook reads the same (ci/toolchain/gitea/forge-hook/breakglass.go).
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.patterns import COMMIT, REPOSITORY, WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping, write_mapping
from robotkube.foundation.forge.core.trailers import EMERGENCY, SIGNED_BY, trailer

SIGNERS_PATH = "policies/signers"
ACCEPTED_PATH = "policies/accepted-commits"
NAMESPACE = "robotkube-break-glass"
PUSH_OPTION = "break-glass"
TIME_FORMAT = "%Y-%m-%dT%H:%M:%SZ"
PEOPLE_MIN, SIGNATURES_MAX = 2, 10
KEY_TYPE = "ssh-ed25519"
KEY_BYTES, SIGNATURE_BYTES = 32, 64

_MAGIC = b"SSHSIG"
_VERSION = 1
_DIGEST = b"sha512"
_TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", re.ASCII)
_REASON = re.compile(r"[!-~][ -~]{0,198}[!-~]|[!-~]", re.ASCII)


@dataclass(frozen=True)
class EmergencyChange:
    """A change that goes to main without the gate: `tree` on `parent` of `repository`, and who signed it so far
    (name -> signature)."""

    repository: str
    parent: str
    tree: str
    time: str
    reason: str
    signatures: Mapping[str, str]

    @property
    def statement(self) -> bytes:
        """The bytes that are signed."""
        lines = [f"repository {self.repository}", f"parent {self.parent}", f"tree {self.tree}"]
        return "\n".join(["robotkube break-glass 1", *lines, f"time {self.time}", f"reason {self.reason}", ""]).encode()

    @property
    def message(self) -> str:
        """The message of its commit."""
        signed = [trailer(SIGNED_BY, f"{name} {signature}") for name, signature in sorted(self.signatures.items())]
        return "\n".join([self.reason, "", trailer(EMERGENCY, self.time), *signed, ""])

    def signed_by(self, name: str, signature: str) -> EmergencyChange:
        """The change with one more signature."""
        return replace(self, signatures={**self.signatures, name: signature})


def read_change(text: str, path: str) -> EmergencyChange:
    """The change in a file as `write_change` makes it; DocumentError names every mistake."""
    reader = Reader(path)
    keys = ["repository", "parent", "tree", "time", "reason", "signatures"]
    document = reader.mapping(read_mapping(text, path), "", keys)
    forms = {"repository": REPOSITORY, "parent": COMMIT, "tree": COMMIT, "time": _TIME, "reason": _REASON}
    words = {key: reader.text(document.get(key), key, form) for key, form in forms.items()}
    given = document.get("signatures")
    signatures = given if isinstance(given, Mapping) else {}
    if not isinstance(given, Mapping):
        reader.problems.append("signatures: must be a mapping from names to signatures")
    for name, signature in signatures.items():
        reader.word(name, "signatures", WORD)
        if not isinstance(signature, str) or len(signature.split()) != 1:
            reader.problems.append(f"signatures.{name}: must be one word in base64")
    reader.finish()
    return EmergencyChange(**words, signatures=dict(signatures))


def write_change(change: EmergencyChange) -> str:
    """The change as a file that goes from one signer to the next."""
    parts = ("repository", "parent", "tree", "time", "reason")
    return write_mapping({**{part: getattr(change, part) for part in parts}, "signatures": dict(change.signatures)})


def read_signers(text: str, path: str = SIGNERS_PATH) -> Mapping[str, tuple[bytes, ...]]:
    """The registered people with their keys; DocumentError names every mistake. Comments say nothing."""
    signers: dict[str, tuple[bytes, ...]] = {}
    problems: list[str] = []
    for number, line in enumerate(text.split("\n"), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) < 3 or words[1] != KEY_TYPE or not WORD.fullmatch(words[0]):
            problems.append(
                f"line {number}: must be `<name> {KEY_TYPE} <key>`, the name one of an account of the forge"
            )
            continue
        key = public_key(words[2])
        if key is None:
            problems.append(f"line {number}: no key of type {KEY_TYPE}; copy the second word of the .pub file")
        elif any(key in keys for keys in signers.values()):
            problems.append(f"line {number}: this key stands there already; each person signs with keys of their own")
        else:
            signers[words[0]] = (*signers.get(words[0], ()), key)
    if not problems and len(signers) == 1:
        problems.append(f"names one person; name {PEOPLE_MIN} or more, or nobody, which switches break-glass off")
    if problems:
        raise DocumentError(path, problems)
    return signers


def read_accepted(text: str, path: str = ACCEPTED_PATH) -> frozenset[str]:
    """The break-glass commits that people have accepted as they are, one id in each line; DocumentError names every
    mistake. Comments and empty lines say nothing."""
    lines = [line.partition("#")[0].strip() for line in text.split("\n")]
    problems = [
        f"line {number}: {line[:60]!r} must be the whole id of a commit (40 hex digits)"
        for number, line in enumerate(lines, 1)
        if line and not COMMIT.fullmatch(line)
    ]
    if problems:
        raise DocumentError(path, problems)
    return frozenset(line for line in lines if line)


def public_key(text: str) -> bytes | None:
    """The 32 bytes of the key in an OpenSSH public key line's second word; None when it is none."""
    try:
        words = _read_strings(base64.b64decode(text, validate=True))
    except (binascii.Error, ValueError):
        return None
    return words[1] if len(words) == 2 and words[0] == KEY_TYPE.encode() and len(words[1]) == KEY_BYTES else None


def to_sign(statement: bytes) -> bytes:
    """The bytes that the key signs (PROTOCOL.sshsig of OpenSSH)."""
    digest = hashlib.sha512(statement).digest()
    return _MAGIC + b"".join(_string(part) for part in (NAMESPACE.encode(), b"", _DIGEST, digest))


def write_signature(key: bytes, signature: bytes) -> str:
    """An SSH signature in one word, from the public key and the raw signature over `to_sign`."""
    kind = KEY_TYPE.encode()
    parts = (_string(kind) + _string(key), NAMESPACE.encode(), b"", _DIGEST, _string(kind) + _string(signature))
    return base64.b64encode(_MAGIC + struct.pack(">I", _VERSION) + b"".join(map(_string, parts))).decode()


def read_signature(text: str) -> tuple[bytes, bytes] | None:
    """Public key and raw signature of an SSH signature for this purpose; None when it is none."""
    try:
        data = base64.b64decode(text, validate=True)
        head = len(_MAGIC) + 4
        parts = _read_strings(data[head:])
        inner = _read_strings(parts[4]) if len(parts) == 5 else []
    except (binascii.Error, ValueError):
        return None
    if data[:head] != _MAGIC + struct.pack(">I", _VERSION) or len(parts) != 5:
        return None
    key = public_key(base64.b64encode(parts[0]).decode())
    named = parts[1:4] == [NAMESPACE.encode(), b"", _DIGEST]
    whole = len(inner) == 2 and inner[0] == KEY_TYPE.encode() and len(inner[1]) == SIGNATURE_BYTES
    return (key, inner[1]) if key is not None and named and whole else None


def _string(data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + data


def _read_strings(data: bytes) -> list[bytes]:
    """Strings with their length before them, to the end; ValueError when one is cut off."""
    strings: list[bytes] = []
    at = 0
    while at < len(data):
        size = struct.unpack_from(">I", data, at)[0] if at + 4 <= len(data) else len(data)
        if at + 4 + size > len(data):
            raise ValueError("cut off")
        strings.append(data[at + 4 : at + 4 + size])
        at += 4 + size
    return strings
