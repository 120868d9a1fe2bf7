"""Calls to a machine's container runtime (CRI), as somebody makes them who has the machine: gRPC with as much of HTTP/2
and of protocol buffers as one call at a time needs.

https://github.com/kubernetes/cri-api/blob/master/pkg/apis/runtime/v1/api.proto
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

SERVICE = "/runtime.v1.RuntimeService/"
PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
DATA, HEADERS, SETTINGS, PING, GOAWAY = 0, 1, 4, 6, 7
END_STREAM, END_HEADERS, ACK = 1, 4, 1
SECONDS_MAX = 20.0

Fields = Mapping[int, "str | bytes | int | dict[str, str]"]


@dataclass(frozen=True)
class PodSandbox:
    """The sandbox of a pod: its id, and the identity of the pod."""

    id: str
    name: str
    namespace: str
    uid: str

    @property
    def configuration(self) -> bytes:
        """As requests name it (PodSandboxConfig)."""
        return message({1: message({1: self.name, 2: self.uid, 3: self.namespace})})


def start_container(runtime: Path, sandbox: PodSandbox, name: str, image: str, command: list[str]) -> str:
    """Start a container of that name in a pod that runs; its id. `image` is there already."""
    labels = {
        "io.kubernetes.container.name": name,
        "io.kubernetes.pod.name": sandbox.name,
        "io.kubernetes.pod.namespace": sandbox.namespace,
        "io.kubernetes.pod.uid": sandbox.uid,
    }
    words = b"".join(message({3: word}) for word in command)
    configuration = message({1: message({1: name})}) + message({2: message({1: image})}) + words + message({9: labels})
    answer = call(runtime, "CreateContainer", {1: sandbox.id, 2: configuration, 3: sandbox.configuration})
    container = _text(answer, 1)
    call(runtime, "StartContainer", {1: container})
    return container


def remove_container(runtime: Path, container: str) -> None:
    """End and remove a container."""
    call(runtime, "StopContainer", {1: container, 2: 1})
    call(runtime, "RemoveContainer", {1: container})


def call(runtime: Path, method: str, fields: Fields) -> bytes:
    """The answer's message; AssertionError when the runtime sends none."""
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(SECONDS_MAX)
        connection.connect(str(runtime))
        body = message(fields)
        headers = {":method": "POST", ":scheme": "http", ":path": f"{SERVICE}{method}", ":authority": "localhost"}
        headers |= {"content-type": "application/grpc", "te": "trailers"}
        connection.sendall(
            PREFACE
            + _frame(SETTINGS, 0, 0, b"")
            + _frame(HEADERS, END_HEADERS, 1, b"".join(_header(*one) for one in headers.items()))
            + _frame(DATA, END_STREAM, 1, struct.pack(">BI", 0, len(body)) + body)
        )
        data = _answer(connection)
    assert len(data) >= 5, f"{method}: the runtime refused it; its log says why"
    return data[5:]


def message(fields: Fields) -> bytes:
    """A protocol buffer: field number -> text, bytes (a message), number, or mapping of texts."""
    parts = []
    for number, value in fields.items():
        if isinstance(value, int):
            parts.append(_number(number << 3) + _number(value))
        elif isinstance(value, dict):
            parts += [message({number: message({1: key, 2: text})}) for key, text in value.items()]
        else:
            data = value.encode() if isinstance(value, str) else value
            parts.append(_number(number << 3 | 2) + _number(len(data)) + data)
    return b"".join(parts)


def _text(data: bytes, wanted: int) -> str:
    """The text of a field with a length."""
    place = 0
    while place < len(data):
        key, place = _read_number(data, place)
        size, place = _read_number(data, place)
        if key >> 3 == wanted:
            return data[place : place + size].decode()
        place += size
    raise AssertionError(f"no field {wanted} in {data!r}")


def _number(value: int) -> bytes:
    parts = []
    while value > 127:
        parts.append(value & 127 | 128)
        value >>= 7
    return bytes([*parts, value])


def _read_number(data: bytes, place: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[place]
        place += 1
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return value, place


def _header(name: str, value: str) -> bytes:
    """A header as a literal that is not indexed (RFC 7541, 6.2.2)."""
    return b"\0" + bytes([len(name)]) + name.encode() + bytes([len(value)]) + value.encode()


def _frame(kind: int, flags: int, stream: int, payload: bytes) -> bytes:
    return struct.pack(">I", len(payload))[1:] + bytes([kind, flags]) + struct.pack(">I", stream) + payload


def _answer(connection: socket.socket) -> bytes:
    """The data of stream 1, to its end."""
    payloads = b""
    for kind, flags, stream, payload in _frames(connection):
        if kind == SETTINGS and not flags & ACK:
            connection.sendall(_frame(SETTINGS, ACK, 0, b""))
        elif kind == PING and not flags & ACK:
            connection.sendall(_frame(PING, ACK, 0, payload))
        elif kind == DATA and stream == 1:
            payloads += payload
        if kind == GOAWAY or (stream == 1 and kind in (DATA, HEADERS) and flags & END_STREAM):
            return payloads
    return payloads


def _frames(connection: socket.socket) -> Iterator[tuple[int, int, int, bytes]]:
    while head := _exactly(connection, 9):
        size = int.from_bytes(head[:3], "big")
        stream = int.from_bytes(head[5:], "big") & 0x7FFFFFFF
        yield head[3], head[4], stream, _exactly(connection, size)


def _exactly(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size and (part := connection.recv(size - len(data))):
        data += part
    return data
