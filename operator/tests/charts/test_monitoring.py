"""What the chart brings for the Prometheus operator and Grafana: nothing by default, else all pages of the platform."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.stages.paths import CHARTS

pytestmark = pytest.mark.toolchain

Object = dict[str, Any]
PLATFORM = CHARTS / "robotkube"
PROFILE = Path(__file__).parent / "profiles" / "official.yaml"
ADMISSION = PROFILE.with_name("admission.yaml")
OWN = "monitoring.coreos.com/v1"
ON: Object = {
    "podMonitors": {"enabled": True, "labels": {"release": "kube-prometheus-stack"}, "interval": "15s"},
    "rules": {"enabled": True, "labels": {"release": "kube-prometheus-stack"}},
    "dashboards": {"enabled": True, "namespace": "monitoring", "annotations": {"grafana_folder": "Robots"}},
}


@pytest.fixture(scope="module")
def watched(helm: Any) -> Any:
    return helm.template(PLATFORM, PROFILE, ADMISSION, monitoring=ON, remover={"enabled": True})


def dashboards(rendered: Any) -> list[Object]:
    return [one for one in rendered.of_kind("ConfigMap") if one["metadata"]["name"].startswith("robotkube-dashboard-")]


def test_nothing_of_it_is_there_by_default(official: Any, embedded: Any) -> None:
    for rendered in (official, embedded):
        assert [one for one in rendered.objects if one["apiVersion"] == OWN] == []
        assert dashboards(rendered) == []


def test_every_pod_with_a_page_is_read(watched: Any) -> None:
    """By namespace, label and name of the port; pods that serve no metrics have no port of that name."""
    monitors = {one["metadata"]["name"]: one["spec"] for one in watched.of_kind("PodMonitor")}
    platform = monitors["robotkube-platform"]
    assert [endpoint["port"] for endpoint in platform["podMetricsEndpoints"]] == ["health"]
    assert platform["podMetricsEndpoints"][0]["interval"] == "15s"
    read = set()
    for workload in watched.of_kind("Deployment"):
        template = workload["spec"]["template"]
        ports = {port["name"] for one in template["spec"]["containers"] for port in one.get("ports", ())}
        if "health" in ports:
            read.add(workload["metadata"]["name"])
            assert workload["metadata"].get("namespace", "robotkube") in platform["namespaceSelector"]["matchNames"]
            assert platform["selector"]["matchLabels"].items() <= template["metadata"]["labels"].items()
            assert platform["jobLabel"] in template["metadata"]["labels"]
    assert read == {
        *("manager", "gate", "suite-runner", "inspector", "remover"),
        *("admission", "rights", "certificates", "console"),
    }
    agents = {one["metadata"]["name"] for one in watched.of_kind("Namespace")} & {"vehicle-00", "vehicle-01", "cloud-0"}
    assert set(monitors["robotkube-applications"]["namespaceSelector"]["matchNames"]) == agents != set()


def test_a_bridge_is_read_with_its_agent(watched: Any, apps: Any) -> None:
    monitor = watched.one("PodMonitor", "robotkube-applications")["spec"]
    template = apps["mqtt-bridge"].one("Deployment", "mqtt-bridge")["spec"]["template"]
    assert monitor["selector"]["matchLabels"].items() <= template["metadata"]["labels"].items()
    assert set(monitor["podTargetLabels"]) <= set(template["metadata"]["labels"])
    assert "health" in {port["name"] for port in template["spec"]["containers"][0]["ports"]}


def test_no_monitor_without_agents(helm: Any) -> None:
    shown = helm.template(PLATFORM, PROFILE, monitoring=ON, agents=[], suites={"enabled": False})
    assert [one["metadata"]["name"] for one in shown.of_kind("PodMonitor")] == ["robotkube-platform"]


def test_objects_carry_the_labels_by_which_they_are_chosen(watched: Any) -> None:
    chosen = [*watched.of_kind("PodMonitor", "PrometheusRule")]
    assert len(chosen) == 3
    assert {one["metadata"]["labels"]["release"] for one in chosen} == {"kube-prometheus-stack"}
    for one in dashboards(watched):
        assert one["metadata"]["namespace"] == "monitoring"
        assert one["metadata"]["labels"]["grafana_dashboard"] == "1"
        assert one["metadata"]["annotations"] == {"grafana_folder": "Robots"}


def test_every_alert_is_rendered_as_it_is_listed(watched: Any) -> None:
    listed = yaml.safe_load((PLATFORM / "files" / "monitoring" / "alerts.yaml").read_text("utf-8"))
    [group] = watched.one("PrometheusRule", "robotkube")["spec"]["groups"]
    rules = {rule["alert"]: rule for rule in group["rules"]}
    assert list(rules) == [one["alert"] for one in listed]
    for one in listed:
        rule = rules[one["alert"]]
        assert rule["labels"] == {"severity": one["severity"]}
        assert rule.get("for", "0s") == f"{one['seconds']}s"
        assert rule["annotations"] == {key: one[key] for key in ("summary", "description")}
        assert rule["expr"] == one["expr"].replace("CERTIFICATE_SECONDS_LEFT", str(2160 * 3600 // 4))


def test_a_certificate_of_an_hour_ends_in_a_quarter_of_one(helm: Any) -> None:
    shown = helm.template(PLATFORM, PROFILE, monitoring=ON, tls={"hours": 1})
    [group] = shown.one("PrometheusRule", "robotkube")["spec"]["groups"]
    [rule] = [rule for rule in group["rules"] if rule["alert"] == "RobotKubeCertificateEnds"]
    assert rule["expr"].endswith("< 900")


def test_dashboards_are_what_grafana_reads(watched: Any) -> None:
    boards = [json.loads(text) for dashboard in dashboards(watched) for text in dashboard["data"].values()]
    assert {board["uid"] for board in boards} == {"robotkube-delivery", "robotkube-robots", "robotkube-trust"}
    for one in boards:
        assert [choice["type"] for choice in one["templating"]["list"]] == ["datasource"]
        places = [(panel["gridPos"]["x"], panel["gridPos"]["y"]) for panel in one["panels"]]
        assert len(set(places)) == len(places) == len({panel["id"] for panel in one["panels"]})
        for panel in one["panels"]:
            assert panel["title"]
            assert {target["datasource"]["uid"] for target in panel["targets"]} == {"${datasource}"}
            assert all(target["expr"] for target in panel["targets"])


@pytest.mark.parametrize(
    ("monitoring", "words"),
    [
        ({"podMonitors": {"interval": "1m"}}, "interval"),
        ({"rules": {"enable": True}}, "enable"),
        ({"dashboards": {"namespace": "Monitoring"}}, "namespace"),
    ],
)
def test_what_it_does_not_know_is_refused(helm: Any, monitoring: Object, words: str) -> None:
    assert words in helm.refusal(PLATFORM, PROFILE, monitoring=monitoring)
