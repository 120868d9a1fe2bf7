"""The run as a list of moments, for the terminal and the page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from robotkube.cli.live.moments import observed_text, releases_text
from scenarios.runner.inputs import NANOSECONDS, Plan, RunInputs, StepDone, TaskLife
from scenarios.runner.judging.encounters import Encounter


@dataclass(frozen=True)
class Moment:
    """Something that happened: time in ns, the pull request and commit it belongs to."""

    time: int
    text: str
    pull_request: int | None = None
    commit: str | None = None


def timeline(inputs: RunInputs, encounters: Sequence[Encounter]) -> tuple[Moment, ...]:
    """All moments known, in order of time."""
    begin = "story begins" if inputs.steps and not inputs.ledgers else "players start"
    moments = [Moment(inputs.started, begin), Moment(inputs.ended, "run ends")]
    moments += [moment for step in inputs.steps for moment in _of_step(step)]
    of_encounters = {encounter.start.task for encounter in encounters}  # by the detector that made and withdrew them
    moments += [moment for task in inputs.tasks if task.key not in of_encounters for moment in _of_task(task)]
    for number, encounter in enumerate(encounters, 1):
        moments += _of_encounter(number, encounter)
    return tuple(sorted(moments, key=lambda moment: moment.time))


def _of_step(step: StepDone) -> Iterator[Moment]:
    yield Moment(step.began, f"{step.name}: {step.what}")
    if step.done is not None:
        yield Moment(step.done, f"{step.name}: seen")


def _of_task(task: TaskLife) -> Iterator[Moment]:
    """Its life and what the manager decided; that it is carried out, the plans show."""
    yield Moment(task.created, f"task {task.key} created")
    reason = ""
    for condition in task.conditions:
        if condition.type == "Accepted" and condition.reason != reason:
            reason = condition.reason
            yield Moment(condition.time, f"task {task.key}: {reason}: {condition.message}")
    if task.deleted is not None:
        yield Moment(task.deleted, f"task {task.key} gone")


def _of_encounter(number: int, encounter: Encounter) -> Iterator[Moment]:
    start, stop = encounter.start, encounter.stop
    yield Moment(start.time, f"event {number}: {', '.join(start.agents)}{_distance(start.distance_m)} ({start.rule})")
    if start.done:
        yield Moment(start.done, f"task {start.task} created")
    yield from _of_plan(encounter.plan, "deployment")
    for pod in encounter.pods:
        yield Moment(pod.created, f"pod {pod.namespace}/{pod.name} created")
        if pod.running:
            yield Moment(pod.running, f"pod {pod.namespace}/{pod.name} running")
        if pod.deleted:
            yield Moment(pod.deleted, f"pod {pod.namespace}/{pod.name} gone")
    first = encounter.first_cloud
    if first and first.stored:
        yield Moment(first.stored, f"first point cloud stored ({first.topic})")
    if stop:
        yield Moment(stop.time, f"event {number} ends: {', '.join(stop.agents)}{_distance(stop.distance_m)}")
        if stop.done:
            yield Moment(stop.done, f"task {stop.task or start.task} withdrawn")
    yield from _of_plan(encounter.withdrawal, "removal")


def _of_plan(plan: Plan | None, what: str) -> Iterator[Moment]:
    if plan is None:
        return
    if plan.proposed:
        yield Moment(plan.proposed, f"{what} proposed: {plan.subject}", plan.pull_request)
    if plan.merged:
        releases = releases_text(plan.created, plan.changed, plan.removed)
        yield Moment(plan.merged, f"{what} merged: {releases}", plan.pull_request, plan.commit)
    if plan.observed:
        yield Moment(plan.observed, observed_text(what), plan.pull_request, plan.commit)


def _distance(metres: float | None) -> str:
    return "" if metres is None else f" at {metres:.1f} m"


def lines(inputs: RunInputs, moments: Sequence[Moment]) -> Iterator[str]:
    """The timeline as text: seconds since the players started, what, pull request, commit."""
    for moment in moments:
        since = (moment.time - inputs.started) / NANOSECONDS
        request = f"  #{moment.pull_request}" if moment.pull_request else ""
        commit = f"  {moment.commit[:10]}" if moment.commit else ""
        yield f"{since:9.3f} s  {moment.text}{request}{commit}"
