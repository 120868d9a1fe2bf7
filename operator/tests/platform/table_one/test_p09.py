"""Operator applications select adequate applications and their components from application registries.

Example: The application manager of an operator application for environment perception chooses adequate object detection
and object tracking services based on requirements defined in the task description received from the event detector, and
based on guarantees associated with applications in the application registries.

Story: Two versions of the detection are in the registry: one more exact, one faster. Tasks that ask for detection, not
for an application, get the version that guarantees what they require; one that requires what nobody guarantees gets
none.

Asserted: on main, which versions the two tasks got, with two digests, and that the third got none; on the third's
condition, that it names the guarantee. Both versions run.
"""

from __future__ import annotations

from typing import Any

from ci import publish
from tests.stages.platform.table_one import Stage

EXACT = {"guarantee": "position-error", "atMost": 0.5, "unit": "m"}
FAST = {"guarantee": "latency-p99", "atMost": 60, "unit": "ms"}
IMPOSSIBLE = {"guarantee": "range", "atLeast": 500, "unit": "m"}


def asked(stage: Stage, name: str, sensor: str, requirement: dict[str, Any]) -> str:
    """A task that says what it needs and not who does it."""
    return stage.submit(
        "cloud-0",
        name,
        provides="perception/detection",
        requirements=[requirement],
        parameters={"sensor": sensor},
        placement={"roles": ["cloud"]},
    )


def test_requirements_meet_guarantees(stage: Stage) -> None:
    publish.publish(stage.platform.access.kubeconfig, extra=("object-detection", "object-detection@0.1.2"))
    exact = asked(stage, "p09-exact", "vehicle-00", EXACT)
    fast = asked(stage, "p09-fast", "vehicle-01", FAST)
    impossible = asked(stage, "p09-impossible", "vehicle-02", IMPOSSIBLE)
    releases = ["cloud-0/object-detection-vehicle-00", "cloud-0/object-detection-vehicle-01"]
    stage.await_running(*releases)
    assert [stage.annotation(release, "chart-version") for release in releases] == ["0.1.2", "0.2.3"]
    assert [stage.releases_of(key) for key in (exact, fast)] == [{releases[0]}, {releases[1]}]
    assert len({stage.annotation(release, "chart-digest") for release in releases}) == 2
    refusal = stage.await_reason(impossible, "GuaranteeNotMet")
    assert "range" in refusal["message"]
    assert stage.releases_of(impossible) == set()
