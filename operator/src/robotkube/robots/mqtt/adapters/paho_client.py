"""paho's MQTT 5 client with a path of its own for messages and their acknowledgements, in clear text or by TLS."""

from __future__ import annotations

import select
import socket
import ssl
import struct
import sys
import time
from collections.abc import Callable
from typing import Any

if "paho.mqtt.client" not in sys.modules and "dns" not in sys.modules:
    # paho imports dnspython where it is installed, for a look-up that is not used here: 100 ms of every start
    sys.modules["dns"] = None  # type: ignore[assignment]
    import paho.mqtt.client as mqtt

    del sys.modules["dns"]
else:
    import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.properties import MQTTException

from robotkube.robots.mqtt.core.packets import MalformedPacketError, packet_bounds, read_number, write_number

__all__ = ["QOS", "MessageAcknowledged", "MessageReceived", "MqttClient", "mqtt"]

LEAVE_SECONDS_MAX = 0.5
"""The bound of a farewell. A broker has read all of it in milliseconds; one that is away does not matter."""
READS_PER_TURN_MAX = 1000
RECEIVE_BYTES = 256 * 1024
RECORD_BYTES_MAX = 16 * 1024  # of TLS
MERGED_BYTES_MAX = 16 * 1024
QOS = 1
QOS_BITS = 0x06  # of a PUBLISH: 0 when it is not acknowledged
PUBLISH, PUBLISH_QOS_1, PUBACK, DISCONNECT = 0x30, 0x32, 0x40, 0xE0
FAREWELL = bytes((DISCONNECT, 0))  # success: the broker publishes no last will

_MID = struct.Struct("!H")
_ACKNOWLEDGEMENT = struct.Struct("!BBH")

MessageReceived = Callable[[str, bytes, bytes], None]
MessageAcknowledged = Callable[[int, int], None]


class MqttClient(mqtt.Client):
    """paho's client, which keeps the connection, with a path of its own for messages and their acknowledgements.

    paho makes objects for the properties of every packet and three system calls to read one: 150 us for a message and
    its acknowledgement, 30 us here. All packets but those two go to paho as it expects them."""

    def __init__(self, client_id: str, received: MessageReceived, acknowledged: MessageAcknowledged) -> None:
        super().__init__(CallbackAPIVersion.VERSION2, client_id=client_id, protocol=mqtt.MQTTv5)
        self._message_received = received
        self._message_acknowledged = acknowledged
        self._buffer = bytearray()
        self.encrypted = False
        self.receive_bytes = RECEIVE_BYTES

    def encrypt(self, context: ssl.SSLContext) -> None:
        """Connect by TLS, which gives one record at a time, however much has arrived."""
        self.tls_set_context(context)
        self.encrypted = True
        self.receive_bytes = RECORD_BYTES_MAX

    def read_all(self) -> None:
        """Handle every packet that is here."""
        for _ in range(READS_PER_TURN_MAX):
            if self._sock is None:
                return
            try:
                data = self._sock.recv(self.receive_bytes)
            except (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError):
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
            if len(data) < self.receive_bytes and not self.encrypted:
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
        "packet": memoryview(data),  # paho cuts off what was sent: by TLS that are 16 KiB of a cloud's 3 MB
        "info": None,
    }
