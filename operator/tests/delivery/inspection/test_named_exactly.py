"""What a status says of a stranger so that exactly it can be removed, and what others wrote into the status."""

from __future__ import annotations

from typing import Any

from robotkube.delivery.inspection.core.statuses import own, status_of, strangers_of
from robotkube.delivery.inspection.core.strangers import KUBELET, RELEASES, Look, Stranger
from robotkube.delivery.inspection.core.workload_checks import strangers_among
from robotkube.delivery.inspection.loops.reporting import Reporter
from tests.delivery.inspection.test_pod_checks import _seen
from tests.stages.delivery.inspection.inspected_node import FOREIGN_IMAGE, deployment, permitted, pod_object

CHANGED = Stranger(
    "Deployment",
    "vehicle-00",
    "detector",
    "NotOfTheChart",
    "it was changed",
    uid="u",
    generation=3,
    excess=("/a", "/b"),
)
REMOVED = {"type": "Removed", "status": "True", "reason": "NothingNamed", "message": "", "lastTransitionTime": "t"}


def test_a_stranger_is_read_back_as_it_was_written() -> None:
    look = Look(RELEASES, (CHANGED,))
    assert strangers_of(status_of(look, {}, "t")) == (CHANGED,)
    plain = Stranger("Pod", "vehicle-00", "x", "NoRelease", "it is strange")
    written = status_of(Look(KUBELET, (plain,), "one"), {}, "t")
    assert strangers_of(written) == (plain,)
    assert not {"uid", "generation", "excess"} & set(written["strangers"][0])


def test_a_changed_workload_is_named_with_what_has_to_go() -> None:
    item = deployment()
    item["metadata"] |= {"uid": "u", "generation": 7}
    item["spec"]["template"]["spec"]["containers"].append({"name": "side", "image": FOREIGN_IMAGE})
    [one] = strangers_among(item, "Deployment", permitted())
    assert (one.uid, one.generation, one.excess) == ("u", 7, ("/spec/template/spec/containers/1",))


def test_every_stranger_on_a_node_has_the_uid_of_its_pod() -> None:
    of_image, of_chart = _seen(pod_object(image=FOREIGN_IMAGE))
    assert of_image.uid == of_chart.uid == pod_object()["metadata"]["uid"]


class Inspections:
    """The port Inspections with one that the remover has written into."""

    def __init__(self, status: dict[str, Any]) -> None:
        self.stands = status
        self.written = 0

    def names(self) -> tuple[str, ...]:
        return (RELEASES,)

    def status(self, name: str) -> dict[str, Any]:
        return self.stands

    def standing(self, prefix: str) -> dict[str, Any]:
        return {RELEASES: self.stands}

    def write(self, look: Look, status: Any) -> Any:
        self.written += 1
        return status

    def remove(self, name: str) -> None:
        raise AssertionError(name)

    def report(self, look: Look, reason: str, stranger: Stranger) -> None:
        raise AssertionError(reason)


def test_what_the_remover_says_is_no_reason_to_write_again() -> None:
    """After a restart, too, when the status is read anew."""
    look = Look(RELEASES, ())
    stands = status_of(look, {}, "2026-11-25T12:00:00Z")
    with_others = {**stands, "conditions": [REMOVED, *reversed(stands["conditions"])]}
    assert own(with_others) == stands
    inspections = Inspections(with_others)
    reporter = Reporter(inspections, lambda: 1_795_608_010 * 10**9)
    reporter.report(look)
    reporter.attend()
    assert inspections.written == 0
