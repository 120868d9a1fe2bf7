"""One MQTT 5 connection without threads of its own: the bridge's loop turns it.

Every connection attempt uses a new client object with the same client id. So the broker's session lives on (clean start
false, with an expiry) while nothing is resent behind the back of the outbox, which alone knows order and bounds.
Only the attempt itself (name look-up, TCP) runs on a short-lived thread, because it may block for seconds.
"""

from __future__ import annotations

import contextlib
import random
import select
import socket
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if "paho.mqtt.client" not in sys.modules and "dns" not in sys.modules:
    # paho imports dnspython where it is installed, for a look-up that is not used here: 100 ms of every start
    sys.modules["dns"] = None  # type: ignore[assignment]
    import paho.mqtt.client as mqtt

    del sys.modules["dns"]
else:
    import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import MQTTException, Properties
from paho.mqtt.subscribeoptions import SubscribeOptions

from robotkube.backoffs import Random, backoff
from robotkube.errors import RobotKubeError
from robotkube.robots.mqtt.core.packets import (
    PACKET_BYTES_MAX,
    MalformedPacketError,
    packet_bounds,
    read_number,
    write_number,
)

if TYPE_CHECKING:  # the ports know every part's domain: 25 ms of a start
    from robotkube.robots.mqtt.ports import ChannelEvents

CONNECT_SECONDS_MAX = 5.0
KEEPALIVE_SECONDS = 5
BACKOFF_SECONDS_MIN, BACKOFF_SECONDS_MAX = 0.2, 1.0
"""The bound of the pause before the next attempt: at first, and at most. A robot on a lossy network is back within the
second after its broker is, after a third of one on average, and a fleet still spreads over that second."""
MISC_SECONDS = 1.0
LEAVE_SECONDS_MAX = 0.5
"""The bound of a farewell. A broker has read all of it in milliseconds; one that is away does not matter."""
READS_PER_TURN_MAX = 1000
RECEIVE_BYTES = 256 * 1024
RECEIVE_MAXIMUM = 65535  # of a broker that names none (MQTT 5, section 3.2.2.3.3)
MERGED_BYTES_MAX = 16 * 1024
NO_MATCHING_SUBSCRIBERS = 0x10
FAILURE = 0x80
NOT_ALLOWED = frozenset([0x80, 0x83, 0x87])  # unspecified, implementation specific, not authorized: what an ACL gives
QOS = 1
QOS_BITS = 0x06  # of a PUBLISH: 0 when it is not acknowledged
PUBLISH, PUBLISH_QOS_1, PUBACK, DISCONNECT = 0x30, 0x32, 0x40, 0xE0
FAREWELL = bytes((DISCONNECT, 0))  # success: the broker publishes no last will
PACKET_HEAD_BYTES_MAX = 14  # of a PUBLISH beside topic, properties and payload

_MID = struct.Struct("!H")
_ACKNOWLEDGEMENT = struct.Struct("!BBH")

MessageReceived = Callable[[str, bytes, bytes], None]
MessageAcknowledged = Callable[[int, int], None]


@dataclass(frozen=True)
class BrokerAccount:
    """An account at a broker: its address and credentials."""

    host: str
    port: int
    username: str
    password: str


class _Client(mqtt.Client):
    """paho's client, which keeps the connection, with a path of its own for messages and their acknowledgements.

    paho makes objects for the properties of every packet and three system calls to read one: 150 us for a message and
    its acknowledgement, 30 us here. All packets but those two go to paho as it expects them."""

    def __init__(self, client_id: str, received: MessageReceived, acknowledged: MessageAcknowledged) -> None:
        super().__init__(CallbackAPIVersion.VERSION2, client_id=client_id, protocol=mqtt.MQTTv5)
        self._message_received = received
        self._message_acknowledged = acknowledged
        self._buffer = bytearray()

    def read_all(self) -> None:
        """Handle every packet that is here."""
        for _ in range(READS_PER_TURN_MAX):
            if self._sock is None:
                return
            try:
                data = self._sock.recv(RECEIVE_BYTES)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self._loop_rc_handle(mqtt.MQTT_ERR_CONN_LOST)
                return
            self._buffer += data
            self._last_msg_in = time.monotonic()
            try:
                if not self._handle_buffer():
                    return
            except MalformedPacketError:
                self._loop_rc_handle(mqtt.MQTT_ERR_PROTOCOL)
                return
            if len(data) < RECEIVE_BYTES:
                return

    def send_message(self, topic: str, payload: bytes, retained: bool, properties: bytes) -> int:
        """Queue a PUBLISH with QoS 1; its packet identifier."""
        mid = self._mid_generate()
        name = topic.encode()
        size = write_number(len(properties))
        length = write_number(len(name) + 4 + len(size) + len(properties) + len(payload))
        head = struct.pack(f"!H{len(name)}sH", len(name), name, mid)
        parts = (bytes((PUBLISH_QOS_1 | retained,)), length, head, size, properties, payload)
        self._out_packet.append(_packet(b"".join(parts)))
        return mid

    def write_all(self) -> None:
        """Send what is queued, small packets together."""
        queue = self._out_packet
        if len(queue) > 1 and sum(packet["to_process"] for packet in queue) <= MERGED_BYTES_MAX:
            data = b"".join(packet["packet"][packet["pos"] :] for packet in queue)
            queue.clear()
            queue.append(_packet(data))
        if queue:
            self.loop_write()

    def leave(self) -> None:
        """Send what is queued and a DISCONNECT, and close the socket when the broker has: it may be about to write, and
        on a socket that is closed already that fails before it has read our last acknowledgements. Their messages would
        come again in the next session."""
        connection: Any = self._sock
        if connection is not None:
            self._out_packet.append(_packet(FAREWELL))
            self.write_all()
            connection.shutdown(socket.SHUT_WR)
            end = time.monotonic() + LEAVE_SECONDS_MAX
            while (left := end - time.monotonic()) > 0 and select.select([connection], [], [], left)[0]:
                if not connection.recv(RECEIVE_BYTES):
                    return

    def drop(self) -> None:
        """Close the socket, whatever waits to be sent."""
        self._sock_close()

    def _handle_buffer(self) -> bool:
        """Handle the whole packets in the buffer; False when the connection ended on one."""
        buffer = self._buffer
        size = len(buffer)
        place = 0
        while (whole := packet_bounds(buffer, place, size)) is not None:
            begin, end = whole
            command = buffer[place]
            place = end
            if command & 0xF0 == PUBLISH:
                self._handle_message(command, buffer, begin, end)
            elif command == PUBACK:
                if end < begin + _MID.size:
                    raise MalformedPacketError(f"an acknowledgement of {end - begin} bytes")
                (mid,) = _MID.unpack_from(buffer, begin)
                self._message_acknowledged(mid, buffer[begin + 2] if end > begin + 2 else 0)
            elif not self._handle_other(command, bytes(buffer[begin:end])):
                return False
        del buffer[:place]
        return True

    def _handle_message(self, command: int, buffer: bytearray, begin: int, end: int) -> None:
        place = begin + _MID.size
        if place <= end:
            place += _MID.unpack_from(buffer, begin)[0]
        topic = buffer[begin + _MID.size : place].decode(errors="replace")
        acknowledged = command & QOS_BITS
        mid = place
        place += _MID.size if acknowledged else 0
        properties = read_number(buffer, place, end)
        if properties is None or sum(properties) > end:
            raise MalformedPacketError(f"a message of {end - begin} bytes ends before its content")
        size, place = properties
        self._message_received(topic, bytes(buffer[place + size : end]), bytes(buffer[place : place + size]))
        if acknowledged:
            (number,) = _MID.unpack_from(buffer, mid)
            self._out_packet.append(_packet(_ACKNOWLEDGEMENT.pack(PUBACK, 2, number)))

    def _handle_other(self, command: int, packet: bytes) -> bool:
        """Give a packet to paho in the form in which it reads one; False when the connection ended."""
        self._in_packet = {
            "command": command,
            "have_remaining": 1,
            "remaining_count": [],
            "remaining_mult": 1,
            # paho reads the reason of a DISCONNECT only if more follows it
            "remaining_length": max(len(packet), 3) if command == DISCONNECT and packet else len(packet),
            "packet": bytearray(packet),
            "to_process": 0,
            "pos": 0,
        }
        try:
            code = self._packet_handle()
        except (ValueError, IndexError, KeyError, struct.error, AssertionError, MQTTException) as error:
            raise MalformedPacketError(f"packet {command:#x}: {error}") from error
        if code > 0:
            self._loop_rc_handle(code)
        return self._sock is not None


def _packet(data: bytes) -> Any:
    """A packet in paho's queue that needs nothing after it was sent."""
    return {
        "command": PUBACK,
        "mid": 0,
        "qos": QOS,
        "pos": 0,
        "to_process": len(data),
        "packet": data,
        "info": None,
    }


class PahoChannel:
    """A connection under `client_id`. `account` is read at every attempt, since passwords may be replaced; the broker
    keeps the session for `session_seconds` after a loss."""

    def __init__(
        self,
        account: Callable[[], BrokerAccount],
        client_id: str,
        session_seconds: int,
        events: ChannelEvents,
        jitter: Random = random.random,
    ) -> None:
        self._jitter = jitter
        self._account = account
        self._client_id = client_id
        self._session_seconds = session_seconds
        self._events = events
        self._client: _Client | None = None
        self._attempt: _Attempt | None = None
        self._failures = 0
        self._retry_at = self._misc_at = self._now = 0.0
        self._subscribing: dict[int, list[str]] = {}
        self._unacknowledged = 0
        self._receive_maximum = RECEIVE_MAXIMUM
        self._packet_bytes_max = PACKET_BYTES_MAX
        self._retains = True
        self._rejected: deque[tuple[int, str]] = deque()
        self._up = False
        self.complaint: str | None = f"{client_id}: not connected to the broker yet"

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
        if self._client is not None and self._up and topics:
            options = SubscribeOptions(qos=QOS, noLocal=True)  # what this connection sent does not come back
            code, mid = self._client.subscribe([(topic, options) for topic in topics])
            if code == mqtt.MQTT_ERR_SUCCESS and mid is not None:
                self._subscribing[mid] = list(topics)

    def unsubscribe(self, topics: Sequence[str]) -> None:
        """See the port."""
        if self._client is not None and self._up and topics:
            self._client.unsubscribe(list(topics))

    def flush(self) -> None:
        """See the port."""
        while self._rejected:
            self._events.rejected(*self._rejected.popleft())
        if self._client is not None:
            self._client.write_all()

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
        """Whether packets wait for the socket."""
        return self._client is not None and self._client.want_write()

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
                self._attempt = _Attempt(self._new_client, self._account)
            return
        if self._attempt.running:
            return
        attempt = self._attempt
        self._attempt = None
        if attempt.error is not None:
            self.complaint = f"{self._client_id}: {attempt.error}"
            self._lost()
            return
        self._client = attempt.client
        self._misc_at = now + MISC_SECONDS

    def _new_client(self) -> _Client:
        client = _Client(self._client_id, self._events.received, self._on_acknowledged)
        client.connect_timeout = CONNECT_SECONDS_MAX
        client.on_socket_open = _prepare_socket
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

    def _on_connect(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        if client is not self._client or reason.value >= FAILURE:
            self.complaint = f"{self._client_id}: the broker refuses the connection: {reason}"
            return
        self._up = True
        self.complaint = None
        self._failures = 0
        self._subscribing.clear()
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
            self.complaint = f"{self._client_id}: the connection was lost: {reason}"
        self._lost()

    def _on_acknowledged(self, mid: int, reason: int) -> None:
        self._unacknowledged = max(0, self._unacknowledged - 1)
        if reason >= FAILURE:
            refusal = f"the broker refuses a message (reason {reason:#x} of MQTT 5)"
            self._events.rejected(mid, refusal + _advice(reason))
        else:
            self._events.acknowledged(mid, reason != NO_MATCHING_SUBSCRIBERS)

    def _on_subscribe(self, client: Any, userdata: Any, mid: int, reasons: Any, properties: Any) -> None:
        for topic, reason in zip(self._subscribing.pop(mid, []), reasons, strict=False):
            if reason.value >= FAILURE:
                refusal = f"the broker refuses the subscription: {reason}"
                self._events.refused(topic, refusal + _advice(reason.value))

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
    """One connection attempt on a thread of its own, bounded by CONNECT_SECONDS_MAX per address."""

    def __init__(self, new_client: Callable[[], _Client], account: Callable[[], BrokerAccount]) -> None:
        self.client: _Client | None = None
        self.error: str | None = None
        self._abandoned = False
        self._outcome = threading.Lock()
        self._new_client = new_client
        self._account = account
        self._thread = threading.Thread(target=self._run, name="connect", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the outcome is still open."""
        return self._thread.is_alive()

    def abandon(self) -> None:
        """Close the connection, now or as soon as it is made: nobody will use it."""
        with self._outcome:
            self._abandoned = True
            if self.client is not None:
                self.client.drop()
                self.client = None

    def _run(self) -> None:
        client = None
        try:
            account = self._account()
            client = self._new_client()
            client.username_pw_set(account.username, account.password)
            properties = client.session_properties  # type: ignore[attr-defined]
            client.connect(account.host, account.port, KEEPALIVE_SECONDS, clean_start=False, properties=properties)
        except (OSError, ValueError, RobotKubeError) as error:
            if client is not None:
                client.drop()
            self.error = f"the broker does not answer: {error or type(error).__name__}"
            return
        with self._outcome:
            if self._abandoned:
                client.drop()
            else:
                self.client = client


def _advice(reason: int) -> str:
    """The place where the reason of a refusal stands, as the end of its sentence."""
    return f"; look at the broker's {'ACL for this agent' if reason in NOT_ALLOWED else 'limits and log'}"


def _prepare_socket(client: Any, userdata: Any, connection: Any) -> None:
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def _written_by_turn(client: Any, userdata: Any, connection: Any) -> None:
    """A callback without content: its presence makes paho queue packets until `write_all`."""


def wait(channels: Iterable[PahoChannel], prompt: Iterable[PahoChannel], seconds: float) -> bool:
    """Sleep until a connection can go on writing, or one of `prompt` can be read; False when the time was over."""
    writing = [c.socket for c in channels if c.wants_write and c.socket is not None]
    reading = [c.socket for c in prompt if c.socket is not None]
    readable, writable, _ = select.select(reading, writing, [], max(seconds, 0.0))
    return bool(readable or writable)
