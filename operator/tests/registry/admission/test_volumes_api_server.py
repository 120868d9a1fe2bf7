"""Which PersistentVolumes a real API server lets in under the policies from files: those that the provider makes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ci.cluster.embedded import first_objects
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network.addresses import plan_of
from ci.cluster.embedded.nodes.node_processes import Node, nodes_of
from ci.cluster_contract import topology
from ci.folders import PROJECT
from ci.installation import chosen_volumes
from robotkube.registry.admission.core.domain import Domain, account
from robotkube.registry.admission.core.policies import for_files
from tests.stages.attacks import shown
from tests.stages.kubernetes.judged_api_server import MERGE, Api, judged_api_server
from tests.stages.registry.admission_examples import ALLOWED, CHARTS

pytestmark = [pytest.mark.toolchain]
VOLUMES = "/api/v1/persistentvolumes"
FOLDERS = ClusterFolders("demo")
FOLDER = str(FOLDERS.volumes)
APPLY = "application/apply-patch+yaml"
SCENARIO = PROJECT / "scenarios" / "pose-point-cloud-db-recording" / "scenario.yaml"
BINDER = account("kube-system", "persistent-volume-binder")


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    domain = Domain(("vehicle-00",), (), CHARTS, elsewhere=True, volumes=FOLDER)
    with judged_api_server(tmp_path_factory.mktemp("api"), for_files(domain, ALLOWED)) as (api, _):
        yield api


def nodes() -> tuple[Node, ...]:
    return nodes_of(topology.read(SCENARIO, {"vehicles": "2"}).nodes, plan_of("demo"), FOLDERS)


def volume(path: str = f"{FOLDER}/vehicle-00/0", name: str = "other", **spec: Any) -> dict[str, Any]:
    """One as the provider makes it, with another place and other parts."""
    made = first_objects.persistent_volume(nodes()[-1], name, Path("/"))
    made["spec"].update({"local": {"path": path}, **spec})
    return made


def applied(api: Api, name: str, document: dict[str, Any], manager: str) -> None:
    headers = {"Content-Type": APPLY}
    path = f"{VOLUMES}/{name}?fieldManager={manager}"
    answer = api.client.patch(path, content=json.dumps(document), headers=headers)
    assert answer.is_success, answer.text


def test_what_the_provider_makes_is_let_in_bound_and_given_back(api: Api) -> None:
    """As a start, a node that joins, the installer and the controller manager write it."""
    for node in nodes():
        for name, folder in first_objects.volumes(node):
            applied(api, name, first_objects.persistent_volume(node, name, folder), "robotkube-cluster")
    last = first_objects.volumes(nodes()[-1])[0][0]
    agent = api.done("GET", f"{VOLUMES}/{last}")["metadata"]["labels"]["robotkube.io/agent"]
    labels = {"robotkube.io/agent": agent}
    claim = {"metadata": {"name": "a", "namespace": "b", "labels": labels}, "status": {"phase": "Pending"}}
    for name, _ in first_objects.volumes(nodes()[-1]):
        api.done("PATCH", f"{VOLUMES}/{name}/status", {"status": {"phase": "Available"}}, BINDER, MERGE)
    [bound] = chosen_volumes([claim], api.done("GET", VOLUMES)["items"])
    name = bound["metadata"]["name"]
    applied(api, name, bound, "robotkube-installation")
    given = {"metadata": {"annotations": {"pv.kubernetes.io/bound-by-controller": "yes"}}}
    api.done("PATCH", f"{VOLUMES}/{name}", given, BINDER, MERGE)
    api.done("PATCH", f"{VOLUMES}/{name}/status", {"status": {"phase": "Bound"}}, BINDER, MERGE)
    api.done("PATCH", f"{VOLUMES}/{name}", {"spec": {"claimRef": None}}, BINDER, MERGE)


PLACES = [  # below the cluster's folder
    "",
    "/",
    "/admission",
    "/volumes",
    "/volumes/",
    "/volumes/vehicle-00",
    "/volumes/vehicle-00/",
    "/volumes/vehicle-00/0/link",
    "/volumes/vehicle-00/0/1",
    "/volumes/vehicle-00/0/",
    "/volumes/vehicle-00//0",
    "/volumes//vehicle-00/0",
    "/volumes/./vehicle-00/0",
    "/volumes/vehicle-00/./0",
    "/volumes/vehicle-00/00",
    "/volumes/vehicle-00/link",
    "/volumes/vehicle-00/0\n",
    "/volumes/./0",
    "/volumess/vehicle-00/0",
]


@pytest.mark.parametrize("path", PLACES)
def test_a_volume_of_another_folder_is_refused(api: Api, path: str) -> None:
    """Below, above, and such as only look like one: in a folder that a pod writes may stand a link to anywhere."""
    words = api.refusal("POST", VOLUMES, volume(f"{FOLDERS.base}{path}"))
    assert words == (
        "PersistentVolume other is of a folder that is not for volumes. Use one of those that the cluster was made "
        f"with: {FOLDER}/<node>/<number>"
    )
    shown("admission", words, "link-in-a-volume")


SOURCES: dict[str, Any] = {
    "hostPath": {"path": f"{FOLDER}/vehicle-00/0"},
    "csi": {"driver": "hostpath.csi.k8s.io", "volumeHandle": "/"},
    "nfs": {"server": "127.0.0.1", "path": "/"},
    "fc": {"wwids": ["3600508b400105e210000900000490000"]},
    "iscsi": {"targetPortal": "127.0.0.1:3260", "iqn": "iqn.2001-04.com.example:storage.disk1", "lun": 0},
    "flexVolume": {"driver": "example/local"},
}


@pytest.mark.parametrize("kind", SOURCES)
def test_a_volume_of_another_kind_is_refused(api: Api, kind: str) -> None:
    made = volume()
    del made["spec"]["local"]
    made["spec"][kind] = SOURCES[kind]
    assert "is of a folder that is not for volumes" in api.refusal("POST", VOLUMES, made)


def test_a_volume_is_a_folder_and_no_disk(api: Api) -> None:
    disk = volume(local={"path": f"{FOLDER}/vehicle-00/0", "fsType": "ext4"})
    assert "is of a folder that is not for volumes" in api.refusal("POST", VOLUMES, disk)


OPTIONS = {"metadata": {"annotations": {"volume.beta.kubernetes.io/mount-options": "X-mount.subdir=a"}}}


def test_a_volume_is_mounted_without_options_also_later(api: Api) -> None:
    api.done("POST", VOLUMES, volume(name="plain"))
    place = f"{VOLUMES}/plain"
    words = "PersistentVolume plain has options for mounting, which could lead to other files."
    options = {"spec": {"mountOptions": ["X-mount.subdir=a"]}}
    assert api.refusal("PATCH", place, options, kind=MERGE).startswith(words)
    assert api.request("PATCH", place, OPTIONS, kind=MERGE)["status"] == "Failure"  # by the API server itself
    assert api.refusal("PATCH", f"{place}/status", OPTIONS, kind=MERGE).startswith(words)
    assert "has options" in api.refusal("POST", VOLUMES, volume(mountOptions=["X-mount.subdir=a"]))


def test_a_volume_stays_where_it_is(api: Api) -> None:
    """The API server itself lets nobody change its place."""
    api.request("POST", VOLUMES, volume(name="moved"))
    change = {"spec": {"local": {"path": f"{FOLDER}/vehicle-00/0/link"}}}
    answer = api.request("PATCH", f"{VOLUMES}/moved", change, kind=MERGE)
    assert answer["status"] == "Failure"
