"""Alerts and dashboards ask for metrics that exist: those that the reference pages name."""

from __future__ import annotations

import yaml

from tests.stages.monitoring import FILES, OF_EVERY_PROCESS, asked, documented


def test_every_alert_asks_for_metrics_that_exist() -> None:
    alerts = yaml.safe_load((FILES / "alerts.yaml").read_text("utf-8"))
    assert len({alert["alert"] for alert in alerts}) == len(alerts) >= 6
    assert {alert["severity"] for alert in alerts} == {"critical", "warning"}
    names = documented()
    missing = {alert["alert"]: metrics for alert in alerts if (metrics := asked(alert["expr"]) - names)}
    assert missing == {}
    assert all(asked(alert["expr"]) for alert in alerts)


def test_every_panel_asks_for_metrics_that_exist() -> None:
    dashboards = yaml.safe_load((FILES / "dashboards.yaml").read_text("utf-8"))
    names = documented() | OF_EVERY_PROCESS
    queries = {
        f"{name}: {panel['title']}": asked(expression)
        for name, dashboard in dashboards.items()
        for panel in dashboard["panels"]
        for expression, _ in panel["queries"]
    }
    assert {title: metrics - names for title, metrics in queries.items() if metrics - names} == {}
    assert all(queries.values())


def test_a_name_that_nobody_serves_is_seen() -> None:
    assert asked('sum(rate(robotkube_manager_plans_lost_total{outcome="x"}[5m]))') - documented()
    assert not asked("histogram_quantile(0.5, robotkube_manager_merged_seconds_bucket)") - documented()
