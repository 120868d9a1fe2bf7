"""A connection to a broker that receives everything that others publish, as they publish it (MQTT 5)."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.subscribeoptions import SubscribeOptions

from robotkube.errors import UnavailableError
from robotkube.foundation.certificates.adapters.verification import sentence
from robotkube.registry.suites.ports.interfaces import BrokerMessage
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.core.client_ids import client_id

CONNECT_SECONDS_MAX = 10.0
WAITING_MAX = 5_000
KEEPALIVE_SECONDS = 30


class PahoObserver:
    """Subscribed to everything when it is made; UnavailableError when the broker does not answer or refuses.

    Own messages do not come back, kept ones of the past neither; QoS and retain flag are those of the publisher."""

    def __init__(self, account: BrokerAccount, name: str) -> None:
        self._waiting: deque[BrokerMessage] = deque(maxlen=WAITING_MAX)
        self._subscribed = threading.Event()
        self._refusal = ""
        client = mqtt.Client(
            CallbackAPIVersion.VERSION2, client_id=client_id(name, account.password), protocol=mqtt.MQTTv5
        )
        if account.login is not None:
            client.username_pw_set(*account.login)
        context = account.context()
        if context is not None:
            client.tls_set_context(context)
        client.on_connect = self._connected
        client.on_subscribe = self._answered
        client.on_message = self._received
        self._client = client
        try:
            client.connect(account.host, account.port, KEEPALIVE_SECONDS)
        except OSError as error:
            words = error if account.tls is None else sentence(error, account.tls)
            raise UnavailableError(f"broker {account.host}:{account.port}: {words}") from error
        client.loop_start()
        if not self._subscribed.wait(CONNECT_SECONDS_MAX) or self._refusal:
            self.close()
            raise UnavailableError(f"broker {account.host}:{account.port}: {self._refusal or 'does not answer'}")

    def receive(self) -> list[BrokerMessage]:
        """See the port."""
        return [self._waiting.popleft() for _ in range(len(self._waiting))]

    def publish(self, message: BrokerMessage) -> None:
        """See the port."""
        self._client.publish(message.topic, message.payload, message.qos, message.retain)

    def close(self) -> None:
        """End the connection."""
        self._client.disconnect()
        self._client.loop_stop()

    def _connected(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure:
            self._end(f"refuses the connection: {reason}")
            return
        options = SubscribeOptions(
            qos=2, noLocal=True, retainAsPublished=True, retainHandling=SubscribeOptions.RETAIN_DO_NOT_SEND
        )
        client.subscribe("#", options=options)

    def _answered(self, client: Any, userdata: Any, mid: Any, reasons: Any, properties: Any) -> None:
        refused = [str(reason) for reason in reasons if reason.is_failure]
        self._end(f"refuses the subscription of everything: {refused[0]}" if refused else "")

    def _end(self, refusal: str) -> None:
        self._refusal = refusal
        self._subscribed.set()

    def _received(self, client: Any, userdata: Any, message: Any) -> None:
        self._waiting.append(BrokerMessage(message.topic, bytes(message.payload), message.qos, bool(message.retain)))
