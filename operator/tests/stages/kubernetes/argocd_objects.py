"""Argo CD's objects on an API server without nodes, as they are before us; the bootstrap Job's account and Role."""

import base64
import time
from pathlib import Path
from typing import Any

import yaml
from kubernetes import client, config

from ci.folders import PROJECT
from tests.stages.kubernetes import argocd_definitions
from tests.stages.kubernetes.api_server import ApiServerProcess

SERVED_SECONDS_MAX = 30.0
ROLE = PROJECT / "charts" / "robotkube" / "templates" / "bootstrap" / "role.yaml"
NAMESPACE = "argocd"


def connect(server: ApiServerProcess) -> client.ApiClient:
    """A client of the administrator."""
    return config.new_client_from_config(str(server.kubeconfig))


def install_argocd(server: ApiServerProcess) -> None:
    """Namespace, the objects that Argo CD's manifests bring, and what argocd-server makes at its start."""
    api = connect(server)
    define_argocd(api)
    make_argocd(api)


def define_argocd(api: client.ApiClient) -> None:
    """Namespace, and the kind of projects."""
    client.CoreV1Api(api).create_namespace({"metadata": {"name": NAMESPACE}})
    definition = argocd_definitions.short("appprojects")
    client.ApiextensionsV1Api(api).create_custom_resource_definition(definition)


def make_argocd(api: client.ApiClient) -> None:
    """What stands in the namespace."""
    core = client.CoreV1Api(api)
    key = {"server.secretkey": base64.b64encode(b"x" * 32).decode()}
    core.create_namespaced_secret(NAMESPACE, {"metadata": {"name": "argocd-secret"}, "data": key})
    core.create_namespaced_config_map(NAMESPACE, {"metadata": {"name": "argocd-cm"}, "data": {"url": "http://x"}})
    for name in ("argocd-rbac-cm", "argocd-tls-certs-cm"):
        core.create_namespaced_config_map(NAMESPACE, {"metadata": {"name": name}})
    for name in ("argocd-server", "argocd-applicationset-controller", "argocd-repo-server"):
        client.AppsV1Api(api).create_namespaced_deployment(NAMESPACE, deployment(name))
    make_project(client.CustomObjectsApi(api))


def remove_argocd(api: client.ApiClient) -> None:
    """What stands in the namespace, whoever made it."""
    core = client.CoreV1Api(api)
    objects = client.CustomObjectsApi(api)
    objects.delete_collection_namespaced_custom_object("argoproj.io", "v1alpha1", NAMESPACE, "appprojects")
    client.AppsV1Api(api).delete_collection_namespaced_deployment(NAMESPACE)
    core.delete_collection_namespaced_secret(NAMESPACE)
    core.delete_collection_namespaced_config_map(NAMESPACE)


def make_project(objects: client.CustomObjectsApi) -> None:
    """AppProject `default`, which allows everything."""
    spec = {
        "sourceRepos": ["*"],
        "destinations": [{"server": "*", "namespace": "*"}],
        "clusterResourceWhitelist": [{"group": "*", "kind": "*"}],
    }
    project = {
        "apiVersion": "argoproj.io/v1alpha1",
        "kind": "AppProject",
        "metadata": {"name": "default"},
        "spec": spec,
    }
    end = time.monotonic() + SERVED_SECONDS_MAX
    while True:
        try:
            objects.create_namespaced_custom_object("argoproj.io", "v1alpha1", NAMESPACE, "appprojects", project)
            return
        except client.ApiException:  # the definition is not served yet
            assert time.monotonic() < end, "AppProject is not served"
            time.sleep(0.1)


def bootstrap_kubeconfig(server: ApiServerProcess, folder: Path) -> Path:
    """A kubeconfig of ServiceAccount `bootstrap` with the rules of the platform chart's Role, with TLS at the forge."""
    api = connect(server)
    lines = ROLE.read_text().splitlines(keepends=True)
    text = "".join(line for line in lines if "{{" not in line)
    core = client.CoreV1Api(api)
    rbac = client.RbacAuthorizationV1Api(api)
    account, role = {"metadata": {"name": "bootstrap"}}, {"metadata": {"name": "robotkube-bootstrap"}}
    rules = yaml.safe_load(text[text.index("\nrules:") :])["rules"]
    core.create_namespaced_service_account(NAMESPACE, account)
    rbac.create_namespaced_role(NAMESPACE, {**role, "rules": rules})
    reference = {"apiGroup": "rbac.authorization.k8s.io", "kind": "Role", "name": "robotkube-bootstrap"}
    subject = {"kind": "ServiceAccount", "name": "bootstrap", "namespace": NAMESPACE}
    rbac.create_namespaced_role_binding(NAMESPACE, {**role, "roleRef": reference, "subjects": [subject]})
    issued = core.create_namespaced_service_account_token("bootstrap", NAMESPACE, {"spec": {}})
    document = yaml.safe_load(server.kubeconfig.read_text())
    document["users"][0]["user"] = {"token": issued.status.token}
    path = folder / "bootstrap.kubeconfig"
    path.write_text(yaml.safe_dump(document))
    return path


def deployment(name: str) -> dict[str, Any]:
    labels = {"app": name}
    pod = {"metadata": {"labels": labels}, "spec": {"containers": [{"name": "main", "image": "x:1"}]}}
    return {"metadata": {"name": name}, "spec": {"selector": {"matchLabels": labels}, "template": pod}}
