"""A real Prometheus reads the running platform as the chart's PodMonitors say: every pod, every metric that a dashboard
or an alert names; an alert fires when something strange is there, and ends with it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
import yaml

from ci import prometheus
from ci.folders import PROJECT
from robotkube.registry.admission.core.domain import account
from tests.stages.monitoring import FILES, OF_EVERY_PROCESS, asked
from tests.stages.platform import prometheus_server
from tests.stages.platform.prometheus_server import Prometheus
from tests.stages.platform.running_platform import GATE, PLATFORM, Platform, eventually
from tests.stages.platform.story import Story
from tests.stages.programs import program

pytestmark = pytest.mark.thorough

CHART = PROJECT / "charts" / "robotkube"
AGENT, RELEASE = "vehicle-01", "mqtt-bridge"
WRITER = account("argocd", "argocd-application-controller")
NOTE = "/metadata/annotations/example.com~1watched"
# Of processes that are not pods here (admission is the machines'), of recordings while they run, and of losses once
# there were any: a page has no line about them before.
NOT_ALWAYS = ("robotkube_admission_", "robotkube_recorder_", "robotkube_bridge_dropped_")
QUIET = {"RobotKubeStranger", "RobotKubeNoManagerLeads", "RobotKubeGateAway", "RobotKubeForgeAway"}


@pytest.fixture(scope="module")
def watching(platform: Platform, story: Story, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Prometheus]:
    """Prometheus beside the platform, after the story: a bridge and a detector run on every agent that has one."""
    folder = tmp_path_factory.mktemp("prometheus")
    values = folder / "values.yaml"
    switched = {"podMonitors": {"enabled": True}, "rules": {"enabled": True}}
    agents = [{"name": agent, "role": agent.split("-")[0]} for agent in platform.agents]
    images = {"platform": "unused", "suites": "unused", "ros": "unused", "ferretdb": "unused"}
    values.write_text(yaml.safe_dump({"monitoring": switched, "agents": agents, "images": images}), encoding="utf-8")
    command = [program("helm"), "template", "robotkube", str(CHART), "-n", PLATFORM, "-f", str(values)]
    shown = prometheus_server.rendered([*command, "-s", "templates/monitoring/podmonitors.yaml"])
    [rule] = prometheus_server.rendered([*command, "-s", "templates/monitoring/prometheusrule.yaml"])
    binary = prometheus.ensure() / "prometheus"
    kubeconfig = platform.installer.kubeconfig
    with prometheus_server.running(binary, folder, kubeconfig, shown, rule) as server:
        eventually("Prometheus answers", server.ready)
        yield server


def pods_with_pages(platform: Platform) -> set[str]:
    """`<namespace>/<name>` of the pods of platform and agents that have a port `health` and run."""
    named = set()
    for namespace in (PLATFORM, GATE, *platform.agents):
        for pod in platform.get("-n", namespace, "pods")["items"]:
            ports = {port.get("name") for one in pod["spec"]["containers"] for port in one.get("ports", ())}
            if "health" in ports and pod["status"]["phase"] == "Running" and "deletionTimestamp" not in pod["metadata"]:
                named.add(f"{namespace}/{pod['metadata']['name']}")
    return named


def test_it_reads_every_pod_that_has_a_page(platform: Platform, watching: Prometheus) -> None:
    def all_read() -> bool:
        targets = watching.targets()
        up = {
            f"{target['labels']['namespace']}/{target['labels']['pod']}"
            for target in targets
            if target["health"] == "up"
        }
        wanted = pods_with_pages(platform)
        return bool(wanted) and up == wanted

    eventually("every pod is read", all_read, state=lambda: [target["lastError"] for target in watching.targets()])
    jobs = {target["labels"]["job"] for target in watching.targets()}
    assert {"manager", "gate", "suite-runner", "inspector", "rights", "certificates", "mqtt-bridge"} <= jobs
    assert any(target["labels"].get("robotkube_io_agent") == AGENT for target in watching.targets())


def test_every_metric_of_dashboards_and_alerts_is_there(watching: Prometheus) -> None:
    names: set[str] = set()
    for dashboard in yaml.safe_load((FILES / "dashboards.yaml").read_text("utf-8")).values():
        names |= {name for panel in dashboard["panels"] for query, _ in panel["queries"] for name in asked(query)}
    for alert in yaml.safe_load((FILES / "alerts.yaml").read_text("utf-8")):
        names |= asked(alert["expr"])
    always = {name for name in names if not name.startswith(NOT_ALWAYS)}
    assert always >= OF_EVERY_PROCESS

    def missing() -> set[str]:
        served = watching.metrics()
        return {name for name in always if not {name, name.removesuffix("_total"), f"{name}_bucket"} & served}

    eventually("every metric was read", lambda: not missing(), state=missing)


def test_every_query_is_one(watching: Prometheus) -> None:
    for dashboard in yaml.safe_load((FILES / "dashboards.yaml").read_text("utf-8")).values():
        for panel in dashboard["panels"]:
            for query, _ in panel["queries"]:
                assert watching.ask("query", query=query)["resultType"] == "vector", panel["title"]


def test_an_alert_fires_on_a_stranger_and_ends_with_it(platform: Platform, watching: Prometheus) -> None:
    eventually("nothing is told", lambda: not QUIET & watching.firing(), state=watching.firing)
    _patch(platform, {"op": "add", "path": NOTE, "value": "x"})
    try:
        eventually("the alert fires", lambda: "RobotKubeStranger" in watching.firing(), state=watching.firing)
    finally:
        _patch(platform, {"op": "remove", "path": NOTE})
    eventually("the alert has ended", lambda: "RobotKubeStranger" not in watching.firing())


def _patch(platform: Platform, operation: dict[str, Any]) -> None:
    words = ("patch", "deployment", RELEASE, "--type=json", f"--as={WRITER}", "-p", json.dumps([operation]))
    platform.kubectl("-n", AGENT, *words)
