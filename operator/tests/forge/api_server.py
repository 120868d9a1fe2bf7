"""An API server without nodes (etcd and kube-apiserver on loopback), with Argo CD's objects as they are before us."""

import base64
import secrets
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from forge_process import REPOSITORY_ROOT, find_program, free_port
from kubernetes import client

START_SECONDS_MAX = 60.0
ROLE = REPOSITORY_ROOT / "charts" / "robotkube" / "templates" / "bootstrap" / "role.yaml"
NAMESPACE = "argocd"


@dataclass
class ApiServer:
    """`administrator` may everything, `bootstrap` what the platform chart's Role of the Job says."""

    folder: Path
    port: int = field(default_factory=free_port)
    tokens: dict[str, str] = field(
        default_factory=lambda: {name: secrets.token_hex(16) for name in ("administrator", "bootstrap")}
    )
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start(self) -> None:
        """Both processes, until the API server is ready."""
        etcd, peer, key = free_port(), free_port(), self.folder / "account.key"
        subprocess.run(["openssl", "genrsa", "-out", str(key), "2048"], check=True, capture_output=True, timeout=30)
        rows = [
            f"{self.tokens['administrator']},administrator,1,system:masters",
            f"{self.tokens['bootstrap']},bootstrap,2",
        ]
        (self.folder / "tokens.csv").write_text("\n".join(rows) + "\n")
        self._run(
            "etcd", f"--data-dir={self.folder}/etcd", "--unsafe-no-fsync",
            f"--listen-client-urls=http://127.0.0.1:{etcd}", f"--advertise-client-urls=http://127.0.0.1:{etcd}",
            f"--listen-peer-urls=http://127.0.0.1:{peer}", f"--initial-advertise-peer-urls=http://127.0.0.1:{peer}",
            f"--initial-cluster=default=http://127.0.0.1:{peer}",
        )  # fmt: skip
        self._run(
            "kube-apiserver", f"--etcd-servers=http://127.0.0.1:{etcd}", "--bind-address=127.0.0.1",
            f"--secure-port={self.port}", f"--cert-dir={self.folder}/certificates", "--authorization-mode=RBAC",
            f"--token-auth-file={self.folder}/tokens.csv", "--service-cluster-ip-range=10.255.0.0/24",
            "--service-account-issuer=https://kubernetes.default.svc", f"--service-account-key-file={key}",
            f"--service-account-signing-key-file={key}", "--endpoint-reconciler-type=none",
        )  # fmt: skip
        self._wait()

    def _run(self, program: str, *arguments: str) -> None:
        command = [str(find_program().parent / program), *arguments]
        with (self.folder / f"{program}.log").open("wb") as log:
            self.processes.append(subprocess.Popen(command, stdout=log, stderr=log))

    def _wait(self) -> None:
        end = time.monotonic() + START_SECONDS_MAX
        while not self._ready():
            log = (self.folder / "kube-apiserver.log").read_text(errors="replace")[-2000:]
            assert all(process.poll() is None for process in self.processes), log
            assert time.monotonic() < end, log
            time.sleep(0.2)

    def _ready(self) -> bool:
        try:
            client.CoreV1Api(self.connect("administrator")).read_namespace("default", _request_timeout=2)
            client.RbacAuthorizationV1Api(self.connect("administrator")).read_cluster_role("cluster-admin")
        except Exception:
            return False
        return True

    def stop(self) -> None:
        """Killed: asked to end, the API server waits for its open watches."""
        for process in reversed(self.processes):
            process.kill()
            process.wait(10)

    def kubeconfig(self, user: str) -> Path:
        """A kubeconfig file of that user."""
        path = self.folder / f"{user}.kubeconfig"
        cluster = {"server": f"https://127.0.0.1:{self.port}", "insecure-skip-tls-verify": True}
        document = {
            "apiVersion": "v1",
            "kind": "Config",
            "clusters": [{"name": "test", "cluster": cluster}],
            "users": [{"name": user, "user": {"token": self.tokens[user]}}],
            "contexts": [{"name": "test", "context": {"cluster": "test", "user": user}}],
            "current-context": "test",
        }
        path.write_text(yaml.safe_dump(document))
        return path

    def connect(self, user: str) -> client.ApiClient:
        """A client as that user."""
        configuration = client.Configuration()
        configuration.host, configuration.verify_ssl = f"https://127.0.0.1:{self.port}", False
        configuration.api_key = {"authorization": f"Bearer {self.tokens[user]}"}
        return client.ApiClient(configuration)

    def install_argocd(self) -> None:
        """Namespace, the objects that Argo CD's manifests bring, and what argocd-server makes at its start."""
        api = self.connect("administrator")
        core = client.CoreV1Api(api)
        core.create_namespace({"metadata": {"name": NAMESPACE}})
        key = {"server.secretkey": base64.b64encode(b"x" * 32).decode()}
        core.create_namespaced_secret(NAMESPACE, {"metadata": {"name": "argocd-secret"}, "data": key})
        core.create_namespaced_config_map(NAMESPACE, {"metadata": {"name": "argocd-cm"}, "data": {"url": "http://x"}})
        core.create_namespaced_config_map(NAMESPACE, {"metadata": {"name": "argocd-rbac-cm"}})
        client.AppsV1Api(api).create_namespaced_deployment(NAMESPACE, deployment("argocd-applicationset-controller"))
        client.ApiextensionsV1Api(api).create_custom_resource_definition(project_definition())
        self._make_project(client.CustomObjectsApi(api))
        self._allow_bootstrap(client.RbacAuthorizationV1Api(api))

    def _make_project(self, objects: client.CustomObjectsApi) -> None:
        wide = {"sourceRepos": ["*"], "destinations": [{"server": "*", "namespace": "*"}]}
        rights = {"clusterResourceWhitelist": [{"group": "*", "kind": "*"}]}
        project = {"apiVersion": "argoproj.io/v1alpha1", "kind": "AppProject", "metadata": {"name": "default"}}
        end = time.monotonic() + START_SECONDS_MAX
        while True:
            try:
                objects.create_namespaced_custom_object(
                    "argoproj.io", "v1alpha1", NAMESPACE, "appprojects", {**project, "spec": {**wide, **rights}}
                )
                return
            except client.ApiException:  # the definition is not served yet
                assert time.monotonic() < end
                time.sleep(0.1)

    def _allow_bootstrap(self, rbac: client.RbacAuthorizationV1Api) -> None:
        text = ROLE.read_text()
        rules = yaml.safe_load(text[text.index("\nrules:") :])["rules"]
        rbac.create_namespaced_role(NAMESPACE, {"metadata": {"name": "robotkube-bootstrap"}, "rules": rules})
        reference = {"apiGroup": "rbac.authorization.k8s.io", "kind": "Role", "name": "robotkube-bootstrap"}
        subject = {"apiGroup": "rbac.authorization.k8s.io", "kind": "User", "name": "bootstrap"}
        binding = {"metadata": {"name": "robotkube-bootstrap"}, "roleRef": reference, "subjects": [subject]}
        rbac.create_namespaced_role_binding(NAMESPACE, binding)


def deployment(name: str) -> dict[str, Any]:
    labels = {"app": name}
    pod = {"metadata": {"labels": labels}, "spec": {"containers": [{"name": "main", "image": "x:1"}]}}
    return {"metadata": {"name": name}, "spec": {"selector": {"matchLabels": labels}, "template": pod}}


def project_definition() -> dict[str, Any]:
    """AppProject with an open schema: what the project says is Argo CD's business."""
    schema = {"type": "object", "x-kubernetes-preserve-unknown-fields": True}
    version = {"name": "v1alpha1", "served": True, "storage": True, "schema": {"openAPIV3Schema": schema}}
    names = {"kind": "AppProject", "plural": "appprojects", "singular": "appproject"}
    spec = {"group": "argoproj.io", "scope": "Namespaced", "names": names, "versions": [version]}
    return {"metadata": {"name": "appprojects.argoproj.io"}, "spec": spec}
