"""A reserved agent in the chart: everything is made for it but its Node, and processes know that it is reserved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.console.adapters.cluster_documents import agent_document
from robotkube.delivery.console.settings import read_configuration as read_console
from robotkube.delivery.gate import __main__ as gate
from robotkube.delivery.manager import __main__ as manager
from robotkube.delivery.manager.core.placement.placement import NodeState
from robotkube.delivery.rights import first_file
from robotkube.delivery.rights import settings as rights
from robotkube.foundation.runtime.settings_file import read_settings
from tests.stages.paths import CHARTS
from tests.stages.settings_mounted import mounted

pytestmark = pytest.mark.toolchain

PROFILE = Path(__file__).parent / "profiles" / "official.yaml"
NEW = "vehicle-16"
LIKE = "vehicle-01"  # one of the profile that is there from the beginning


@pytest.fixture(scope="module")
def rendered(helm: Any) -> Any:
    agents = yaml.safe_load(PROFILE.read_text())["agents"]
    return helm.template(CHARTS / "robotkube", PROFILE, agents=[*agents, {"name": NEW, "reserved": True}])


def of_namespace(rendered: Any, namespace: str) -> set[tuple[str, str]]:
    return {(o["kind"], o["metadata"]["name"]) for o in rendered.objects if o["metadata"].get("namespace") == namespace}


def test_it_has_what_every_agent_has(rendered: Any) -> None:
    kept = {("PersistentVolumeClaim", "bags")}
    assert of_namespace(rendered, NEW) == of_namespace(rendered, LIKE) - kept
    labels = rendered.one("Namespace", NEW)["metadata"]["labels"]
    assert (labels["robotkube.io/agent"], "robotkube.io/role" in labels) == (NEW, False)
    destinations = rendered.one("AppProject", "robotkube-apps", "argocd")["spec"]["destinations"]
    assert NEW in {destination["namespace"] for destination in destinations}


def test_the_console_starts_with_it(rendered: Any, tmp_path: Path) -> None:
    """Its role is what its Node says, when main has enrolled it."""
    settings = read_settings(mounted(rendered, "console", tmp_path), read_console)
    [agent] = [one for one in settings.agents if one["name"] == NEW]
    assert agent == {"name": NEW, "role": "", "namespace": NEW, "records": False}
    assert agent_document(agent, [])["role"] == "reserved"
    node = NodeState(NEW, NEW, "vehicle", frozenset(), ready=True)
    assert agent_document(agent, [node])["role"] == "vehicle"


def test_every_process_knows_that_it_is_reserved(rendered: Any, tmp_path: Path) -> None:
    agents = read_settings(mounted(rendered, "manager", tmp_path), manager.read_configuration).manager.agents
    assert [agent.name for agent in agents if not agent.role] == [NEW]
    settings = read_settings(mounted(rendered, "gate", tmp_path), gate.read_configuration).gate
    assert settings.reserved == {NEW}
    assert NEW in settings.proposers[0].namespaces
    accounts = read_settings(mounted(rendered, "rights", tmp_path), rights.read_configuration).accounts
    assert accounts.reserved == {NEW}
    file = tmp_path / "accounts.yaml"
    file.write_text(rendered.one("ConfigMap", "broker")["data"]["accounts.yaml"])
    assert read_settings(file, first_file.read_configuration) == accounts
    passwords = rendered.one("Secret", "broker-accounts")["stringData"]["passwords"]
    assert f"{NEW}:" in passwords


@pytest.mark.parametrize(
    ("keys", "suites_agent", "said"),
    [
        (
            {},
            "",
            'agents[1] "vehicle-16": has no role. Give one of cloud, edge, roadside, vehicle, or reserved: true for an',
        ),
        (
            {"role": "vehicle", "reserved": True},
            "",
            'agents[1] "vehicle-16": has a role and is reserved. Leave the role out, main gives it when the agent is',
        ),
        (
            {"reserved": True},
            NEW,
            'suites.agent: "vehicle-16" is reserved, and may have no Node. Use an agent that has a role.',
        ),
    ],
)
def test_what_is_refused(helm: Any, keys: dict[str, Any], suites_agent: str, said: str) -> None:
    agents = [{"name": "cloud-0", "role": "cloud"}, {"name": NEW, **keys}]
    assert said in helm.refusal(CHARTS / "robotkube", PROFILE, agents=agents, suites={"agent": suites_agent})
