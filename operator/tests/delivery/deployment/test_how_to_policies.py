"""The examples in the pages about policies and operators are ones that the programs take."""

from __future__ import annotations

import re

from robotkube.delivery.deployment.core.policies.agents import read_enrolled
from robotkube.delivery.deployment.core.policies.edits import read_edits_policy
from robotkube.delivery.deployment.core.policies.initial import read_initial_policy
from robotkube.delivery.deployment.core.policies.links import LinkConsents, read_consents, scope_of
from robotkube.delivery.deployment.core.policies.merge import AUTOMATIC, read_merge_policy
from robotkube.delivery.deployment.core.policies.revoked import read_revoked
from robotkube.delivery.deployment.core.policies.updates import read_update_policy
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.catalogue.core.applications import read_application
from tests.stages.paths import DOCS

PAGES = DOCS / "how-to"
BLOCK = re.compile(r"^```yaml (\S+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def blocks(page: str) -> dict[str, str]:
    """Examples that say which file they are, by path."""
    return dict(BLOCK.findall((PAGES / page).read_text(encoding="utf-8")))


def test_every_policy_on_the_page_can_be_read() -> None:
    policies = blocks("write-a-policy.md")
    initial = read_initial_policy(policies.pop("policies/initial.yaml"))
    assert [addition.application for addition in initial.add] == ["bag-player", "pose-telemetry"]
    merge = read_merge_policy(policies.pop("policies/merge.yaml"))
    assert merge.way_of_plan("manager-north", ["releases/vehicle-01/a.yaml"]) == AUTOMATIC
    assert read_update_policy(policies.pop("policies/updates.yaml")).charts["object-detection"].first == ("vehicle-02",)
    assert read_revoked(policies.pop("policies/revoked.yaml")) == {"vehicle-07": "its computer was stolen"}
    assert read_enrolled(policies.pop("policies/agents.yaml")) == {"vehicle-16": "vehicle"}
    assert read_edits_policy(policies.pop("policies/edits.yaml")) == "revert"
    consents, problems = read_consents(policies, LinkConsents())
    assert problems == ()
    pose = "/vehicles/vehicle_00/pose"
    assert consents.missing(pose, "manager", "manager-north") == ()
    assert len(consents.missing("/agents/cloud_0/plan", "manager", "manager-north")) == 1
    assert {scope_of(path) for path in policies} == {"manager", "manager-north"}


def test_the_operator_on_the_page_is_an_application_that_says_who_launched_it() -> None:
    text = blocks("write-an-operator.md")["registry/applications/gate-operator.yaml"]
    application = read_application(text, "applications/gate-operator.yaml")
    [service] = application.services
    render = Jinja2Templates().render
    scope = {
        "task": {"namespace": "cloud-0", "name": "near"},
        "parameters": {"site": "roadside-0", "vehicle": "vehicle-00"},
    }
    assert render(service.values["detector"]["task"], scope) == "cloud-0/near"
