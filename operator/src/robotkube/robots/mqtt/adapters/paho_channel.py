"""One MQTT 5 connection without threads of its own: the bridge's loop turns it.

Every connection attempt uses a new client object with the same client id. So the broker's session lives on (clean start
false, with an expiry) while nothing is resent behind the back of the outbox, which alone knows order and bounds.
Only the attempt itself (name look-up, TCP) runs on a short-lived thread, because it may block for seconds.
"""

from __future__ import annotations

import contextlib
import random
import select
import ssl
import threading
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.subscribeoptions import SubscribeOptions

from robotkube.backoffs import Random, backoff
from robotkube.errors import InputError, RobotKubeError
from robotkube.foundation.certificates.adapters.verification import alert_of, sentence
from robotkube.foundation.certificates.core.refusals import refused_own_certificate
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.adapters.paho_client import QOS, MqttClient, mqtt
from robotkube.robots.mqtt.adapters.tcp_sockets import SocketBound, socket_state
from robotkube.robots.mqtt.core.client_ids import client_id
from robotkube.robots.mqtt.core.packets import PACKET_BYTES_MAX
from robotkube.robots.mqtt.core.refused_subscriptions import RefusedSubscriptions, advice

if TYPE_CHECKING:  # the ports know every part's domain: 25 ms of a start
    from robotkube.robots.mqtt.ports import ChannelEvents

CONNECT_SECONDS_MAX = 5.0
KEEPALIVE_SECONDS = 5
BACKOFF_SECONDS_MIN, BACKOFF_SECONDS_MAX = 0.2, 1.0
"""The bound of the pause before the next attempt: at first, and at most. A robot on a lossy network is back within the
second after its broker is, after a third of one on average, and a fleet still spreads over that second."""
ALERT_SECONDS_MAX = 1.0
MISC_SECONDS = 1.0
RECEIVE_MAXIMUM = 65535  # of a broker that names none (MQTT 5, section 3.2.2.3.3)
NO_MATCHING_SUBSCRIBERS = 0x10
FAILURE = 0x80
CLOSED = (
    "the broker closes the connection before it answers. Where it speaks TLS at this port, the Secret with the account "
    "has the key tls: required, and its folder ca.crt"
)
REFUSED = "is the agent revoked (`robotkube agent list`), or its password another one by now?"
PACKET_HEAD_BYTES_MAX = 14  # of a PUBLISH beside topic, properties and payload


class PahoChannel:
    """A connection under `name`, of which core.client_ids makes its id. `account` is read at every attempt, since
    passwords may be replaced; the broker keeps the session for `session_seconds` after a loss. `bounded`: its socket
    takes no more than leaves soon."""

    def __init__(
        self,
        account: Callable[[], BrokerAccount],
        name: str,
        session_seconds: int,
        events: ChannelEvents,
        jitter: Random = random.random,
        bounded: bool = False,
    ) -> None:
        self._jitter = jitter
        self._socket_bound = SocketBound(bounded)
        self._account = account
        self._name = name
        self._session_seconds = session_seconds
        self._events = events
        self._client: MqttClient | None = None
        self._attempt: _Attempt | None = None
        self._failures = 0
        self._retry_at = self._misc_at = self._now = 0.0
        self._subscribing: dict[int, list[str]] = {}
        self._refused = RefusedSubscriptions()
        self._unacknowledged = 0
        self._receive_maximum = RECEIVE_MAXIMUM
        self._packet_bytes_max = PACKET_BYTES_MAX
        self._retains = True
        self._rejected: deque[tuple[int, str]] = deque()
        self._up = self._denied = self._closed = False
        self.complaint: str | None = f"{name}: not connected to the broker yet"

    def turn(self, now: float) -> None:
        """See the port."""
        self._now = now
        client = self._client
        if client is None:
            self._connect(now)
            return
        client.read_all()
        if self._client is client and now >= self._misc_at:
            self._misc_at = now + MISC_SECONDS
            client.loop_misc()
        self._subscribe(self._refused.due(now))

    def publish(self, topic: str, payload: bytes, retained: bool, properties: bytes = b"") -> int | None:
        """See the port."""
        if self._client is None or not self._up or self._unacknowledged >= self._receive_maximum:
            return None
        reason = self._limit_problem(len(topic.encode()) + len(properties) + len(payload), retained)
        if reason:  # the broker would end the connection, again and again
            self._rejected.append((self._client._mid_generate(), reason))
            return self._rejected[-1][0]
        self._unacknowledged += 1
        return self._client.send_message(topic, payload, retained, properties)

    def subscribe(self, topics: Sequence[str]) -> None:
        """See the port."""
        self._refused.forget(topics)
        self._subscribe(topics)

    def _subscribe(self, topics: Sequence[str]) -> None:
        if self._client is not None and self._up and topics:
            options = SubscribeOptions(qos=QOS, noLocal=True)  # what this connection sent does not come back
            code, mid = self._client.subscribe([(topic, options) for topic in topics])
            if code == mqtt.MQTT_ERR_SUCCESS and mid is not None:
                self._subscribing[mid] = list(topics)

    def unsubscribe(self, topics: Sequence[str]) -> None:
        """See the port."""
        self._refused.forget(topics)
        if self._client is not None and self._up and topics:
            self._client.unsubscribe(list(topics))

    def flush(self) -> None:
        """See the port."""
        while self._rejected:
            self._events.rejected(*self._rejected.popleft())
        if self._client is not None:
            self._client.write_all()
            if self.wants_write:
                self._socket_bound.full(self.socket, self._now)

    def close(self) -> None:
        """See the port; the session stays at the broker until it expires. No socket is left open, also by an attempt
        that is still at work."""
        attempt, client = self._attempt, self._client
        self._attempt = self._client = None
        if attempt is not None:
            attempt.abandon()
        if client is not None:
            with contextlib.suppress(OSError, ValueError):
                client.leave()
            client.drop()

    @property
    def socket(self) -> Any:
        """The connection's socket while there is one, else None."""
        return None if self._client is None else self._client.socket()

    @property
    def wants_write(self) -> bool:
        """See the port."""
        return self._client is not None and self._client.want_write()

    @property
    def congested(self) -> bool:
        """See the port."""
        return self.wants_write or (self.socket is not None and socket_state(self.socket).unsent_bytes > 0)

    def _limit_problem(self, content_bytes: int, retained: bool) -> str:
        """The limit that the broker stated and a message exceeds, in words; empty when it exceeds none."""
        size = content_bytes + PACKET_HEAD_BYTES_MAX
        size_max = self._packet_bytes_max
        if size > size_max:
            return f"a packet of {size} bytes, at most {size_max} are accepted; see the broker's max_packet_size"
        if retained and not self._retains:
            return "the broker retains no messages; let it (mosquitto: retain_available true)"
        return ""

    def _connect(self, now: float) -> None:
        if self._attempt is None:
            if now >= self._retry_at:
                self._attempt = _Attempt(self._new_client, self._account, self._closed)
                self._closed = False
            return
        if self._attempt.running:
            return
        attempt = self._attempt
        self._attempt = None
        if attempt.error is not None:
            self.complaint = f"{self._name}: {attempt.error}"
            self._lost()
            return
        self._client = attempt.client
        self._denied = False
        self._misc_at = now + MISC_SECONDS

    def _new_client(self, account: BrokerAccount) -> MqttClient:
        client = MqttClient(client_id(self._name, account.password), self._events.received, self._on_acknowledged)
        client.connect_timeout = CONNECT_SECONDS_MAX
        client.on_socket_open = self._on_socket
        client.on_socket_register_write = _written_by_turn
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_subscribe = self._on_subscribe
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.SessionExpiryInterval = self._session_seconds
        properties.ReceiveMaximum = RECEIVE_MAXIMUM
        properties.MaximumPacketSize = PACKET_BYTES_MAX
        client.session_properties = properties  # type: ignore[attr-defined]
        return client

    def _on_socket(self, client: Any, userdata: Any, connection: Any) -> None:
        self._socket_bound.opened(connection)

    def _on_connect(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        if client is not self._client or reason.value >= FAILURE:
            self.complaint = f"{self._name}: the broker refuses the connection: {reason}; {REFUSED}"
            self._denied = True
            return
        self._up = True
        self.complaint = None
        self._failures = 0
        self._subscribing.clear()
        self._refused.clear()
        self._unacknowledged = 0
        self._receive_maximum = getattr(properties, "ReceiveMaximum", RECEIVE_MAXIMUM)
        self._packet_bytes_max = min(getattr(properties, "MaximumPacketSize", PACKET_BYTES_MAX), PACKET_BYTES_MAX)
        self._retains = bool(getattr(properties, "RetainAvailable", True))
        self._events.connected(bool(flags.session_present))

    def _on_disconnect(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        if client is not self._client:
            return
        self._client = None
        if self._up:
            self.complaint = f"{self._name}: the connection was lost: {reason}"
        elif not self._denied:
            self.complaint = f"{self._name}: {CLOSED}"
            self._closed = True
        self._lost()

    def _on_acknowledged(self, mid: int, reason: int) -> None:
        self._unacknowledged = max(0, self._unacknowledged - 1)
        if reason >= FAILURE:
            refusal = f"the broker refuses a message (reason {reason:#x} of MQTT 5)"
            self._events.rejected(mid, refusal + advice(reason))
        else:
            self._events.acknowledged(mid, reason != NO_MATCHING_SUBSCRIBERS)

    def _on_subscribe(self, client: Any, userdata: Any, mid: int, reasons: Any, properties: Any) -> None:
        for topic, reason in zip(self._subscribing.pop(mid, []), reasons, strict=False):
            if reason.value >= FAILURE:
                refusal = f"the broker refuses the subscription: {reason}"
                self._refused.refused(topic, self._now)
                self._events.refused(topic, refusal + advice(reason.value))
            elif self._refused.granted(topic):
                self._events.granted(topic)

    def _lost(self) -> None:
        """Let the next attempt wait for the back-off, after a failed attempt or a lost connection."""
        was_up = self._up
        self._up = False
        self._rejected.clear()
        pause = backoff(self._failures, BACKOFF_SECONDS_MIN, BACKOFF_SECONDS_MAX, self._jitter)
        self._failures += 1
        self._retry_at = self._now + pause
        if was_up:
            self._events.disconnected()


class _Attempt:
    """One connection attempt on a thread of its own, bounded by CONNECT_SECONDS_MAX per address. `closed`: the broker
    ended the one before without a word, so it is asked first what it thinks of the account's certificate."""

    def __init__(
        self,
        new_client: Callable[[BrokerAccount], MqttClient],
        account: Callable[[], BrokerAccount],
        closed: bool = False,
    ) -> None:
        self._closed = closed
        self.client: MqttClient | None = None
        self.error: str | None = None
        self._abandoned = False
        self._outcome = threading.Lock()
        self._new_client = new_client
        self._account = account
        self._thread = threading.Thread(target=self._run, name="connect", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Return whether the outcome is still open."""
        return self._thread.is_alive()

    def abandon(self) -> None:
        """Close the connection, now or as soon as it is made: nobody will use it."""
        with self._outcome:
            self._abandoned = True
            if self.client is not None:
                self.client.drop()
                self.client = None

    def _run(self) -> None:
        client = account = None
        try:
            account = self._account()
            client = self._new_client(account)
            if account.login is not None:
                client.username_pw_set(*account.login)
            context = account.context()
            if context is not None:
                client.encrypt(context)
                refusal = self._refusal(account, context)
                if refusal:
                    raise InputError(refusal)
            properties = client.session_properties  # type: ignore[attr-defined]
            client.connect(account.host, account.port, KEEPALIVE_SECONDS, clean_start=False, properties=properties)
        except (OSError, ValueError, RobotKubeError) as error:
            if client is not None:
                client.drop()
            self.error = _failure(error, account)
            return
        with self._outcome:
            if self._abandoned:
                client.drop()
            else:
                self.client = client

    def _refusal(self, account: BrokerAccount, context: ssl.SSLContext) -> str:
        """What the broker has against the account's certificate, or that there is none; empty when it says nothing."""
        if not self._closed:
            return ""
        return refused_own_certificate(alert_of(account.host, account.port, context, ALERT_SECONDS_MAX))


def _failure(error: Exception, account: BrokerAccount | None) -> str:
    """What an attempt met, in words."""
    if isinstance(error, InputError):
        return str(error)
    if account is not None and account.tls is not None and isinstance(error, ssl.SSLError):
        return f"no encrypted connection to the broker {account.host}:{account.port}: {sentence(error, account.tls)}"
    return f"the broker does not answer: {error or type(error).__name__}"


def _written_by_turn(client: Any, userdata: Any, connection: Any) -> None:
    """A callback without content: its presence makes paho queue packets until `write_all`."""


def wait(channels: Iterable[PahoChannel], prompt: Iterable[PahoChannel], seconds: float) -> bool:
    """Sleep until a connection can go on writing, or one of `prompt` can be read; False when the time was over."""
    writing = [c.socket for c in channels if c.wants_write and c.socket is not None]
    reading = [c.socket for c in prompt if c.socket is not None]
    readable, writable, _ = select.select(reading, writing, [], max(seconds, 0.0))
    return bool(readable or writable)
