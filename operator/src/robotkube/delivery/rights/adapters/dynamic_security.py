"""The port BrokerControl by mosquitto's dynamic security plugin, over one MQTT connection of the account `rights`."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robotkube.delivery.rights.core.control import REQUESTS, RESPONSES
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.adapters.paho_channel import PahoChannel, wait

CONNECTION = "rights"
ANSWER_SECONDS_MAX = 5.0
SESSION_SECONDS = 0  # answers of before a loss are of no use after it


class DynamicSecurity:
    """A connection that asks and waits for the answer; the events of its channel are its own."""

    def __init__(self, account: Callable[[], BrokerAccount], answer_seconds: float = ANSWER_SECONDS_MAX) -> None:
        self.connections = 0
        self._answer_seconds = answer_seconds
        self._answers: dict[str, Mapping[str, Any]] = {}
        self._asked = 0
        self._refusal = ""
        self._channel = PahoChannel(account, CONNECTION, SESSION_SECONDS, self)

    @property
    def complaint(self) -> str | None:
        """See the port."""
        return self._channel.complaint

    def turn(self) -> None:
        """See the port."""
        self._channel.turn(time.monotonic())
        self._channel.flush()

    def ask(self, requests: Sequence[Mapping[str, Any]]) -> Sequence[Mapping[str, Any]]:
        """See the port: all of them are one message, so that the broker carries them out without anything between."""
        numbers = [str(self._asked + number) for number in range(len(requests))]
        self._asked += len(requests)
        commands = [{**request, "correlationData": number} for request, number in zip(requests, numbers, strict=True)]
        self._answers.clear()
        self._refusal = self._channel.complaint or ""
        payload = json.dumps({"commands": commands}).encode()
        if not self._refusal and self._channel.publish(REQUESTS, payload, False) is None:
            self._refusal = "the broker takes no more messages now"
        self._wait_for(numbers)
        answers = [self._answers[number] for number in numbers]
        refused = [f"{answer.get('command')}: {answer['error']}" for answer in answers if answer.get("error")]
        if refused:
            raise InputError(f"the broker refuses a change of rights: {'; '.join(refused)}")
        return answers

    def _wait_for(self, numbers: Sequence[str]) -> None:
        end = time.monotonic() + self._answer_seconds
        while not all(number in self._answers for number in numbers):
            left = end - time.monotonic()
            if self._refusal or left <= 0:
                why = self._refusal or f"no answer within {self._answer_seconds:g} s"
                raise UnavailableError(f"the broker's rights cannot be read or changed: {why}")
            self.turn()
            wait([self._channel], [self._channel], min(left, 0.05))
            self._channel.turn(time.monotonic())

    def close(self) -> None:
        """See the port."""
        self._channel.close()

    # port ChannelEvents ----------------------------------------------------------------------------------------------

    def connected(self, session_kept: bool) -> None:
        """Hear the answers to what will be asked."""
        self.connections += 1
        self._channel.subscribe([RESPONSES])

    def disconnected(self) -> None:
        """Let who waits know."""
        self._refusal = self._channel.complaint or "the connection was lost"

    def acknowledged(self, token: int, heard: bool) -> None:
        """The broker has a request; its answer is a message of its own."""

    def rejected(self, token: int, reason: str) -> None:
        """The account may not change rights, or the plugin is not there."""
        self._refusal = f"{reason}. Is the account `rights` there, and the plugin dynamic_security loaded?"

    def refused(self, topic: str, reason: str) -> None:
        """The account may not hear answers."""
        self._refusal = f"{topic}: {reason}"

    def granted(self, topic: str) -> None:
        """The account may hear answers after all; the next question will tell."""

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        """Keep the answers of one message, by the number of what was asked."""
        try:
            document = read_json(payload.decode())
            for answer in document["responses"]:
                self._answers[str(answer.get("correlationData", ""))] = answer
        except (ValueError, KeyError, TypeError, AttributeError):
            self._refusal = "an answer that cannot be read"
