"""One digest per image everywhere: in the lock file, in every node's containerd, in the forge's registry."""

from __future__ import annotations

import subprocess

from ci import publish
from ci.cluster.embedded.host import processes
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.nodes.node_processes import socket_of
from ci.images import preparation
from robotkube.registry.charts.adapters.oci import OciRegistry
from tests.stages.platform.running_platform import Platform


def test_every_node_has_the_digests_of_the_lock(platform: Platform) -> None:
    expected = {image.reference: image.reference.partition("@")[2] for image in preparation.everything().images}
    records = processes.recorded(ClusterFolders(platform.name))
    holders = [process for process in records if process.name.endswith(".node")]
    assert len(holders) == len(platform.provider.nodes())
    for holder in holders:
        control = [str(platform.provider.binaries / "ctr"), "--address", str(socket_of(holder)), "-n", "k8s.io"]
        listed = subprocess.run([*control, "images", "ls"], capture_output=True, text=True, check=True, timeout=60)
        digests = {line.split()[0]: line.split()[2] for line in listed.stdout.splitlines()[1:]}
        assert {reference: digests.get(reference) for reference in expected} == expected, holder.name


def test_the_registry_serves_the_same_digests(platform: Platform) -> None:
    forge = publish.find_forge(platform.installer.kubeconfig)
    with OciRegistry(forge.url, publish.ACCOUNT, forge.password) as registry:
        for image in preparation.everything().images:
            repository, digest = image.repository.partition("/")[2], image.reference.partition("@")[2]
            assert registry.manifest_digest(repository, digest) == digest


def test_pods_run_what_the_charts_name_by_digest(platform: Platform) -> None:
    references = {image.reference for image in preparation.everything().images}
    digests = {reference.partition("@")[2] for reference in references}
    for namespace in ("robotkube", "robotkube-gate", "argocd"):
        for pod in platform.get("-n", namespace, "pods")["items"]:
            used = {container["image"] for container in pod["spec"]["containers"]}
            assert used <= references, pod["metadata"]["name"]
            at_work = {status["imageID"].rpartition("@")[2] for status in pod["status"].get("containerStatuses", ())}
            assert at_work <= digests, pod["metadata"]["name"]
