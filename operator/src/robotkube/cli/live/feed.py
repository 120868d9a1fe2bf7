"""The feed of a view: watches of tasks, pods and agents' Nodes, and the manager's plans, asked for while something goes
on.

One thread calls `step`; the watches' threads only put what changed into a queue. A view costs the platform three
watches and, every PLANS_SECONDS while a plan is under way, one small page.
"""

from __future__ import annotations

import queue
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from robotkube.cli.live import fleet, moments
from robotkube.cli.live.fleet import NodeLook, PodLook
from robotkube.cli.live.moments import Moment
from robotkube.delivery.manager.adapters.pod_states import read_time_ns
from robotkube.delivery.tasks.core.task_states import task_state
from robotkube.errors import InputError, RobotKubeError, UnavailableError

CHANGES_MAX = 10_000
SYNC_SECONDS_MAX = 15.0
PLANS_SECONDS, PLANS_AT_REST_SECONDS = 2.0, 10.0
RATES_SECONDS = 5.0
BUSY_AFTER_TASK_SECONDS = 15.0  # a plan comes soon after a task came or went
SECOND = 1_000_000_000
RECEIVED = re.compile(r'^robotkube_detector_received_total\{topic="((?:[^"\\]|\\.)*)"\} ([0-9.e+]+)$', re.MULTILINE)

Changed = Callable[[str, Any, Any], None]


class Watch(Protocol):
    """A watch of one kind."""

    synced: Any
    complaint: str

    def start(self) -> None:
        """Begin."""
        ...

    def stop(self) -> None:
        """End."""
        ...


class LivePlatform(Protocol):
    """What a feed asks of a platform."""

    def watch_tasks(self, changed: Changed, namespace: str = "") -> Any:
        """A watch of tasks."""
        ...

    def watch_of_agents(self, kind: str, reduce: Callable[[Mapping[str, Any]], Any], changed: Changed) -> Any:
        """A watch of what agents have."""
        ...

    def page(self, path: str) -> Mapping[str, Any]:
        """A page of the manager."""
        ...

    def detector_metrics(self) -> Mapping[str, str]:
        """The metrics of the event detectors."""
        ...


@dataclass
class PlatformPicture:
    """What a view shows: everything as of now, and `problem` when a part of it may be old. `rates`: messages per second
    that detectors receive, by topic. `is_read`: whether anything is known yet."""

    nodes: dict[str, NodeLook] = field(default_factory=dict)
    pods: dict[str, PodLook] = field(default_factory=dict)
    tasks: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    plans: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    rates: dict[str, float] = field(default_factory=dict)
    problem: str = ""
    is_read: bool = False


class Feed:
    """A picture that is kept up to date, and every moment, which `report` is given as it becomes known.

    `with_rates`: detectors are asked for their counters; without a view nobody needs them. `clock_ns`: since 1970.
    """

    def __init__(
        self, platform: LivePlatform, report: Callable[[Moment], None], clock_ns: Callable[[], int], with_rates: bool
    ) -> None:
        self.picture = PlatformPicture()
        self.tells_pods = True
        self._platform = platform
        self._report = report
        self._clock_ns = clock_ns
        self._with_rates = with_rates
        self._changes: queue.Queue[tuple[str, str, Any, Any, bool]] = queue.Queue(CHANGES_MAX)
        self._watches: dict[str, Watch] = {
            "tasks": platform.watch_tasks(self._receiver("tasks")),
            "pods": platform.watch_of_agents("pods", fleet.look_at_pod, self._receiver("pods")),
            "nodes": platform.watch_of_agents("nodes", fleet.look_at_node, self._receiver("nodes")),
        }
        self._knows_plans = False
        self._manager_problem = ""
        self._busy_until = self._plans_due = self._rates_due = 0
        self._counted: tuple[int, dict[str, float]] = (0, {})

    def start(self) -> None:
        """Begin. UnavailableError or InputError when the API server does not give what is there."""
        for watch in self._watches.values():
            watch.start()
        for kind, watch in self._watches.items():
            if not watch.synced.wait(SYNC_SECONDS_MAX):
                self.stop()
                raise UnavailableError(f"{kind} cannot be watched: {watch.complaint}")

    def stop(self) -> None:
        """End."""
        for watch in self._watches.values():
            watch.stop()

    def step(self, seconds: float) -> None:
        """Take in what changed, waiting for it at most so long, and ask for plans and rates when that is due."""
        for kind, key, before, now, is_first in self._waiting(seconds):
            self._take(kind, key, before, now, is_first)
        now_ns = self._clock_ns()
        if now_ns >= self._plans_due:
            self._ask_for_plans(now_ns)
        if self._with_rates and now_ns >= self._rates_due:
            self._ask_for_rates(now_ns)
        self._note_problems()
        self.picture.is_read = True

    def _receiver(self, kind: str) -> Changed:
        """Puts changes into the queue, with whether they belong to the first look."""

        def receive(key: str, before: Any, now: Any) -> None:
            self._changes.put((kind, key, before, now, not self._watches[kind].synced.is_set()))

        return receive

    def _waiting(self, seconds: float) -> Iterator[tuple[str, str, Any, Any, bool]]:
        try:
            yield self._changes.get(timeout=seconds)
            for _ in range(CHANGES_MAX):
                yield self._changes.get_nowait()
        except queue.Empty:
            return

    def _take(self, kind: str, key: str, before: Any, now: Any, is_first: bool) -> None:
        values: dict[str, Any] = getattr(self.picture, kind)
        if now is None:
            values.pop(key, None)
        else:
            values[key] = now
        seen = self._clock_ns()
        if kind == "tasks":
            self._busy_until = seen + int(BUSY_AFTER_TASK_SECONDS * SECOND)
            self._plans_due = min(self._plans_due, seen + int(PLANS_SECONDS * SECOND))
            self._report_all(_standing(key, now, seen) if is_first else moments.of_task(key, before, now, seen))
        elif kind == "pods" and self.tells_pods and not is_first:
            self._report_all(moments.of_pod(before, now, seen))

    def _report_all(self, reported: Iterator[Moment]) -> None:
        for moment in reported:
            self._report(moment)

    def _ask_for_plans(self, now_ns: int) -> None:
        try:
            plans = self._platform.page("/plans")["plans"]
        except RobotKubeError as error:
            self._manager_problem = f"the manager does not answer: {error}"
            self._plans_due = now_ns + int(PLANS_AT_REST_SECONDS * SECOND)
            return
        self._manager_problem = ""
        for plan in plans:
            self._take_plan(plan, now_ns)
        self._knows_plans = True
        under_way = any(plan["observed"] is None and plan["error"] is None for plan in plans[-3:])
        is_busy = under_way or now_ns < self._busy_until
        self._plans_due = now_ns + int((PLANS_SECONDS if is_busy else PLANS_AT_REST_SECONDS) * SECOND)

    def _take_plan(self, plan: Mapping[str, Any], now_ns: int) -> None:
        """A plan of the page: a manager that was restarted has forgotten times, which are kept here."""
        before = self.picture.plans.get(plan["plan"])
        known = {step: before[step] for step in moments.STEPS if before and before.get(step)}
        self.picture.plans[plan["plan"]] = {**plan, **known}
        if self._knows_plans:
            self._report_all(moments.of_plan(before, plan, now_ns))

    def _ask_for_rates(self, now_ns: int) -> None:
        self._rates_due = now_ns + int(RATES_SECONDS * SECOND)
        try:
            counted = received(self._platform.detector_metrics().values())
        except (InputError, UnavailableError):
            counted = {}
        before_ns, before = self._counted
        seconds = (now_ns - before_ns) / SECOND
        grown = {topic: count - before[topic] for topic, count in counted.items() if topic in before}
        self.picture.rates = {topic: count / seconds for topic, count in grown.items() if count >= 0}
        self._counted = now_ns, counted

    def _note_problems(self) -> None:
        silent = [watch.complaint for watch in self._watches.values() if watch.complaint]
        problem = silent[0] if silent else self._manager_problem
        if problem and not self.picture.problem:
            self._report(Moment(self._clock_ns(), f"what is shown may be old: {problem}", trouble=True))
        elif self.picture.problem and not problem:
            self._report(Moment(self._clock_ns(), "what is shown is up to date again"))
        self.picture.problem = problem


def _standing(key: str, task: Mapping[str, Any] | None, seen: int) -> Iterator[Moment]:
    """A task that was there before the first look."""
    if task is not None:
        created = read_time_ns(task["metadata"].get("creationTimestamp"))
        yield Moment(created or seen, f"task {key} stands: {task_state(task)}")


def received(pages: Iterable[str]) -> dict[str, float]:
    """Messages that detectors have received so far by topic pattern, of their pages of metrics."""
    counted: dict[str, float] = {}
    for page in pages:
        for topic, count in RECEIVED.findall(page):
            counted[topic] = counted.get(topic, 0.0) + float(count)
    return counted
