"""Break-glass as values: what is signed, who is registered, what stands out."""

from __future__ import annotations

import base64
from dataclasses import replace
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.deployment.adapters import ssh_keys
from robotkube.delivery.deployment.core.break_glass import (
    EmergencyChange,
    public_key,
    read_accepted,
    read_change,
    read_signature,
    read_signers,
    to_sign,
    write_change,
    write_signature,
)
from robotkube.delivery.deployment.core.unchecked_commits import says_break_glass
from robotkube.errors import DocumentError, InputError

CHANGE = EmergencyChange("robotkube/deployment", "a" * 40, "b" * 40, "2026-11-24T12:00:00Z", "the gate is away", {})
KEY = Ed25519PrivateKey.from_private_bytes(b"1" * 32)
OTHER = Ed25519PrivateKey.from_private_bytes(b"2" * 32)


def line(name: str, key: Ed25519PrivateKey = KEY) -> str:
    return f"{name} {key.public_key().public_bytes(Encoding.OpenSSH, PublicFormat.OpenSSH).decode()} comment\n"


def file_of(folder: Path, passphrase: bytes | None = None) -> Path:
    protection = BestAvailableEncryption(passphrase) if passphrase else NoEncryption()
    (folder / "key").write_bytes(KEY.private_bytes(Encoding.PEM, PrivateFormat.OpenSSH, protection))
    return folder / "key"


@pytest.mark.parametrize("passphrase", [None, b"word"])
def test_a_signature_holds_for_its_statement_and_key_alone(tmp_path: Path, passphrase: bytes | None) -> None:
    key, signature = ssh_keys.sign(file_of(tmp_path, passphrase), CHANGE.statement, lambda: "word")
    assert key == KEY.public_key().public_bytes_raw()
    assert ssh_keys.holds(signature, [b"0" * 32, key], CHANGE.statement)
    assert not ssh_keys.holds(signature, [OTHER.public_key().public_bytes_raw()], CHANGE.statement)
    assert not ssh_keys.holds(signature, [], CHANGE.statement)
    for other in ({"parent": "c" * 40}, {"tree": "c" * 40}, {"repository": "a/b"}, {"time": "x"}, {"reason": "x"}):
        assert not ssh_keys.holds(signature, [key], replace(CHANGE, **other).statement)  # type: ignore[arg-type]


def test_a_key_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="or another passphrase"):
        ssh_keys.sign(file_of(tmp_path, b"word"), b"", lambda: "wrong")
    (tmp_path / "key").write_text("no key")
    with pytest.raises(InputError, match="no private key that can be read"):
        ssh_keys.sign(tmp_path / "key", b"", str)
    with pytest.raises(InputError, match="cannot be read"):
        ssh_keys.sign(tmp_path / "none", b"", str)


@given(st.integers(0, 200), st.integers(1, 255))
def test_no_byte_of_a_signature_can_be_changed(at: int, difference: int) -> None:
    data = bytearray(base64.b64decode(SIGNATURE))
    data[at % len(data)] ^= difference
    text = base64.b64encode(bytes(data)).decode()
    assert not ssh_keys.holds(text, [KEY.public_key().public_bytes_raw()], CHANGE.statement)


@given(st.one_of(st.binary(max_size=200).map(lambda data: base64.b64encode(data).decode()), st.text(max_size=50)))
def test_anything_else_is_no_signature_and_no_key(text: str) -> None:
    assert read_signature(text) is None
    assert public_key(text) is None


def _signature() -> str:
    return write_signature(KEY.public_key().public_bytes_raw(), KEY.sign(to_sign(CHANGE.statement)))


SIGNATURE = _signature()


def test_the_file_goes_round_and_the_message_says_who_signed() -> None:
    signed = CHANGE.signed_by("two", "BBBB").signed_by("one", "AAAA")
    assert read_change(write_change(signed), "f") == signed
    assert signed.message == (
        "the gate is away\n\nRobotKube-Break-Glass: 2026-11-24T12:00:00Z\n"
        "RobotKube-Signed-By: one AAAA\nRobotKube-Signed-By: two BBBB\n"
    )
    assert says_break_glass(signed.message)
    assert not says_break_glass("Words\n\nRobotKube-Pull-Request: 7\n")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"reason": ""}, "reason: "),
        ({"reason": "two\nlines"}, "reason: "),
        ({"parent": "main"}, "parent: 'main' must match"),
        ({"time": "2026-11-24 12:00"}, "time: "),
        ({"repository": "robotkube"}, "repository: "),
        ({"signatures": {"one": "two words"}}, "signatures.one: must be one word in base64"),
        ({"signatures": {"a b": "AAAA"}}, "signatures: 'a b'"),
    ],
)
def test_a_wrong_file_is_refused_in_words(changes: dict[str, object], words: str) -> None:
    with pytest.raises(DocumentError) as caught:
        read_change(write_change(replace(CHANGE, **changes)), "change.yaml")  # type: ignore[arg-type]
    assert words in str(caught.value)


def test_registered_people_have_keys_of_their_own() -> None:
    signers = read_signers(f"# people\n\n{line('one')}{line('two', OTHER)}")
    assert signers == {"one": (KEY.public_key().public_bytes_raw(),), "two": (OTHER.public_key().public_bytes_raw(),)}
    assert read_signers("# nobody\n") == {}
    with pytest.raises(DocumentError) as caught:
        read_signers(f"{line('one')}{line('two')}a b\none ssh-rsa AAAA\none ssh-ed25519 AAAA\n*,b {line('x')}")
    for words in (
        "line 2: this key stands there already; each person signs with keys of their own",
        "line 3: must be `<name> ssh-ed25519 <key>`",
        "line 4: must be `<name>",
        "line 5: no key of type ssh-ed25519",
        "line 6: must be `<name>",
    ):
        assert words in str(caught.value)
    with pytest.raises(DocumentError, match="names one person; name 2 or more, or nobody"):
        read_signers(line("one"))


def test_accepted_commits_are_whole_ids() -> None:
    assert read_accepted(f"# why\n{'a' * 40}  # because\n\n") == {"a" * 40}
    with pytest.raises(DocumentError, match="line 2: 'abc' must be the whole id of a commit"):
        read_accepted(f"{'a' * 40}\nabc\n")
