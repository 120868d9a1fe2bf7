"""The alerts by promtool: their language is Prometheus', each fires where it should and else is silent."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from ci import prometheus
from tests.stages.paths import CHARTS

pytestmark = [pytest.mark.toolchain, pytest.mark.thorough]

PLATFORM = CHARTS / "robotkube"
PROFILE = Path(__file__).parent / "profiles" / "official.yaml"
SECONDS = 120
MINUTES = 20  # when each series is looked at; a sample every 30 s
CALM = "0x60"
QUARTER = 2160 * 3600 // 4
CERTIFICATE = 'robotkube_certificates_expiry_timestamp_seconds{secret="%s"}'


@dataclass(frozen=True)
class Case:
    """Series by which an alert fires, and such by which it is silent: what Prometheus reads -> values from 0 on."""

    fires: Mapping[str, str]
    silent: Mapping[str, str]


GATE, MANAGER = 'robotkube_gate_rounds_total{job="gate"}', 'robotkube_manager_leader{job="manager"}'
STEPS = 'robotkube_manager_steps_total{job="manager",namespace="robotkube"}'
FAILURES = 'robotkube_manager_step_failures_total{job="manager",namespace="robotkube"}'
OF_MAIN, OF_BROKER = (f'robotkube_rights_failures_total{{with="{one}"}}' for one in ("main", "broker"))
PLANS = 'robotkube_manager_plans_total{job="manager",namespace="robotkube",kind="task",outcome="%s"}'
LOOK = '{looks_at="node",node="vehicle-00"}'
WRITES = 'robotkube_inspection_write_failures_total{result="%s"}'
POD = '{namespace="vehicle-00",pod="mqtt-bridge-0"}'
DROPPED = (
    'robotkube_bridge_dropped_messages_total{namespace="vehicle-00",pod="mqtt-bridge-0",channel="bulk",'
    'topic="/cloud",where="outbox",why="too many"}'
)
CHANNEL = 'robotkube_bridge_connected{namespace="vehicle-00",pod="mqtt-bridge-0",channel="%s"}'

CASES = {
    "RobotKubeForgeAway": Case(
        {"robotkube_rights_unconfirmed_seconds": "0+30x60", OF_MAIN: "0+1x60"},
        {"robotkube_rights_unconfirmed_seconds": "0+30x60", OF_MAIN: CALM, OF_BROKER: "0+1x60"},
    ),
    "RobotKubeManagerHindered": Case({STEPS: "0+10x60", FAILURES: "0+9x60"}, {STEPS: "0+10x60", FAILURES: "0+2x60"}),
    "RobotKubeNoManagerLeads": Case({MANAGER: CALM}, {MANAGER: "1x60", 'robotkube_manager_leader{pod="other"}': CALM}),
    "RobotKubeGateAway": Case({MANAGER: "1x60"}, {GATE: "0+1x60"}),
    "RobotKubePlanNotObserved": Case(
        {PLANS % "unobserved": "0x30 1x30"}, {PLANS % "unobserved": "3x60", PLANS % "observed": "0+1x60"}
    ),
    "RobotKubeMainBroken": Case(
        {'robotkube_manager_main_broken_files{job="manager"}': "2x60"},
        {'robotkube_manager_main_broken_files{job="manager"}': CALM},
    ),
    "RobotKubeUncheckedCommits": Case(
        {'robotkube_gate_unchecked_commits{how="no-record"}': "1x60"},
        {'robotkube_gate_unchecked_commits{how="no-record"}': CALM},
    ),
    "RobotKubeBreakGlass": Case(
        {"robotkube_gate_break_glass_commits": "1x60"}, {"robotkube_gate_break_glass_commits": CALM}
    ),
    "RobotKubeStranger": Case(
        {'robotkube_inspection_strangers{looks_at="node",node="vehicle-00",reason="Unlisted"}': "1x60"},
        {'robotkube_inspection_strangers{looks_at="node",node="vehicle-00",reason="Unlisted"}': "1x20 _x40"},
    ),
    "RobotKubeAgentUnseen": Case(
        {f"robotkube_inspection_look_age_seconds{LOOK}": "0+30x60"},
        {f"robotkube_inspection_look_age_seconds{LOOK}": "12x60", f"robotkube_inspection_unseen{LOOK}": CALM},
    ),
    "RobotKubeInspectionHindered": Case({WRITES % "Changed": "0+1x60"}, {WRITES % "Unanswered": "0+1x60"}),
    "RobotKubeAnotherHand": Case(
        {'robotkube_inspection_restored_total{namespace="robotkube",job="inspector"}': "0x30 1x30"},
        {'robotkube_inspection_restored_total{namespace="robotkube",job="inspector"}': "1x60"},
    ),
    "RobotKubeRightsBehind": Case({"robotkube_rights_behind": "1x60"}, {"robotkube_rights_behind": "1x10 0x50"}),
    "RobotKubeCertificateEnds": Case(
        {CERTIFICATE % "database-tls": f"{QUARTER - 60}x60", CERTIFICATE % "broker-tls": f"{QUARTER + 3600}x60"},
        {CERTIFICATE % "database-tls": f"{QUARTER + 3600}x60"},
    ),
    "RobotKubeBridgeOffline": Case(
        {CHANNEL % "telemetry": CALM, CHANNEL % "bulk": CALM}, {CHANNEL % "telemetry": "1x60", CHANNEL % "bulk": CALM}
    ),
    "RobotKubeMessagesDropped": Case({DROPPED: "0+1x60"}, {DROPPED: "7x60"}),
    "RobotKubeRecordingGaps": Case(
        {'robotkube_recorder_dropped_total{namespace="cloud-0",pod="recorder",recording="a"}': "3x60"},
        {'robotkube_recorder_dropped_total{namespace="cloud-0",pod="recorder",recording="a"}': CALM},
    ),
    "RobotKubeSettingsRefused": Case(
        {f"robotkube_settings_refused{POD}": "1x60"}, {f"robotkube_settings_refused{POD}": CALM}
    ),
    "RobotKubeReactionsGivenUp": Case(
        {'robotkube_detector_reaction_dead_total{namespace="cloud-0",pod="detector",reaction="store"}': "0+1x60"},
        {'robotkube_detector_reaction_dead_total{namespace="cloud-0",pod="detector",reaction="store"}': "2x60"},
    ),
}
AN_HOUR = {CERTIFICATE % "broker-tls": "0x60"}  # before the first look


@pytest.fixture(scope="module")
def promtool() -> Path:
    return prometheus.ensure() / "promtool"


@pytest.fixture(scope="module")
def rules(helm: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The groups of the rendered PrometheusRule, as a file of Prometheus' own."""
    shown = helm.template(PLATFORM, PROFILE, monitoring={"rules": {"enabled": True}})
    path = Path(tmp_path_factory.mktemp("rules") / "rules.yaml")
    path.write_text(yaml.safe_dump(shown.one("PrometheusRule", "robotkube")["spec"]), encoding="utf-8")
    return path


def ask(program: Path, *words: str) -> str:
    """What promtool says; fails when it finds something wrong."""
    done = subprocess.run([str(program), *words], capture_output=True, text=True, timeout=SECONDS, check=False)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    return done.stdout


def tried(alert: str, series: Mapping[str, str], firing: int) -> Mapping[str, Any]:
    """One case in promtool's form: how many alerts of the name fire at the end."""
    return {
        "name": f"{alert} {firing}",
        "interval": "30s",
        "input_series": [{"series": name, "values": values} for name, values in series.items()],
        "promql_expr_test": [
            {
                "expr": f'count(ALERTS{{alertname="{alert}",alertstate="firing"}}) or vector(0)',
                "eval_time": f"{MINUTES}m",
                "exp_samples": [{"labels": "{}", "value": firing}],
            }
        ],
    }


def test_the_rules_are_what_prometheus_reads(promtool: Path, rules: Path) -> None:
    assert f"{len(CASES)} rules found" in ask(promtool, "check", "rules", str(rules))


def test_each_alert_has_its_cases(rules: Path) -> None:
    [group] = yaml.safe_load(rules.read_text("utf-8"))["groups"]
    assert [rule["alert"] for rule in group["rules"]] == list(CASES)


def test_each_alert_fires_and_is_silent(promtool: Path, rules: Path, tmp_path: Path) -> None:
    tests = [tried(alert, case.fires, 1) for alert, case in CASES.items()]
    tests += [tried(alert, case.silent, 0) for alert, case in CASES.items()]
    tests += [tried("RobotKubeCertificateEnds", AN_HOUR, 0)]
    path = tmp_path / "cases.yaml"
    path.write_text(yaml.safe_dump({"rule_files": [str(rules)], "evaluation_interval": "30s", "tests": tests}))
    assert "SUCCESS" in ask(promtool, "test", "rules", str(path))


def test_a_case_that_does_not_hold_is_seen(promtool: Path, rules: Path, tmp_path: Path) -> None:
    """An alert that is silent is not taken for one that fires."""
    path = tmp_path / "cases.yaml"
    case = tried("RobotKubeStranger", CASES["RobotKubeStranger"].silent, 1)
    path.write_text(yaml.safe_dump({"rule_files": [str(rules)], "evaluation_interval": "30s", "tests": [case]}))
    with pytest.raises(AssertionError, match="RobotKubeStranger"):
        ask(promtool, "test", "rules", str(path))
