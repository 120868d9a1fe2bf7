"""Broken links: what bridges say that they do not carry, as far as the process that says so still runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from robotkube.delivery.manager.core.observation import PodState
from robotkube.robots.bridge.core.link_reports import LinkReport

BridgedLink = tuple[str, str, str]
"""A topic at a bridge: the bridge's release (key), `out` or `in`, and the topic's name."""

BrokenLinks = Mapping[BridgedLink, str]
"""Why each is not carried."""

SECOND_NS = 1_000_000_000


def broken_links(reports: Iterable[LinkReport], pods: Callable[[str], Sequence[PodState]]) -> BrokenLinks:
    """The broken links in reports of processes that run: their pod is there, and no container of it was started
    since."""
    return {
        (report.release, fault.direction, fault.topic): fault.reason
        for report in reports
        if any(_says(pod, report) for pod in pods(report.release))
        for fault in report.faults
    }


def _says(pod: PodState, report: LinkReport) -> bool:
    begun = [container.started_ns for container in pod.containers if container.started_ns is not None]
    return pod.name == report.pod and not pod.deleting and report.started_ns >= max(begun, default=0)


def link_faults(links: Iterable[BridgedLink], broken: BrokenLinks) -> list[str]:
    """A sentence for each of the links that is broken: topic, agent, bridge and cause."""
    ways = {"out": "leaves", "in": "reaches"}
    return [
        f"link {topic} never {ways[direction]} {release.partition('/')[0]}: its bridge {release} does not carry it: "
        f"{broken[release, direction, topic]}"
        for release, direction, topic in links
        if (release, direction, topic) in broken
    ]
