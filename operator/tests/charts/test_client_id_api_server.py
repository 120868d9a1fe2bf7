"""The client id by which people sign in at the console, on a real API server: written by the account of the Job
bootstrap into the one object that it may change, and kept by an upgrade."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from kubernetes import client

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.kubernetes.adapters.client import api_client
from robotkube.setup.adapters.client_ids import ConfigMapClientIds
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.kubernetes.installed_chart import CHART, Cluster

pytestmark = pytest.mark.toolchain
PROFILES = Path(__file__).parent / "profiles"
PLACE = ("robotkube", "console-sign-in")
OURS = ("ServiceAccount/bootstrap", "Role/robotkube-bootstrap-console", "RoleBinding/robotkube-bootstrap-console")
CONFIG_MAPS = ("ConfigMap/console", "ConfigMap/console-sign-in")


def chart(helm: Any, folder: Path, **values: Any) -> Path:
    """A chart of those objects alone, as the platform's renders them."""
    files = [PROFILES / f"{name}.yaml" for name in ("official", "forge-sign-in")]
    rendered = helm.template(CHART, *files, **values).of_kind("ServiceAccount", "Role", "RoleBinding", "ConfigMap")
    kept = [one for one in rendered if f"{one['kind']}/{one['metadata']['name']}" in (*OURS, *CONFIG_MAPS)]
    assert len(kept) == len(OURS) + len(CONFIG_MAPS)
    (folder / "templates").mkdir(parents=True)
    (folder / "Chart.yaml").write_text("{apiVersion: v2, name: part, version: 0.1.0}\n")
    (folder / "templates" / "objects.yaml").write_text(yaml.safe_dump_all(kept))
    return folder


@pytest.fixture(scope="module")
def installed(api_server: ApiServerProcess, helm: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    prepared = Cluster(api_server.kubeconfig)
    prepared.run("kubectl", "create", "namespace", "robotkube")  # it may be there
    prepared.helm("install", "part", str(chart(helm, tmp_path_factory.mktemp("chart") / "part")))
    yield prepared
    prepared.helm("uninstall", "part")


@pytest.fixture(scope="module")
def job(installed: Cluster, tmp_path_factory: pytest.TempPathFactory) -> Iterator[client.ApiClient]:
    """The API server as the Job has it: by its account's token."""
    document = yaml.safe_load(installed.kubeconfig.read_text())
    document["users"][0]["user"] = {"token": installed.kubectl("create", "token", "bootstrap").strip()}
    path = tmp_path_factory.mktemp("job") / "kubeconfig"
    path.write_text(yaml.safe_dump(document))
    made = api_client(str(path))
    yield made
    made.rest_client.pool_manager.clear()


def written(installed: Cluster) -> Any:
    return json.loads(installed.kubectl("get", "configmap", PLACE[1], "-o", "json")).get("data")


def test_it_is_written_once_and_kept_by_an_upgrade(
    installed: Cluster, job: client.ApiClient, helm: Any, tmp_path: Path
) -> None:
    ids = ConfigMapClientIds(job)
    assert written(installed) is None
    assert ids.publish(*PLACE, "one")
    assert not ids.publish(*PLACE, "one")
    assert ids.publish(*PLACE, "two")
    installed.helm("upgrade", "part", str(chart(helm, tmp_path / "part", logLevel="debug")))
    assert "debug" in installed.kubectl("get", "configmap", "console", "-o", "yaml")
    assert written(installed) == {"client_id": "two"}


def test_no_other_object_is_written(job: client.ApiClient) -> None:
    for place in (("robotkube", "console"), ("default", PLACE[1])):
        with pytest.raises(InputError, match="forbidden"):
            ConfigMapClientIds(job).publish(*place, "one")


def test_where_the_chart_has_not_made_it_the_job_waits(installed: Cluster, job: client.ApiClient) -> None:
    installed.kubectl("delete", "configmap", PLACE[1])
    with pytest.raises(UnavailableError, match="ConfigMap robotkube/console-sign-in: not there; the chart makes it"):
        ConfigMapClientIds(job).publish(*PLACE, "one")
