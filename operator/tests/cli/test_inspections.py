"""What `robotkube status` says of the Inspections."""

from __future__ import annotations

import io
from typing import Any

from robotkube.cli.inspections import NOBODY_LOOKS, seen
from robotkube.cli.output import Table, write
from robotkube.delivery.inspection.core.statuses import manifest, status_of
from robotkube.delivery.inspection.core.strangers import Look, Stranger
from robotkube.foundation.documents.core.times import time_ns

THEN = "2026-03-01T12:00:00.000000Z"
NOW = time_ns(THEN) + 20 * 10**9
MINER = Stranger("Container", "vehicle-00", "x", "ForeignContainer", "container miner runs in pod …", "miner")


def _inspection(look: Look) -> dict[str, Any]:
    return {**manifest(look, "robotkube"), "status": status_of(look, {}, THEN)}


def test_all_is_as_it_should_be() -> None:
    shown = seen([_inspection(Look("kubelet", node="a")), _inspection(Look("releases"))], NOW)
    assert (shown.problem, shown.blind, shown.looked) == ("", "", 2)
    assert shown.text == "no strangers in 2 places that were looked at\n"


def test_strangers_are_named() -> None:
    shown = seen([_inspection(Look("kubelet", (MINER,), "a"))], NOW)
    assert "1 stranger runs: Container vehicle-00/x/miner (ForeignContainer) (kubectl describe" in shown.problem
    many = tuple(Stranger("Pod", "vehicle-00", f"p{number:02}", "NoRelease", "…") for number in range(60))
    shown = seen([_inspection(Look("kubelet", many, "a"))], NOW)
    assert shown.problem.startswith("60 strangers run: Pod vehicle-00/p00 (NoRelease), ")
    assert "and 55 more" in shown.problem


def test_what_could_not_be_looked_at_is_named() -> None:
    silent = _inspection(Look("kubelet", node="a", problem="kubelet of node a: timed out"))
    shown = seen([silent, _inspection(Look("kubelet", node="b"))], NOW)
    assert shown.blind == "not looked at: kubelet.a (kubelet of node a: timed out)"
    assert "no strangers in 1 places" in shown.text
    stale = seen([_inspection(Look("kubelet", node="b"))], NOW + 30 * 10**9)
    assert "kubelet.b (the last look was 50 s ago: is what looks running?)" in stale.blind
    assert not seen([_inspection(Look("kubelet", node="b"))], NOW + 20 * 10**9).blind
    assert seen([], NOW).blind == NOBODY_LOOKS
    made = {"metadata": {"name": "kubelet.c"}, "spec": {"looksAt": "kubelet"}}
    assert seen([made], NOW).blind == "not looked at: kubelet.c (nothing looked there yet)"


def test_an_inspector_that_is_not_ready_is_named() -> None:
    """What the Inspections say is then not what it saw, as when admission changes what it writes."""
    clean = [_inspection(Look("kubelet", node="a"))]
    assert "inspector (it is not ready: what the Inspections say may be old" in seen(clean, NOW, {"status": {}}).blind
    assert "inspector (there is no such Deployment" in seen(clean, NOW, {}).blind
    assert not seen(clean, NOW, {"status": {"availableReplicas": 1}}).blind
    assert not seen(clean, NOW, None).blind  # who asks may not read it
    assert seen([], NOW, {}).blind == NOBODY_LOOKS


def test_programs_get_one_document() -> None:
    shown = seen([_inspection(Look("kubelet", (MINER,), "a"))], NOW)
    stream = io.StringIO()
    write(Table("unchecked", ("commit",), (), more=shown.tables), "table", stream)
    assert [line.split()[0] for line in stream.getvalue().splitlines()] == ["KIND", "Container"]
    stream = io.StringIO()
    write(Table("unchecked", ("commit",), (), more=shown.tables), "json", stream)
    assert '"strangers": [\n' in stream.getvalue()
    assert '"unseen": []' in stream.getvalue()
