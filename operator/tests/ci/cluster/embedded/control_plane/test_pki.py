"""Certificates: who is signed by whom, for which names; and the API server's command line uses them."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from ci.cluster.embedded.control_plane.pki import Authority, control_plane_identities, node_identity
from ci.cluster.embedded.control_plane.programs import api_server_command
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network.addresses import plan_of

PLAN = plan_of("test")


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    made = Authority(tmp_path_factory.mktemp("cluster") / "pki")
    made.create()
    for identity in (*control_plane_identities(PLAN), node_identity("vehicle-00", "10.90.0.12")):
        made.issue(identity)
    return made


def described(authority: Authority, name: str) -> str:
    command = ["openssl", "x509", "-noout", "-text", "-in", str(authority.folder / f"{name}.crt")]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=30).stdout


def verifies(authority: Authority, by: str, name: str) -> bool:
    files = ["-CAfile", str(authority.folder / f"{by}.crt"), str(authority.folder / f"{name}.crt")]
    return subprocess.run(["openssl", "verify", *files], capture_output=True, check=False, timeout=30).returncode == 0


def test_every_certificate_is_signed_by_its_authority_only(authority: Authority) -> None:
    for identity in control_plane_identities(PLAN):
        other = "ca" if identity.authority == "etcd-ca" else "etcd-ca"
        assert verifies(authority, identity.authority, identity.name)
        assert not verifies(authority, other, identity.name)


def test_a_kubelet_is_the_node_the_authorizer_expects(authority: Authority) -> None:
    text = described(authority, "vehicle-00")
    assert "Subject: O = system:nodes, CN = system:node:vehicle-00" in text
    assert "IP Address:10.90.0.12" in text


def test_the_api_server_is_known_by_gateway_and_service(authority: Authority) -> None:
    text = described(authority, "apiserver")
    for name in (f"IP Address:{PLAN.gateway}", f"IP Address:{PLAN.kubernetes_service}", "DNS:kubernetes.default.svc"):
        assert name in text


def test_keys_are_for_the_owner_only(authority: Authority) -> None:
    assert all(path.stat().st_mode & 0o077 == 0 for path in authority.folder.glob("*.key"))


def test_a_kubeconfig_refers_to_the_identity(authority: Authority, tmp_path: Path) -> None:
    admin = next(identity for identity in control_plane_identities(PLAN) if identity.name == "admin")
    authority.write_kubeconfig(admin, "https://10.90.0.1:6443", tmp_path / "kubeconfig")
    document = json.loads((tmp_path / "kubeconfig").read_text(encoding="utf-8"))
    assert document["clusters"][0]["cluster"]["server"] == "https://10.90.0.1:6443"
    assert document["users"][0]["user"]["client-key"].endswith("admin.key")


def test_the_api_server_listens_on_the_bridge_only_and_knows_no_anonymous() -> None:
    command = api_server_command(PLAN, ClusterFolders("test"))
    assert f"--bind-address={PLAN.gateway}" in command
    assert "--anonymous-auth=false" in command
    assert "--authorization-mode=Node,RBAC" in command
    assert f"--service-cluster-ip-range={PLAN.services}" in command
