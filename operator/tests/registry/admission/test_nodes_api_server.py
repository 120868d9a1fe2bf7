"""What a real API server lets kubelets write of their Nodes, under the policies from files."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.stages.attacks import shown
from tests.stages.kubernetes.judged_api_server import ADMINISTRATOR, MERGE, Api

pytestmark = [pytest.mark.toolchain]
NODES = "/api/v1/nodes"
KUBELET = "system:node:vehicle-00"
LABELS = {"robotkube.io/agent": "vehicle-00", "robotkube.io/role": "vehicle", "zone": "a"}


@pytest.fixture(scope="module")
def api(under_policies: Api) -> Iterator[Api]:
    under_policies.done("POST", NODES, {"metadata": {"name": "vehicle-00", "labels": LABELS}}, KUBELET)
    under_policies.done("POST", NODES, {"metadata": {"name": "plain"}}, "system:node:plain")
    yield under_policies
    for name in ("vehicle-00", "plain"):
        under_policies.done("DELETE", f"{NODES}/{name}")


@pytest.mark.parametrize("part", ["", "/status"])
@pytest.mark.parametrize(
    "labels",
    [
        {"robotkube.io/role": "platform"},
        {"robotkube.io/agent": "vehicle-01"},
        {"robotkube.io/agent": None},
        {"robotkube.io/capability.gpu": "true"},
    ],
)
def test_a_kubelet_does_not_say_whose_its_machine_is(api: Api, labels: dict[str, str | None], part: str) -> None:
    change = {"metadata": {"labels": labels}}
    said = api.refusal("PATCH", f"{NODES}/vehicle-00{part}", change, KUBELET, MERGE)
    shown("admission", said, "node-relabelled")
    api.refusal("PATCH", f"{NODES}/plain{part}", {"metadata": {"labels": LABELS}}, "system:node:plain", MERGE)


def test_kubelets_write_the_rest(api: Api) -> None:
    ready = {"status": {"conditions": [{"type": "Ready", "status": "True"}]}}
    for name in ("vehicle-00", "plain"):
        api.done("PATCH", f"{NODES}/{name}/status", ready, f"system:node:{name}", MERGE)
        api.done("PATCH", f"{NODES}/{name}", {"metadata": {"labels": {"zone": "b"}}}, f"system:node:{name}", MERGE)


def test_others_label_nodes(api: Api) -> None:
    for value in ("gpu", None):
        change = {"metadata": {"labels": {"robotkube.io/capability.gpu": value}}}
        api.done("PATCH", f"{NODES}/vehicle-00", change, ADMINISTRATOR, MERGE)
