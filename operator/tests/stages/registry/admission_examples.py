"""Objects that admission judges: as releases have them, to be changed by each test."""

from __future__ import annotations

import copy
from typing import Any

from robotkube.registry.admission.core.allowed import Allowed
from robotkube.registry.admission.core.domain import Domain, account

Object = dict[str, Any]
CHARTS = "oci://forge.robotkube.svc.cluster.local:3000/verified"
DOMAIN = Domain(("vehicle-00", "cloud-0"), ("robotkube-suite-0",), CHARTS, elsewhere=True, volumes="/cluster/volumes")


def digest(number: int) -> str:
    return f"sha256:{number:064x}"


def image(number: int, repository: str = "registry.example/robotkube/ros") -> str:
    return f"{repository}@{digest(number)}"


VERIFIED, OF_THE_PLATFORM, STRANGE = image(1), image(2), image(3)
CHART = digest(9)
ALLOWED = Allowed((digest(1), digest(11)), (digest(2),), (f"event-detector@{CHART}",))
APPLICATION_CONTROLLER, GENERATOR = DOMAIN.application_controller, DOMAIN.generator
SERVER = account("argocd", "argocd-server")
SUITE_RUNNER = DOMAIN.suite_runner
REPLICA_SETS = account("kube-system", "replicaset-controller")
DEPLOYMENTS = account("kube-system", "deployment-controller")
CRON_JOBS = account("kube-system", "cronjob-controller")
LABELS = {"app": "detector"}


def pod_spec(reference: str = VERIFIED, **more: Any) -> Object:
    return {"containers": [{"name": "main", "image": reference}], **more}


def pod(reference: str = VERIFIED, name: str = "pod", **more: Any) -> Object:
    metadata = {"name": name, "labels": LABELS}
    return {"apiVersion": "v1", "kind": "Pod", "metadata": metadata, "spec": pod_spec(reference, **more)}


def template(reference: str, restart: str = "Always") -> Object:
    return {"metadata": {"labels": LABELS}, "spec": pod_spec(reference, restartPolicy=restart)}


def workload(kind: str, reference: str = VERIFIED, name: str = "detector") -> Object:
    """An object of a kind that holds a template of pods."""
    selected = {"selector": {"matchLabels": LABELS}, "template": template(reference)}
    once = {"template": template(reference, "Never")}
    specs: dict[str, Object] = {
        "Deployment": selected,
        "ReplicaSet": selected,
        "DaemonSet": selected,
        "StatefulSet": {**selected, "serviceName": "detector"},
        "ReplicationController": {"selector": LABELS, "template": template(reference)},
        "Job": once,
        "CronJob": {"schedule": "0 0 * * *", "jobTemplate": {"spec": once}},
    }
    head = {"apiVersion": KINDS[kind][0], "kind": kind, "metadata": {"name": name}}
    if kind == "PodTemplate":
        return {**head, "template": template(reference)}
    return {**head, "spec": specs[kind]}


KINDS = {
    "Deployment": ("apps/v1", "deployments", APPLICATION_CONTROLLER),
    "ReplicaSet": ("apps/v1", "replicasets", DEPLOYMENTS),
    "StatefulSet": ("apps/v1", "statefulsets", APPLICATION_CONTROLLER),
    "DaemonSet": ("apps/v1", "daemonsets", APPLICATION_CONTROLLER),
    "Job": ("batch/v1", "jobs", CRON_JOBS),
    "CronJob": ("batch/v1", "cronjobs", APPLICATION_CONTROLLER),
    "ReplicationController": ("v1", "replicationcontrollers", APPLICATION_CONTROLLER),
    "PodTemplate": ("v1", "podtemplates", APPLICATION_CONTROLLER),
}
"""Kind -> its API, its resource, and who makes it in an agent's namespace."""


def path(kind: str, namespace: str) -> str:
    """Where objects of a kind are created."""
    api, resource = ("v1", "pods") if kind == "Pod" else KINDS[kind][:2]
    root = "/api/v1" if api == "v1" else f"/apis/{api}"
    return f"{root}/namespaces/{namespace}/{resource}"


def application(name: str = "vehicle-00-detector", **spec: Any) -> Object:
    """An Application as the ApplicationSet of charts/robotkube makes it; `spec` replaces keys."""
    source = {
        "repoURL": f"{CHARTS}/event-detector",
        "path": ".",
        "targetRevision": CHART,
        "helm": {
            "releaseName": "detector",
            "values": '{"placement":{"agent":"vehicle-00"}}',
            "parameters": [{"name": "global.plan", "value": "20261124-100000-abcdef", "forceString": True}],
        },
    }
    whole = {
        "project": "robotkube-apps",
        "revisionHistoryLimit": 0,
        "source": source,
        "destination": {"server": "https://kubernetes.default.svc", "namespace": "vehicle-00"},
        "syncPolicy": {
            "automated": {"prune": True, "selfHeal": True},
            "syncOptions": ["ApplyOutOfSyncOnly=true"],
            "retry": {"limit": 2, "backoff": {"duration": "1s", "factor": 2, "maxDuration": "2s"}},
        },
    }
    metadata = {"name": name, "namespace": "argocd"}
    document = {"apiVersion": "argoproj.io/v1alpha1", "kind": "Application", "metadata": metadata}
    return copy.deepcopy({**document, "spec": {**whole, **spec}})


APPLICATIONS = "/apis/argoproj.io/v1alpha1/namespaces/argocd/applications"
PROJECTS = "/apis/argoproj.io/v1alpha1/namespaces/argocd/appprojects"
