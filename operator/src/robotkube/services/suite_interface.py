"""The interface suite: a chart opens exactly what its entry declares, with every set of test values.

Per set: install the chart in the room, let a second pod on the same node look at it (`services.suite_observing`), and
compare what it saw with what the entry's interfaces give for these values.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from robotkube.domain.errors import DocumentError, InputError
from robotkube.domain.evidence import Check
from robotkube.domain.interface_checks import Observation, bounded, compare, read_observation, with_broker_log
from robotkube.domain.interfaces import (
    DATABASE,
    IN,
    MQTT,
    ExpectedTopic,
    declaration_checks,
    expected_topics,
)
from robotkube.domain.loops import Render
from robotkube.domain.suite_objects import BROKER_SECRET, DATABASE_SECRET
from robotkube.domain.suite_requests import TestSet
from robotkube.domain.texts import read_mapping
from robotkube.domain.values_schemas import overlay
from robotkube.ports.suites import Account, Room, Subject
from robotkube.services.suite_observing import Bounds
from robotkube.services.suite_sets import filled_sets, install, named_secrets

OBSERVER = ("python3", "-m", "robotkube.entrypoints.suite_observer")
CONFIG = "config.json"
POD_SECONDS = 30.0
LOOK_SECONDS_MIN = 15.0
REMOVE_SECONDS_MAX = 60.0
LEAD_NS = 5_000_000_000
WORDS_MAX = 1_500


@dataclass(frozen=True)
class InterfaceSuite:
    """See `ports.suites.Suite`. `observer` is the reference of the image with rclpy, `token` gives a word that nobody
    can guess: under it the observer is known, and a chart cannot pass its own topics off as the observer's."""

    observer: str
    render: Render
    now_ns: Callable[[], int]
    token: Callable[[], str]
    bounds: Bounds = field(default_factory=Bounds)
    name: str = "interface"
    version: str = "1"
    needs_room: bool = True

    def run(self, subject: Subject, room: Room | None) -> Sequence[Check]:
        """Every check of every set; those of the entry alone when the entry cannot be right."""
        assert room is not None, "the interface suite needs a room"
        interfaces = (subject.entry.get("spec") or {}).get("interfaces") or []
        try:
            sets = filled_sets(subject.entry, room.agent, self.now_ns() + LEAD_NS, self.render)
            defaults = read_mapping(subject.files.get("values.yaml", b"").decode() or "{}", "values.yaml")
            expected = {
                found.name: expected_topics(interfaces, overlay(defaults, found.values), self.render) for found in sets
            }
        except InputError as error:
            return [_entry_check(error)]
        checks = declaration_checks(interfaces, expected)
        if any(not check.passed for check in checks):
            return checks
        for number, found in enumerate(sets):
            checks += self._set_checks(subject, room, found, expected[found.name], first=number == 0)
        return bounded(checks)

    def _set_checks(
        self, subject: Subject, room: Room, values: TestSet, expected: Sequence[ExpectedTopic], first: bool
    ) -> list[Check]:
        name = f"set {values.name}: runs"
        try:
            observation = self._observe(subject, room, values, expected, first)
        except InputError as error:
            return [Check(name, False, str(error)[:WORDS_MAX], "mend the chart or the set's values")]
        return [Check(name, True), *compare(values.name, expected, observation)]

    def _observe(
        self, subject: Subject, room: Room, values: TestSet, expected: Sequence[ExpectedTopic], first: bool
    ) -> Observation:
        """Install the set, look, and take it away again; InputError when the chart does not run or cannot be seen."""
        objects = subject.render(values.values, subject.artefact.chart)
        needed = {topic.medium for topic in expected} | named_secrets(objects)
        broker = bool(needed & {MQTT, BROKER_SECRET})
        if broker:
            room.start_broker()
        database = room.start_database() if needed & {DATABASE, DATABASE_SECRET} else None
        look = _Look(self, room, broker, database)
        if database is not None and not first:
            look.clear()
        said_before = len(room.broker_log())
        try:
            installation = install(subject, room, values)
            if not installation.ready:
                raise InputError(installation.found)
            return look.look(expected, said_before)
        finally:
            room.delete(objects, REMOVE_SECONDS_MAX)


@dataclass(frozen=True)
class _Look:
    """The second pod, once per set."""

    suite: InterfaceSuite
    room: Room
    broker: bool
    database: Account | None

    def clear(self) -> None:
        """Take away what the set before wrote to the database."""
        self._observe((), clear=True, token=self.suite.token())

    def look(self, expected: Sequence[ExpectedTopic], said_before: int) -> Observation:
        """What the chart opens and does; InputError when the observer could not look."""
        token = self.suite.token()
        observation = self._observe(expected, clear=False, token=token)
        return with_broker_log(observation, self.room.broker_log()[said_before:], f"suite-{token}")

    def _observe(self, expected: Sequence[ExpectedTopic], clear: bool, token: str) -> Observation:
        wanted = self.suite.bounds.whole(sum(topic.direction == IN for topic in expected))
        seconds = max(LOOK_SECONDS_MIN, min(wanted, self.room.seconds_left / 2 - POD_SECONDS))
        config = {
            "topics": [asdict(topic) for topic in expected],
            "node": f"suite_{token}",
            "client": f"suite-{token}",
            "broker": self.broker,
            "database": _database(self.database),
            "clear": clear,
            "seconds_max": seconds,
            "bounds": asdict(self.suite.bounds),
        }
        files = {CONFIG: json.dumps(config).encode()}
        run = self.room.run_pod(
            "observer", self.suite.observer, OBSERVER, files, seconds + POD_SECONDS, accounts=self.broker
        )
        if not run.succeeded:
            said = f"exit code {run.exit_code}; {run.found}\n{run.log[-WORDS_MAX // 2 :]}"
            raise InputError(f"the observer could not look at the chart: {said}")
        return _read(run.log)


def _read(log: str) -> Observation:
    for line in reversed(log.splitlines()):
        if line.startswith('{"observation":'):
            try:
                return read_observation(json.loads(line)["observation"], "observation")
            except (ValueError, TypeError) as error:
                raise InputError(f"the observer's last line is cut off: {error}; use fewer topics") from error
    raise InputError(f"the observer said nothing of what it saw: {log[-WORDS_MAX // 2 :]}")


def _database(account: Account | None) -> Mapping[str, Any] | None:
    if account is None:
        return None
    return {**asdict(account), "authentication_database": account.database}


def _entry_check(error: InputError) -> Check:
    problems = error.problems if isinstance(error, DocumentError) else (str(error),)
    fix = "mend spec.interfaces or the values of spec.suites.sets in the chart's entry"
    return Check("the entry gives topics for its test values", False, "; ".join(problems)[:WORDS_MAX], fix)
