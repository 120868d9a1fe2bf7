"""The observer pod of a suite: it observes what a chart opens (`interface`), or sends to all its inputs (`install`)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.registry.catalogue.core.expected_topics import IN, ExpectedTopic
from robotkube.registry.suites.core.interface_observations import Observation, read_observation, with_broker_log
from robotkube.registry.suites.loops.interface_observer import ObserverTimeouts
from robotkube.registry.suites.ports.suites import SuiteAccount, SuiteNamespace

OBSERVER = ("robotkube-suite-observer",)
CONFIG, DATABASE_AUTHORITY = "config.json", "database-ca.crt"
POD_SECONDS = 30.0
OBSERVE_SECONDS_MIN = 15.0
TEXT_CHARACTERS_MAX = 1_500


@dataclass(frozen=True)
class ObserverPod:
    """The pod for one installed set. `image` is the reference of the image with rclpy; `broker`: whether there is one;
    each `token` is a word that nobody can guess, under which the observer is known."""

    image: str
    test_namespace: SuiteNamespace
    broker: bool
    database: SuiteAccount | None
    bounds: ObserverTimeouts = field(default_factory=ObserverTimeouts)

    def clear(self, token: str) -> None:
        """Delete what the set before wrote to the database."""
        self._run((), token, OBSERVE_SECONDS_MIN, clear=True)

    def observe(self, expected: Sequence[ExpectedTopic], token: str, log_length_before: int) -> Observation:
        """What the chart opens and does; InputError when the observer failed."""
        wanted = self.bounds.whole(sum(topic.direction == IN for topic in expected))
        seconds = max(OBSERVE_SECONDS_MIN, min(wanted, self.test_namespace.seconds_left / 2 - POD_SECONDS))
        observation = self._run(expected, token, seconds)
        return with_broker_log(observation, self.test_namespace.broker_log()[log_length_before:], f"suite-{token}")

    def look(self, topics: Sequence[ExpectedTopic], token: str) -> Observation:
        """The ROS graph while the inputs among `topics` have a publisher; no answer is waited for. InputError when the
        observer failed."""
        alone = [replace(topic, causes="") for topic in topics]
        seconds = min(self.bounds.whole(0), self.test_namespace.seconds_left / 2 - POD_SECONDS)
        return self._run(alone, token, max(OBSERVE_SECONDS_MIN, seconds))

    def load(self, expected: Sequence[ExpectedTopic], token: str, seconds: float) -> None:
        """Send to every input again and again for that long; InputError when the observer failed or ended sooner."""
        sent = self._run(expected, token, seconds + self.bounds.settle, load_seconds=seconds).seconds
        if sent < seconds:
            raise InputError(f"the observer was ended after {sent:.0f} of {seconds:.0f} s")

    def _run(
        self,
        expected: Sequence[ExpectedTopic],
        token: str,
        seconds: float,
        clear: bool = False,
        load_seconds: float = 0.0,
    ) -> Observation:
        config = {
            "topics": [asdict(topic) for topic in expected],
            "node": f"suite_{token}",
            "client": f"suite-{token}",
            "broker": self.broker,
            "database": _database(self.database),
            "clear": clear,
            "load_seconds": load_seconds,
            "seconds_max": seconds,
            "bounds": asdict(self.bounds),
        }
        files = {CONFIG: json.dumps(config).encode()}
        if self.database is not None and self.database.authority:
            files[DATABASE_AUTHORITY] = self.database.authority.encode()
        run = self.test_namespace.run_pod(
            "observer", self.image, OBSERVER, files, seconds + POD_SECONDS, accounts=self.broker
        )
        if not run.succeeded:
            description = f"exit code {run.exit_code}; {run.problem}\n{run.log[-TEXT_CHARACTERS_MAX // 2 :]}"
            raise InputError(f"the observer could not observe the chart: {description}")
        return _read(run.log)


def _read(log: str) -> Observation:
    for line in reversed(log.splitlines()):
        if line.startswith('{"observation":'):
            try:
                return read_observation(read_json(line)["observation"], "observation")
            except (ValueError, TypeError) as error:
                raise InputError(f"the observer's last line is cut off: {error}; use fewer topics") from error
    raise InputError(f"the observer printed no observation: {log[-TEXT_CHARACTERS_MAX // 2 :]}")


def _database(account: SuiteAccount | None) -> Mapping[str, Any] | None:
    if account is None:
        return None
    known = {**asdict(account), "authentication_database": account.database}
    del known["authority"]  # a file of its own
    return known
