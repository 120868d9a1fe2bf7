"""One MQTT 5 connection of a test, and what the broker answers to it."""

from __future__ import annotations

import threading
from typing import Any

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from robotkube.foundation.certificates.adapters.verification import ServerVerification, client_context

ANSWER_SECONDS_MAX = 30.0
SESSION_SECONDS = 60
NOT_AUTHORISED = 135
NOBODY_HEARS = 16


class Connection:
    """One connection: `received` collects messages; publishing and subscribing give the broker's reason code. `will`
    is a topic on which its last will is published; `tls`: how the broker proves who it is, None: in clear text.
    `client_id`: of a session that is kept for a minute; `session_kept`: whether there was one."""

    def __init__(
        self,
        port: int,
        username: str | None,
        password: str | None,
        will: str = "",
        tls: ServerVerification | None = None,
        client_id: str = "",
    ) -> None:
        self.received: list[tuple[str, bytes]] = []
        self.arrived = threading.Condition()
        self.refused: int | None = None
        self.lost = self.session_kept = False
        self._answers: dict[int, int] = {}
        self._connected = threading.Event()
        self._client = mqtt.Client(
            CallbackAPIVersion.VERSION2, client_id, protocol=mqtt.MQTTv5, reconnect_on_failure=False
        )
        if username is not None:
            self._client.username_pw_set(username, password)
        if tls is not None:
            self._client.tls_set_context(client_context(tls))
        if will:
            self._client.will_set(will, b"last will", qos=1)
        self._client.on_connect = self._on_connect
        self._client.on_disconnect = self._on_disconnect
        self._client.on_message = self._on_message
        self._client.on_publish = lambda _c, _u, mid, code, _p: self._answer(mid, code.value)
        self._client.on_subscribe = lambda _c, _u, mid, codes, _p: self._answer(mid, codes[0].value)
        session = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        session.SessionExpiryInterval = SESSION_SECONDS if client_id else 0
        self._client.connect("127.0.0.1", port, keepalive=10, clean_start=not client_id, properties=session)
        self._client.loop_start()
        assert self._connected.wait(ANSWER_SECONDS_MAX)

    def _on_connect(self, _client: Any, _data: Any, flags: Any, code: Any, _properties: Any) -> None:
        self.session_kept = bool(flags.session_present)
        self.refused = code.value if code.is_failure else None
        self._connected.set()

    def _on_disconnect(self, _client: Any, _data: Any, _flags: Any, _code: Any, _properties: Any) -> None:
        self.lost = True

    def _on_message(self, _client: Any, _data: Any, message: Any) -> None:
        with self.arrived:
            self.received.append((message.topic, message.payload))
            self.arrived.notify_all()

    def _answer(self, mid: int, code: int) -> None:
        with self.arrived:
            self._answers[mid] = code
            self.arrived.notify_all()

    def _code(self, mid: int) -> int:
        with self.arrived:
            assert self.arrived.wait_for(lambda: mid in self._answers, ANSWER_SECONDS_MAX), "no answer"
            return self._answers[mid]

    def subscribe(self, topic: str) -> int:
        _, mid = self._client.subscribe(topic, qos=1)
        assert mid is not None
        return self._code(mid)

    def publish(self, topic: str, payload: bytes = b"x", retain: bool = False) -> int:
        return self._code(self._client.publish(topic, payload, qos=1, retain=retain).mid)

    def say(self, topic: str, payload: bytes = b"x", retain: bool = False) -> None:
        """Publish what the broker has to take, whether or not somebody hears it."""
        assert self.publish(topic, payload, retain) in (0, NOBODY_HEARS)

    def topics(self, count: int) -> list[str]:
        """The topics received, once `count` have come: the broker hands out in the order in which it takes, so what it
        took before and should not hand out would be among them."""
        with self.arrived:
            self.arrived.wait_for(lambda: len(self.received) >= count, ANSWER_SECONDS_MAX)
            return [topic for topic, _ in self.received]

    def until(self, payload: bytes) -> set[str]:
        """The topics received, once this payload has come."""
        with self.arrived:
            came = self.arrived.wait_for(lambda: any(p == payload for _, p in self.received), ANSWER_SECONDS_MAX)
            assert came, self.received
            return {topic for topic, _ in self.received}

    def drop(self) -> None:
        """End without a farewell, so that the broker publishes the last will."""
        connection: Any = self._client.socket()
        assert connection is not None
        connection.shutdown(2)
        self._forget()

    def close(self) -> None:
        self._client.disconnect()
        self._forget()

    def _forget(self) -> None:
        client = self._client
        client.loop_stop()
        client.on_connect = client.on_disconnect = client.on_message = client.on_publish = client.on_subscribe = (
            None  # they hold it in a circle
        )
