"""The task gateway's session at the broker (MQTT 5): messages are acknowledged only when the gateway says so.

Port GatewayChannel. paho's own thread reads and connects again, after a bounded pause with jitter; the session stays at
the broker for SESSION_SECONDS. The broker is asked to have at most UNACKNOWLEDGED_MAX messages under way, and of one
that is too long for a task only its size is kept. Of a broker that sends more nevertheless, what comes beyond
WAITING_MAX messages or WAITING_BYTES_MAX is left: when what waits is done with, the connection is broken off, and what
was not acknowledged comes again with the next one, in its order.
"""

from __future__ import annotations

import contextlib
import queue
import random
import socket
import ssl
import sys
import threading
from collections.abc import Sequence
from typing import Any

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from robotkube.backoffs import Random, backoff
from robotkube.delivery.tasks.core.mqtt_messages import MESSAGE_BYTES_MAX
from robotkube.delivery.tasks.ports.mqtt_gateway import GatewayMessage
from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.verification import load_authorities, load_own, sentence
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.core.client_ids import client_id
from robotkube.writes import writes

SESSION_SECONDS = 24 * 3600
KEEPALIVE_SECONDS = 15
CONNECT_SECONDS_MAX = 5.0
BACKOFF_SECONDS_MIN = 1.0
BACKOFF_SECONDS_MAX = 10.0
UNACKNOWLEDGED_MAX = 16
WAITING_MAX = 1000
WAITING_BYTES_MAX = 32 * 1024 * 1024
ANSWERS_QUEUED_MAX = 1000
QOS = 1
FAILURE = 0x80


class PahoGateway:
    """The port GatewayChannel: the session `name` of an account (robots.mqtt.core.client_ids makes its id of it)."""

    def __init__(self, account: BrokerAccount, name: str, jitter: Random = random.random) -> None:
        self._account = account
        self._jitter = jitter
        self._failures = 0
        self._waiting: queue.Queue[GatewayMessage] = queue.Queue()
        self._waiting_bytes = 0
        self._overrun = self._breaking_off = False
        self._topics: list[str] = []
        self._lock = threading.Lock()
        self._connection = 0
        self._complaint = f"{name}: not connected to the broker yet"
        client = mqtt.Client(
            CallbackAPIVersion.VERSION2, client_id(name, account.password), protocol=mqtt.MQTTv5, manual_ack=True
        )
        if account.login is not None:
            client.username_pw_set(*account.login)
        self._context = account.context()
        if self._context is not None:
            client.tls_set_context(self._context)
            client.on_pre_connect = self._trust
        client.connect_timeout = CONNECT_SECONDS_MAX
        client.max_queued_messages_set(ANSWERS_QUEUED_MAX)
        client.on_connect = self._connected
        client.on_disconnect = self._disconnected
        client.on_connect_fail = self._failed
        client.on_subscribe = self._subscribed
        client.on_message = self._received
        self._client = client

    @property
    def complaint(self) -> str:
        """The reason why there is no session, as the port says."""
        return self._complaint

    def start(self, topics: Sequence[str]) -> None:
        """Connect and subscribe, as the port says."""
        self._topics = list(topics)
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.SessionExpiryInterval = SESSION_SECONDS
        properties.ReceiveMaximum = UNACKNOWLEDGED_MAX
        account = self._account
        self._client.connect_async(
            account.host, account.port, KEEPALIVE_SECONDS, clean_start=False, properties=properties
        )
        self._client.loop_start()

    def receive(self, seconds: float) -> GatewayMessage | None:
        """Receive the next message, as the port says."""
        try:
            message = self._waiting.get(block=seconds > 0, timeout=seconds)
        except queue.Empty:
            self._break_off()
            return None
        with self._lock:
            self._waiting_bytes -= len(message.payload)
            stale = message.token[0] != self._connection  # it comes again, behind those before it
        return None if stale else message

    @writes("message")
    def acknowledge(self, message: GatewayMessage) -> None:
        """Acknowledge a message, as the port says. Packet numbers are those of one connection: an older one's mean
        nothing to the next."""
        connection, number, qos = message.token
        with self._lock:
            if connection == self._connection and qos:
                self._client.ack(number, qos)

    def leave(self, message: GatewayMessage) -> None:
        """Leave a message to a later connection, as the port says, and with it what waits behind it or still arrives on
        the connection that ends here."""
        with self._lock:
            current = message.token[0] == self._connection
            if current:
                self._begin()
                self._overrun = self._breaking_off = True
        if current:
            self._shut()

    @writes("message")
    def publish(self, topic: str, payload: bytes) -> bool:
        """Send an answer, as the port says. A broker sends what it kept before it answers the subscription: that can be
        answered, too."""
        if not self._client.is_connected():
            return False
        return self._client.publish(topic, payload, QOS).rc == mqtt.MQTT_ERR_SUCCESS

    def close(self) -> None:
        """End the connection, as the port says."""
        self._client.disconnect()
        self._client.loop_stop()

    def _connected(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure:
            self._complain(f"the broker refuses the connection: {reason}; check its account")
            return
        self._failures = 0
        with self._lock:
            self._begin()
        client.subscribe([(topic, QOS) for topic in self._topics])

    def _subscribed(self, client: Any, userdata: Any, mid: Any, reasons: Any, properties: Any) -> None:
        pairs = zip(self._topics, reasons, strict=False)
        refused = [topic for topic, reason in pairs if reason.value >= FAILURE]
        if refused:
            self._complain(f"the broker refuses {', '.join(refused)}; check its rights")
        else:
            self._complaint = ""

    def _disconnected(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        with self._lock:
            self._begin()
        self._forget()
        self._complain(f"the connection was lost: {reason}")
        self._put_off_next_attempt()

    def _failed(self, client: Any, userdata: Any) -> None:
        tls = self._account.tls
        broker = f"the broker {self._account.host}:{self._account.port}"
        error = sys.exc_info()[1]  # paho calls this while it handles what an attempt met
        if tls is not None and isinstance(error, ssl.SSLError):
            self._complain(f"no encrypted connection to {broker}: {sentence(error, tls)}")
        else:
            self._complain(f"{broker} does not answer")
        self._put_off_next_attempt()

    def _trust(self, client: Any, userdata: Any) -> None:
        """Trust, from now on, authorities that were added meanwhile, and prove the account by a renewed certificate."""
        if self._context is None or self._account.tls is None:
            return
        with contextlib.suppress(InputError):  # a file that is gone takes nothing away
            load_authorities(self._context, self._account.tls)
        with contextlib.suppress(InputError):
            if self._account.certificate is not None:
                load_own(self._context, self._account.certificate)

    def _put_off_next_attempt(self) -> None:
        """Tell paho, which waits after this, for how long: its own pauses are the same for all clients of a broker."""
        pause: Any = backoff(self._failures, BACKOFF_SECONDS_MIN, BACKOFF_SECONDS_MAX, self._jitter)
        self._failures += 1
        self._client.reconnect_delay_set(pause, pause)

    def _complain(self, text: str) -> None:
        self._complaint = f"task gateway: {text}"

    def _begin(self) -> None:
        """Count a new connection: what comes from now on belongs to it, or to none."""
        self._connection += 1
        self._overrun = self._breaking_off = False

    def _forget(self) -> None:
        """Drop what waits: what was not acknowledged comes again with the next connection."""
        while not self._waiting.empty():
            self.receive(0.0)

    def _received(self, client: Any, userdata: Any, message: Any) -> None:
        size = len(message.payload)
        payload = bytes(message.payload) if size <= MESSAGE_BYTES_MAX else b""
        with self._lock:
            full = self._waiting.qsize() >= WAITING_MAX or self._waiting_bytes + len(payload) > WAITING_BYTES_MAX
            self._overrun = self._overrun or full
            if not self._overrun:
                self._waiting_bytes += len(payload)
                self._waiting.put(
                    GatewayMessage(message.topic, payload, size, (self._connection, message.mid, message.qos))
                )

    def _break_off(self) -> None:
        """End a connection of which messages were left, when nothing else waits: paho connects again, and they come
        again."""
        with self._lock:
            due = self._overrun and not self._breaking_off and self._waiting.empty()
            self._breaking_off = self._breaking_off or due
        if due:
            self._shut()

    def _shut(self) -> None:
        connection: Any = self._client.socket()
        if connection is not None:
            with contextlib.suppress(OSError):  # it is gone already
                connection.shutdown(socket.SHUT_RDWR)
