"""What crosses the broker in a run: clouds and results, seen with an account of one's own."""

from __future__ import annotations

import ssl
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from paho.mqtt import client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.verification import load_authorities, load_own, sentence
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.core.batches import BatchError, decode_batch
from robotkube.robots.mqtt.core.client_ids import client_id
from scenarios.runner.inputs import BrokerLog, BrokerMessages, BrokerResult
from scenarios.runner.waiting import RunError

BATCH_HEADER = struct.Struct("<4sQQI")  # magic, session, sequence, number of messages
MAGIC = b"RKF1"
CLOUDS = "mqtt/vehicles/+/lidar_center/pointcloud"
RESULTS = "mqtt/vehicles/+/tracks"
CONNECT_SECONDS_MAX = 15.0
BATCHES_MAX = 200_000


@dataclass
class BrokerObserver:
    """Counts the clouds that cross the broker, batch by batch, and keeps the results of perception. Used with `start`
    and `stop`. `read_account` is called before each connection: a certificate may have been replaced since the last."""

    read_account: Callable[[], BrokerAccount]
    _messages: list[BrokerMessages] = field(default_factory=list)
    _results: list[BrokerResult] = field(default_factory=list)
    _subscribed: threading.Event = field(default_factory=threading.Event)
    _since: int = 0
    _gaps: int = 0
    _ending: bool = False
    _refusal: str = "no answer"
    _context: ssl.SSLContext | None = None

    def start(self) -> None:
        """Connects and subscribes; raises `RunError` when the broker refuses it."""
        account = self.read_account()
        self._client = mqtt.Client(
            CallbackAPIVersion.VERSION2, client_id=client_id(f"observer-{time.time_ns()}", account.password)
        )
        if account.login is not None:
            self._client.username_pw_set(*account.login)
        self._context = account.context()
        if self._context is not None:
            self._client.tls_set_context(self._context)
            self._client.on_pre_connect = self._prove_anew
        self._client.on_connect = self._on_connect
        self._client.on_disconnect = self._on_disconnect
        self._client.on_subscribe = self._on_subscribe
        self._client.on_message = self._on_message
        broker = f"broker {account.host}:{account.port}"
        try:
            self._client.connect(account.host, account.port, keepalive=20)
        except OSError as error:
            words = error if account.tls is None else sentence(error, account.tls)
            raise RunError(f"{broker}: {words}") from error
        self._client.loop_start()
        if not self._subscribed.wait(CONNECT_SECONDS_MAX):
            self._client.loop_stop()
            raise RunError(f"{broker}: did not let {account.username} subscribe to {CLOUDS}: {self._refusal}")

    def stop(self) -> BrokerLog:
        """Ends; returns what was seen."""
        until = time.time_ns()
        self._ending = True
        self._client.disconnect()
        self._client.loop_stop()
        return BrokerLog(self._since, until, self._gaps, tuple(self._messages), tuple(self._results))

    def _prove_anew(self, _client: Any, _data: Any) -> None:
        """Prove oneself by what the platform has for the account now; by what was there before, while the platform
        cannot be asked."""
        try:
            account = self.read_account()
            if self._context is None or account.tls is None:
                return
            load_authorities(self._context, account.tls)
            if account.certificate is not None:
                load_own(self._context, account.certificate)
        except (RunError, InputError) as error:
            self._refusal = str(error)

    def _on_connect(self, client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            self._refusal = f"connection refused: {reason}"
        else:
            client.subscribe([(CLOUDS, 0), (RESULTS, 0)])

    def _on_subscribe(self, _client: Any, _data: Any, _number: Any, reasons: Any, _properties: Any) -> None:
        refused = [str(reason) for reason in reasons if reason.is_failure]
        if refused:
            self._refusal = f"subscription refused: {', '.join(refused)}"
            return
        self._since = self._since or time.time_ns()
        self._subscribed.set()

    def _on_disconnect(self, _client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        self._gaps += not self._ending
        self._refusal = f"connection ended: {reason}"

    def _on_message(self, _client: Any, _data: Any, message: Any) -> None:
        if mqtt.topic_matches_sub(RESULTS, message.topic):
            self._note_results(message)
        elif len(self._messages) < BATCHES_MAX:
            self._messages.append(BrokerMessages(time.time_ns(), message.topic, message_count(message.payload)))

    def _note_results(self, message: Any) -> None:
        now = time.time_ns()
        free = BATCHES_MAX - len(self._results)
        self._results += [BrokerResult(now, message.topic, text) for text in batch_texts(message.payload)[:free]]


def batch_texts(payload: bytes) -> list[str]:
    """The texts in a batch of std_msgs/String (CDR, little endian); what is none is left out."""
    try:
        return [text_of(message) for message in decode_batch(payload).messages]
    except (BatchError, struct.error, UnicodeDecodeError):
        return []


def text_of(message: bytes) -> str:
    """The text of a serialised std_msgs/String."""
    (length,) = struct.unpack_from("<I", message, 4)
    return bytes(message[8 : 8 + length]).rstrip(b"\0").decode()


def message_count(payload: bytes) -> int:
    """Number of messages in a batch of mqtt-bridge; a payload that is no such batch counts as one."""
    if len(payload) < BATCH_HEADER.size or payload[:4] != MAGIC:
        return 1
    return int(BATCH_HEADER.unpack_from(payload)[3])
