"""The process that writes admission on other clusters: on a real API server, with the rights that the chart gives it,
behind a real forge that the chart's Job has set up."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

from robotkube.foundation.kubernetes.adapters.client import api_client
from robotkube.foundation.runtime.adapters.prometheus_series import series_text
from robotkube.foundation.runtime.settings_file import read_settings
from robotkube.registry.admission import __main__ as process
from robotkube.registry.admission.adapters.policy_objects import PolicyObjects
from robotkube.registry.admission.core.domain import account
from robotkube.registry.admission.core.list_objects import COMMIT, KEYS_CHARACTERS_MAX, documents_for_api, list_object
from robotkube.registry.admission.core.listing import AllowedVersions
from robotkube.registry.admission.core.policies import API_POLICIES, LIST, list_entries
from robotkube.registry.admission.loops import follower
from robotkube.registry.evidence.adapters.dsse import KeyFile
from robotkube.setup import bootstrap
from robotkube.setup.adapters.gitea_administration import GiteaAdministration
from robotkube.setup.loops.bootstrap import Bootstrap
from tests.charts.conftest import PLATFORM, Helm, Rendered
from tests.charts.test_admission import FILES
from tests.stages import http_calls
from tests.stages.attacks import shown
from tests.stages.forge.gitea import ForgeProcess
from tests.stages.forge.installation import Clone
from tests.stages.kubernetes.controllers import controlling
from tests.stages.kubernetes.installed_chart import Cluster, prepared_cluster
from tests.stages.kubernetes.judged_api_server import Requests
from tests.stages.programs import free_port
from tests.stages.registry.admission_examples import REPLICA_SETS, digest, image, path, pod
from tests.stages.registry.signed_evidence import artefact, published, signing_key, trusting
from tests.stages.settings_mounted import mounted
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain
AGENT = "vehicle-00"
PODS = path("Pod", AGENT) + "?dryRun=All"
LISTS = "/api/v1/namespaces/robotkube/configmaps"
POLICIES = "/apis/admissionregistration.k8s.io/v1/validatingadmissionpolicies"
BINDINGS = "/apis/admissionregistration.k8s.io/v1/validatingadmissionpolicybindings"
ACCOUNT = account("robotkube", "admission")
OWN = (
    *("ClusterRole", "ClusterRoleBinding", "Role", "RoleBinding", "ServiceAccount"),
    *("ConfigMap", "Service", "Deployment", "NetworkPolicy"),
)


@dataclass
class Stage:
    """An installation: `catalogue` pushes as the gate does, `writer` is the process, `api` asks as administrator."""

    cluster: Cluster
    api: Requests
    forge: ForgeProcess
    catalogue: Clone
    key: KeyFile
    writer: process.AdmissionWriter
    settings: process.AdmissionConfiguration
    stop: Callable[[], None]

    def publish(self, files: Mapping[str, str]) -> str:
        """The commit of main that has these files besides."""
        commit = self.catalogue.commit(dict(files), "published", [self.catalogue.tip()])
        assert self.catalogue.push(commit, "refs/heads/main") == ""
        return commit

    def listed(self) -> dict[str, Any]:
        return self.api.request("GET", f"{LISTS}/{LIST}")

    def follows(self, commit: str) -> bool:
        return bool(self.listed()["metadata"].get("annotations", {}).get(COMMIT) == commit)

    def starts(self, reference: str) -> bool:
        """Return whether a pod of a ReplicaSet may run this image on the agent."""
        return bool(self.api.request("POST", PODS, pod(reference), REPLICA_SETS)["kind"] == "Pod")

    def counted(self, name: str) -> float:
        text = series_text([*self.writer.follower.metrics(), *self.writer._metrics()])
        [line] = [line for line in text.splitlines() if line.startswith(f"robotkube_admission_{name} ")]
        return float(line.split()[1])


@contextmanager
def running(writer: process.AdmissionWriter) -> Iterator[Callable[[], None]]:
    """The process's parts at work; what ends them sooner."""
    stopping = threading.Event()
    thread = threading.Thread(target=writer.run, args=(stopping,))
    thread.start()

    def stop() -> None:
        stopping.set()
        thread.join(30)
        assert not thread.is_alive()

    try:
        yield stop
    finally:
        stop()


def set_up(rendered: Rendered, forge: ForgeProcess, folder: Path, webhook: str) -> str:
    """Accounts, repositories and the process's webhook as the chart's Job makes them; the gate's password."""
    made = read_settings(mounted(rendered, "bootstrap", folder), bootstrap.read_configuration).forge
    assert made is not None
    hooks = tuple(replace(one, url=webhook) for one in made.setup.webhooks if "//admission." in one.url)
    administration = GiteaAdministration(forge.url, forge.administrator, forge.administrator_password)
    Bootstrap(30, time.monotonic, time.sleep).forge(replace(made.setup, webhooks=hooks), administration)
    administration.disconnect()
    return next(one.password for one in made.setup.accounts if one.name == "gate")


def settings_of(rendered: Rendered, forge: ForgeProcess, port: int, key: KeyFile, folder: Path) -> Path:
    """The chart's settings, with the places of these tests."""
    mount = mounted(rendered, "admission", folder)
    document = yaml.safe_load(mount.read_text())
    document["forge"]["url"] = forge.url
    del document["forge"]["authorities"]  # this forge speaks in clear text
    document["listen"] = {"address": "127.0.0.1", "port": port}
    trusting(folder / "keys", key)
    mount.write_text(yaml.safe_dump(document))
    return mount


def kubeconfig_of(cluster: Cluster, folder: Path) -> Path:
    """Access with a token of the process's account."""
    document = yaml.safe_load(cluster.kubeconfig.read_text())
    document["users"][0]["user"] = {"token": cluster.kubectl("create", "token", "admission").strip()}
    config = folder / "admission-kubeconfig"
    config.write_text(yaml.safe_dump(document))
    return config


@pytest.fixture(scope="module")
def rendered(helm: Helm) -> Rendered:
    return helm.template(PLATFORM, *FILES, admission={"enabled": True})


@pytest.fixture(scope="module")
def cluster(rendered: Rendered, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """An API server with what Helm installs of admission, and the controllers, which collect garbage."""
    folder = tmp_path_factory.mktemp("api")
    with prepared_cluster(folder) as prepared, controlling(folder, prepared.kubeconfig):
        own = [one for one in rendered.of_kind(*OWN) if "admission" in one["metadata"]["name"]]
        prepared.kubectl("apply", "-f", "-", text=yaml.safe_dump_all(own))
        prepared.kubectl("create", "namespace", AGENT)
        yield prepared


@pytest.fixture(scope="module")
def api(cluster: Cluster) -> Iterator[Requests]:
    with cluster.client() as client:
        yield Requests(client)


@pytest.fixture(scope="module")
def stage(
    rendered: Rendered, cluster: Cluster, api: Requests, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Stage]:
    """The process by the chart's settings, woken by webhooks and watches alone: nothing is polled."""
    folder = tmp_path_factory.mktemp("admission")
    port = free_port()
    key = signing_key(folder / "key")
    forge = ForgeProcess(folder / "forge")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(follower, "RESYNC_SECONDS", 3600.0)
        forge.start()
        try:
            password = set_up(rendered, forge, folder / "bootstrap", f"http://127.0.0.1:{port}/webhook")
            path = settings_of(rendered, forge, port, key, folder / "own")
            settings = read_settings(path, process.read_configuration)
            access = api_client(str(kubeconfig_of(cluster, folder)))
            writer = process.AdmissionWriter(settings, access, folder / "work")
            clone = Clone(forge.url, "robotkube/catalogue", "gate", password, folder / "clone")
            with running(writer) as stop:
                until(lambda: not writer.follower.reasons_not_ready(), "the first list is written")
                yield Stage(cluster, api, forge, clone, key, writer, settings, stop)
            access.rest_client.pool_manager.clear()
        finally:
            forge.remove()


def test_before_anything_is_published_only_what_the_platform_is_made_of_starts(
    stage: Stage, rendered: Rendered
) -> None:
    """So the platform is installed under the policies; agents wait for a publication."""
    platform = path("Pod", "robotkube") + "?dryRun=All"
    for place in (PODS, platform):  # each policy begins to count by itself
        until(lambda place=place: "may not run" in str(stage.api.request("POST", place, pod(image(1)), REPLICA_SETS)))
    own = next(c["image"] for _, spec in rendered.pods for c in spec["containers"])
    assert stage.api.request("POST", platform, pod(own), REPLICA_SETS)["kind"] == "Pod"
    assert {item["metadata"]["name"] for item in stage.api.done("GET", POLICIES)["items"]} == set(API_POLICIES)
    assert stage.listed()["data"] == {} if "data" in stage.listed() else True


def test_a_publication_is_listed_at_once_and_its_pods_start(stage: Stage) -> None:
    """Nothing is polled here: the forge's webhook is what brings it. How long it takes is printed."""
    app = artefact("app")
    assert not stage.starts(image(1))
    commit = stage.publish(published(stage.key, app, images=(image(1),)))
    began = time.monotonic()
    until(lambda: stage.follows(commit), "main is followed")
    listed = time.monotonic() - began
    until(lambda: stage.starts(image(1)), "the pod is admitted")
    print(f"listed {listed:.2f} s after its publication, at work after {time.monotonic() - began:.2f} s")
    assert stage.listed()["data"] == list_entries((f"app@{app.digest}",), (digest(1),))
    assert not stage.writer.follower.reasons_not_ready()
    assert not stage.starts(image(3))


def test_what_no_trusted_key_signed_is_not_listed(stage: Stage, tmp_path: Path) -> None:
    before = stage.listed()["data"]
    other = published(signing_key(tmp_path / "other"), artefact("stranger"), images=(image(3),))
    commit = stage.publish(other)
    until(lambda: stage.follows(commit), "main is followed")
    assert stage.listed()["data"] == before
    assert not stage.starts(image(3))


@pytest.mark.parametrize(
    "place",
    [f"{LISTS}/{LIST}", f"{POLICIES}/robotkube-agents", f"{BINDINGS}/robotkube-agents"],
)
def test_what_an_administrator_deletes_comes_back(stage: Stage, place: str, caplog: pytest.LogCaptureFixture) -> None:
    before = stage.api.done("GET", place)
    restored = stage.counted("restored_total")
    stage.api.done("DELETE", place)
    until(lambda: stage.api.request("GET", place)["kind"] == before["kind"], "it is there again")
    until(lambda: stage.starts(image(1)) and not stage.starts(image(3)), "it is at work again")
    until(lambda: stage.counted("restored_total") == restored + 1, "and counted")
    until(lambda: "admission object restored" in caplog.text, "and said")
    shown("admission", caplog.text, "policy-deleted-elsewhere")


def test_what_somebody_adds_is_taken_away(stage: Stage) -> None:
    """A digest in the list, another rule in a policy, a binding that only warns."""
    digests = list_entries((), (digest(3),))
    stage.api.done("PATCH", f"{LISTS}/{LIST}", {"data": digests}, kind="application/merge-patch+json")
    until(lambda: not set(digests) & set(stage.listed()["data"]), "the digest is gone")
    for place, change in (
        (f"{POLICIES}/robotkube-agents", {"matchConditions": [{"name": "never", "expression": "false"}]}),
        (f"{BINDINGS}/robotkube-agents", {"validationActions": ["Warn"]}),
    ):
        before = stage.api.done("GET", place)["spec"]
        stage.api.done("PATCH", place, {"spec": change}, kind="application/merge-patch+json")
        until(lambda place=place, before=before: stage.api.done("GET", place)["spec"] == before, "as it was")
    until(lambda: not stage.starts(image(3)), "it is at work")


def test_while_the_forge_is_away_the_last_list_stays_and_comes_back(stage: Stage) -> None:
    before = stage.listed()["data"]
    failed = stage.counted("failures_total")
    stage.forge.stop()
    stage.api.done("DELETE", f"{LISTS}/{LIST}")
    until(lambda: stage.listed().get("data") == before, "the list is there again")
    until(lambda: stage.counted("failures_total") > failed, "the forge was asked")
    assert not stage.writer.follower.reasons_not_ready()
    assert stage.starts(image(1))
    assert stage.counted("unconfirmed_seconds") > 0
    stage.forge.start()
    until(lambda: not stage.writer.follower.problem, "main is followed again")


def test_a_process_that_starts_while_the_forge_is_away_keeps_the_list(stage: Stage, tmp_path: Path) -> None:
    before = stage.listed()["data"]
    forge = stage.settings.forge
    away = replace(forge, address=replace(forge.address, url=f"http://127.0.0.1:{free_port()}"))
    nowhere = replace(stage.settings, forge=away)
    listen = replace(nowhere.listen, port=free_port())
    access = api_client(str(kubeconfig_of(stage.cluster, tmp_path)))
    again = process.AdmissionWriter(replace(nowhere, listen=listen), access, tmp_path / "work")
    with running(again):
        until(lambda: again.follower.problem, "the forge is asked")
        [reason] = again.follower.reasons_not_ready()
    assert reason.startswith("main of the catalogue was not read yet: git http://127.0.0.1")
    assert stage.listed()["data"] == before
    access.rest_client.pool_manager.clear()


def test_the_account_may_do_this_and_nothing_else(stage: Stage) -> None:
    """Tried, not asked: other names, other namespaces, reading what is beside its own."""

    def refused(method: str, path: str, body: Any = None, kind: str = "") -> bool:
        answer = stage.api.request(method, path, body, ACCOUNT, kind)
        return bool(answer.get("code") == 403)

    apply = "application/apply-patch+yaml"
    head = {"apiVersion": "v1", "kind": "ConfigMap"}
    query = "?fieldManager=x&force=true&dryRun=All"
    stage.api.done("GET", f"{LISTS}/{LIST}", user=ACCOUNT)
    other = {**head, "metadata": {"name": "other"}}
    assert refused("POST", LISTS, other)
    assert refused("PATCH", f"{LISTS}/other{query}", other, apply)
    assert refused("GET", f"{LISTS}/evidence-keys")
    assert refused("GET", LISTS)
    assert refused("DELETE", f"{LISTS}/admission-platform?dryRun=All")
    assert refused("GET", f"/api/v1/namespaces/{AGENT}/configmaps")
    assert refused("GET", "/api/v1/namespaces/robotkube/secrets")
    assert refused("POST", PODS, pod(image(1)))
    for place in (POLICIES, BINDINGS):
        listed = stage.api.done("GET", f"{place}/robotkube-agents")
        renamed = {**listed, "metadata": {"name": "others"}}
        assert refused("POST", place, renamed)
        assert refused("PATCH", f"{place}/others{query}", renamed, apply)
        assert refused("DELETE", f"{place}/others")
    role = "/apis/rbac.authorization.k8s.io/v1/clusterroles/robotkube-admission"
    assert refused("PATCH", role, {"rules": []}, "application/merge-patch+json")


def test_the_command_follows_until_it_is_told_to_end(stage: Stage, rendered: Rendered, tmp_path: Path) -> None:
    """As the pod starts it; beside the process of these tests, which writes the same."""
    port = free_port()
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(sys.path),
        "ROBOTKUBE_CONFIG": str(settings_of(rendered, stage.forge, port, stage.key, tmp_path / "own")),
        "ROBOTKUBE_WORK": str(tmp_path / "work"),
        "KUBECONFIG": str(kubeconfig_of(stage.cluster, tmp_path)),
    }
    page = f"http://127.0.0.1:{port}"
    command = [sys.executable, "-m", "robotkube.registry.admission"]
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as started:
        try:
            until(lambda: started.poll() is not None or answers(f"{page}/readyz"), "it is ready")
            metrics = http_calls.get(f"{page}/metrics").text
        finally:
            started.terminate()
            said = started.communicate(timeout=30)[1]
    assert started.returncode == 0, said
    assert "robotkube_admission_behind 0.0" in metrics
    assert 'robotkube_admission_listed{kind="images"} 1.0' in metrics
    assert '"event": "started"' in said


def answers(url: str) -> bool:
    try:
        return http_calls.get(url, timeout=5).is_success
    except httpx.HTTPError:
        return False


def test_policies_of_what_is_gone_are_removed(stage: Stage, cluster: Cluster, tmp_path: Path) -> None:
    """The last agent is taken out of the values. From here on the process of these tests stands still."""
    stage.stop()
    access = api_client(str(kubeconfig_of(cluster, tmp_path)))
    place = PolicyObjects(access, "robotkube", lambda: None)
    assert place.write(documents_for_api(replace(stage.settings.domain, agents=()), AllowedVersions()))
    access.rest_client.pool_manager.clear()
    names = {item["metadata"]["name"] for item in stage.api.done("GET", POLICIES)["items"]}
    assert names == set(API_POLICIES) - {"robotkube-agents"}
    assert len(stage.api.done("GET", BINDINGS)["items"]) == len(names)


def test_uninstalled_it_leaves_nothing_that_locks_an_agents_namespace(stage: Stage) -> None:
    """Helm deletes the process and its rights, the cluster what belongs to them."""
    stage.stop()
    for kind in ("clusterrolebinding", "rolebinding", "role", "clusterrole"):
        stage.cluster.kubectl("delete", kind, "robotkube-admission")
    for place in (POLICIES, BINDINGS):
        until(lambda place=place: not stage.api.done("GET", place)["items"], f"{place} is empty")
    until(lambda: json.dumps(stage.listed()).find("NotFound") > 0, "the list is gone")
    until(lambda: stage.starts(image(3)), "nothing is judged any more")


def test_a_list_of_the_greatest_size_is_taken(stage: Stage, cluster: Cluster) -> None:
    """By an administrator's account, after everything else is gone."""
    access = api_client(str(cluster.kubeconfig))
    place = PolicyObjects(access, "robotkube", lambda: None)
    images = tuple(digest(number) for number in range(KEYS_CHARACTERS_MAX // 70))
    assert place.write([list_object("robotkube", AllowedVersions((), images))])
    assert place.write([list_object("robotkube", AllowedVersions((), images[1:], commit="c" * 40))])
    others = tuple(digest(10**6 + number) for number in range(len(images)))  # all of it written anew, by another verb
    assert place.write([list_object("robotkube", AllowedVersions((), others))])
    assert len(stage.listed()["data"]) == len(others)
    access.rest_client.pool_manager.clear()
