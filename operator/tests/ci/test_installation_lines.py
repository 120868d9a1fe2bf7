"""What an installation says of components: their lines while Helm waits, and in the place of its words for that."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ci.installation import GATE, NAMESPACE, Installer, what_hangs
from tests.stages.kubernetes.component_pods import pod, workload
from tests.stages.kubernetes.served_objects import FORBIDDEN, serving
from tests.stages.waiting import until

DEPLOYMENTS, PODS = "/apis/apps/v1/namespaces/{}/deployments", "/api/v1/namespaces/{}/pods"


@pytest.mark.parametrize(
    ("hanging", "said"),
    [
        (
            ["forge is not ready: a", "gate is not ready: b"],
            "helm: failed: forge is not ready: a\ngate is not ready: b",
        ),
        ([], "helm: failed: timed out waiting for the condition"),
    ],
)
def test_the_words_for_having_waited_name_what_hangs(hanging: list[str], said: str) -> None:
    assert what_hangs("helm: failed: timed out waiting for the condition", hanging) == said
    assert what_hangs("helm: no such chart", hanging) == "helm: no such chart"


def test_what_hangs_is_followed_by_the_installations_kubeconfig(tmp_path: Path) -> None:
    """In the namespaces of the installation: what robots have is nobody's business."""
    items = {
        DEPLOYMENTS.format(GATE): [workload("gate", namespace=GATE)],
        PODS.format(GATE): [pod("gate-0", namespace=GATE)],
        DEPLOYMENTS.format("vehicle-00"): [workload("bag-player", namespace="vehicle-00")],
    }

    def answer(path: str, query: dict[str, list[str]]) -> dict[str, Any]:
        return {"metadata": {"resourceVersion": "1"}, "items": [] if "watch" in query else items.get(path, [])}

    with serving(answer, tmp_path) as kubeconfig:
        installer = Installer(tmp_path, kubeconfig, tmp_path)
        with installer.watching((NAMESPACE, GATE), pytest.fail) as followed:
            assert followed is not None
            followed.wait_for_first_look()
            (line,) = followed.lines.hanging()
    assert line.words == "gate is not ready: pod gate-0: Running, containers with unready status"


def test_an_installation_goes_on_when_nobody_can_be_followed(tmp_path: Path) -> None:
    with (
        serving(lambda path, query: FORBIDDEN, tmp_path) as kubeconfig,
        Installer(tmp_path, kubeconfig, tmp_path).watching([NAMESPACE], pytest.fail) as followed,
    ):
        assert followed is not None
        until(lambda: "forbidden" in followed.complaint, "the watch is refused")
        assert followed.lines.hanging() == ()
    with Installer(tmp_path, tmp_path / "missing", tmp_path).watching([NAMESPACE], pytest.fail) as followed:
        assert followed is None
