"""The Job of `helm test` in the rendered chart: its rights, its account of the database, and where there is none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.stages.paths import CHARTS

pytestmark = pytest.mark.toolchain

PLATFORM = CHARTS / "robotkube"
PROFILE = Path(__file__).parent / "profiles" / "official.yaml"
NAME = "installation-test"


def settings(rendered: Any) -> dict[str, Any]:
    return dict(yaml.safe_load(rendered.one("ConfigMap", NAME)["data"]["config.yaml"]))


def test_it_is_a_hook_of_helm_test_that_ends_within_a_minute(official: Any) -> None:
    job = official.one("Job", NAME)
    hooks = {key: value for key, value in job["metadata"]["annotations"].items() if key.startswith("helm.sh/")}
    assert hooks == {
        "helm.sh/hook": "test",
        "helm.sh/hook-delete-policy": "before-hook-creation,hook-succeeded",
        "helm.sh/hook-output-log-policy": "hook-failed",
    }
    assert (job["spec"]["activeDeadlineSeconds"], job["spec"]["backoffLimit"]) == (60, 0)


def test_it_may_make_read_and_delete_tasks_of_one_namespace_and_nothing_else(official: Any) -> None:
    bindings = [
        (one["metadata"]["namespace"], one["roleRef"]["name"])
        for one in official.of_kind("RoleBinding", "ClusterRoleBinding")
        if any(subject["name"] == NAME for subject in one["subjects"])
    ]
    assert bindings == [("cloud-0", f"robotkube-{NAME}")]
    [rule] = official.one("Role", f"robotkube-{NAME}", "cloud-0")["rules"]
    assert rule == {
        "apiGroups": ["robotkube.io"],
        "resources": ["taskdescriptions"],
        "verbs": ["create", "get", "delete"],
    }


def test_its_recording_is_that_of_the_agent_whose_account_it_has(official: Any) -> None:
    asked = settings(official)
    assert (asked["agent"], asked["parameters"]) == ("cloud-0", {"vehicles": ["vehicle-00"]})
    [mounted] = [one for one in dict(official.pods)[f"Job/{NAME}"]["volumes"] if one["name"] == "secrets"]
    assert [one["secret"]["name"] for one in mounted["projected"]["sources"][:1]] == ["database-account-cloud-0"]
    assert official.one("Secret", "database-account-cloud-0")["stringData"]["database"] == "recordings_cloud_0"


def test_the_values_say_what_is_asked_for(helm: Any) -> None:
    given = {"application": "my-recording", "parameters": {"sensors": ["mast-0"]}}
    assert settings(helm.template(PLATFORM, PROFILE, installationTest=given)) | given == settings(
        helm.template(PLATFORM, PROFILE, installationTest=given)
    )


@pytest.mark.parametrize(
    "values",
    [
        {"agents": [{"name": "vehicle-00", "role": "vehicle"}, {"name": "cloud-0", "role": "cloud"}]},
        {"database": {"kind": "external", "external": {"host": "mongo.example"}}},
    ],
    ids=["nobody records", "an account of another's making"],
)
def test_there_is_none_where_nothing_could_be_read(helm: Any, values: dict[str, Any]) -> None:
    rendered = helm.template(PLATFORM, PROFILE, **values)
    kinds = {one["kind"] for one in rendered.objects if one["metadata"]["name"].endswith(NAME)}
    assert kinds == set()


def test_an_upgrade_that_reuses_older_values_has_it(helm: Any, official: Any) -> None:
    rendered = helm.template(PLATFORM, PROFILE, installationTest=None)
    assert settings(rendered) == settings(official)
