"""Charts of applications on the guest of a Node (trial mode): its label chooses the Node, its number is the ROS domain,
and nothing else differs from a release on a Node of one's own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from robotkube.foundation.kubernetes.core.node_agents import GUESTS_MAX, selector
from tests.charts.conftest import APP_CHARTS, CHARTS, PROFILES
from tests.charts.test_evidence import notes
from tests.stages.paths import REPOSITORY

pytestmark = pytest.mark.toolchain

SKELETON = REPOSITORY / "operator/src/robotkube/registry/catalogue/skeletons/application/chart"
DOMAIN = "ROS_DOMAIN_ID"


def pod_of(rendered: Any) -> Any:
    [(_, pod)] = rendered.pods
    return pod


@pytest.mark.parametrize("chart", APP_CHARTS)
def test_a_guests_pod_chooses_its_node_by_its_own_label_and_has_a_ros_domain(helm: Any, chart: str) -> None:
    profile, folder = PROFILES / f"{chart}.yaml", CHARTS / "apps" / chart
    own = pod_of(helm.template(folder, profile, release=chart))
    agent = own["nodeSelector"]["robotkube.io/agent"]
    guest = pod_of(helm.template(folder, profile, release=chart, placement={"agent": agent, "guest": 2}))
    assert guest["nodeSelector"] == selector(agent, 2)
    assert {"name": DOMAIN, "value": "2"} in guest["containers"][0]["env"]
    assert DOMAIN not in [entry["name"] for entry in own["containers"][0]["env"]]
    guest["nodeSelector"] = own["nodeSelector"]
    guest["containers"][0]["env"].remove({"name": DOMAIN, "value": "2"})
    assert guest == own


def test_a_guest_on_one_of_several_nodes_names_both(helm: Any) -> None:
    chart = "bag-player"
    placement = {"agent": "vehicle-01", "guest": 1, "node": "worker-2"}
    pod = pod_of(helm.template(CHARTS / "apps" / chart, PROFILES / f"{chart}.yaml", release=chart, placement=placement))
    assert pod["nodeSelector"] == {**selector("vehicle-01", 1), "kubernetes.io/hostname": "worker-2"}


@pytest.mark.parametrize("number", [0, GUESTS_MAX + 1, "1", 1.5])
def test_a_number_that_can_be_no_guests_is_refused(helm: Any, number: Any) -> None:
    chart = CHARTS / "apps" / "bag-player"
    said = helm.refusal(chart, PROFILES / "bag-player.yaml", placement={"agent": "vehicle-01", "guest": number})
    assert "guest" in said


@pytest.mark.parametrize("chart", [chart for chart in APP_CHARTS if chart != "bag-player"])
def test_earlier_charts_refuse_the_value_and_have_not_got_it(helm: Any, chart: str) -> None:
    """So the manager knows by their schemas that they cannot run there."""
    folder = CHARTS / "earlier" / chart
    assert "guest" not in placed(folder)
    assert "guest" in helm.refusal(folder, release=chart, placement={"agent": "vehicle-01", "guest": 1})


@pytest.mark.parametrize(
    "folder", [*(CHARTS / "apps" / chart for chart in APP_CHARTS), SKELETON], ids=lambda one: one.name
)
def test_every_newer_chart_has_the_value_as_the_label_can_be(folder: Path) -> None:
    guest = placed(folder)["guest"]
    assert (guest["type"], guest["minimum"], guest["maximum"]) == ("integer", 1, GUESTS_MAX)


def placed(chart: Path) -> Any:
    return json.loads((chart / "values.schema.json").read_text())["properties"]["placement"]["properties"]


def test_notes_say_who_knows_which_agents_share_a_node(helm: Any, tmp_path: Path) -> None:
    """An installer need not have the right to read Nodes, whose labels alone say it: the notes name the command."""
    said = notes(helm, {}, tmp_path)
    assert "robotkube agent list --platform-namespace robotkube     whose Nodes are; which of them agents share" in said
    assert "NOTE: the platform shares" not in said
    elsewhere = {"kind": "external", "external": {"host": "mqtt.example"}}
    without = notes(helm, {"broker": elsewhere, "tls": {"mode": "off"}}, tmp_path)
    assert "robotkube watch --platform-namespace robotkube     whose Nodes are" in without
    assert "agent list" not in without, (
        "it reads the settings of rights, which are kept at the chart's own broker alone"
    )


def test_notes_say_that_the_platform_is_a_guest(helm: Any, tmp_path: Path) -> None:
    said = notes(helm, {"platform": {"nodeSelector": selector("platform", 1)}}, tmp_path)
    assert (
        "\nNOTE: the platform shares its Node with agents (trial mode, by label agent.robotkube.io/platform): no "
        "machine keeps them apart, and no figure compares machines.\n"
    ) in said
