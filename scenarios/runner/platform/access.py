"""What the run needs of the cluster: secrets, addresses, one ConfigMap per vehicle, states to show, HTTP of pods.

Everything is done as the administrator of the kubeconfig; the platform's own accounts are read from their Secrets.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import urllib3
import yaml
from kubernetes import client, config
from kubernetes.client.exceptions import ApiException
from kubernetes.stream import stream

from ci.cluster_contract.provider import Reach, ServicePort, directly
from robotkube.foundation.certificates.adapters.account_files import REQUIRED, SERVER_NAME, TLS
from robotkube.foundation.certificates.adapters.certificate_authorities import trust_text
from robotkube.foundation.database.adapters.connection import DatabaseLogin, login_at
from robotkube.foundation.forge.adapters.relay import by_name
from robotkube.foundation.kubernetes.core.service_names import port_of, service_of
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount, read_broker_account
from scenarios.runner.waiting import RunError

PLATFORM, GATE, ARGOCD = "robotkube", "robotkube-gate", "argocd"  # of the platform, of its gate alone, of Argo CD
ANSWER_SECONDS_MAX = 10
CONFIGMAP = "simulation"
AUTHORITIES_MAP, DATABASE_ACCOUNT = "robotkube-ca", "database-account"
HEALTH_PORT = 8081
HTTPS = "https"  # the name of a Service's port that speaks it
APPLICATIONS = ("argoproj.io", "v1alpha1", ARGOCD, "applications")
TASKS = ("robotkube.io", "v1alpha1", "taskdescriptions")


@dataclass(frozen=True)
class Endpoint:
    """Address and port at which a Service answers from this machine; `encrypted`: by TLS."""

    host: str
    port: int
    encrypted: bool = False

    @property
    def url(self) -> str:
        """Its URL, where it speaks HTTP."""
        return f"{HTTPS if self.encrypted else 'http'}://{self.host}:{self.port}"


class Access:
    """One connection to the API server; its methods raise `RunError` with the server's message. `reach`: how this
    process gets to Services."""

    def __init__(self, kubeconfig: Path, reach: Reach = directly) -> None:
        if not kubeconfig.is_file():
            raise RunError(f"{kubeconfig}: there is no kubeconfig; start the cluster with `make cluster`")
        self.kubeconfig = kubeconfig
        self._reach = reach
        self._client = config.new_client_from_config(str(kubeconfig))
        self.core = client.CoreV1Api(self._client)
        self.objects = client.CustomObjectsApi(self._client)

    def disconnect(self) -> None:
        """Ends the connection."""
        self._client.close()

    def secret(self, namespace: str, name: str) -> dict[str, str]:
        """A Secret's values as text."""
        secret = self._call(self.core.read_namespaced_secret, f"secret {namespace}/{name}", name, namespace)
        return {key: base64.b64decode(value).decode() for key, value in (secret.data or {}).items()}

    def forge_account(self, name: str) -> tuple[str, str]:
        """Name and password of an account of the forge."""
        secret = self.secret(PLATFORM, f"forge-account-{name}")
        return secret["username"], secret["password"]

    def configmap(self, namespace: str, name: str) -> dict[str, str]:
        """A ConfigMap's values."""
        configmap = self._call(self.core.read_namespaced_config_map, f"configmap {namespace}/{name}", name, namespace)
        return dict(configmap.data or {})

    def endpoint(self, name: str, namespace: str = PLATFORM) -> Endpoint:
        """The endpoint at which the first port of a Service answers."""
        service, encrypted = self.service(name, namespace)
        return Endpoint(*self._reach(service), encrypted)

    def service(self, name: str, namespace: str = PLATFORM) -> tuple[ServicePort, bool]:
        """The first port of a Service, and whether it speaks HTTPS."""
        service = self._call(self.core.read_namespaced_service, f"service {namespace}/{name}", name, namespace)
        port = service.spec.ports[0]
        return ServicePort(namespace, name, service.spec.cluster_ip, port.port), port.name == HTTPS

    def forge_service(self) -> tuple[ServicePort | None, str]:
        """The forge's Service and URL, by the gate's settings; none where one of others stands elsewhere."""
        url = str(yaml.safe_load(self.configmap(GATE, "gate")["config.yaml"])["forge"]["url"])
        named = service_of(urlsplit(url).netloc)
        if named is None:
            return None, url
        namespace, name = named
        service, _ = self.service(name, namespace)
        return replace(service, port=port_of(url)), url

    def forge(self) -> Endpoint:
        """The platform's forge as this process reaches it; where it speaks TLS, its certificate is believed from then
        on if the platform's authority signed it."""
        service, url = self.forge_service()
        encrypted = url.startswith(f"{HTTPS}:")
        if service is None:
            return Endpoint(urlsplit(url).hostname or "", port_of(url), encrypted)
        endpoint = Endpoint(*self._reach(service), encrypted)
        if not encrypted or (service.namespace, service.name) != (PLATFORM, "forge"):
            return endpoint
        trust_text(self.configmap(PLATFORM, AUTHORITIES_MAP)["ca.crt"])
        reached = urlsplit(by_name(endpoint.url))
        return Endpoint(reached.hostname or "", reached.port or 0, encrypted=True)

    def broker_account(self, secret: str, folder: Path) -> BrokerAccount:
        """An account of the platform at the broker, and how that proves who it is; by files in `folder`, as a pod has
        them mounted. From this machine names of Services are not resolved: the address is the broker's, the name in its
        certificate that of the Secret."""
        values = self.secret(PLATFORM, secret)
        host, port = self._reached(values)
        folder.chmod(0o700)
        at = {"host": host, "port": str(port), SERVER_NAME: values["host"]}
        authorities = self._authorities(values)
        for name, text in {**values, **at, **authorities}.items():
            (folder / name).write_text(text)
        return read_broker_account(folder)

    def database_account(self, namespace: str, folder: Path) -> DatabaseLogin:
        """The account of a recording agent at the database, as above; `folder` gets the authorities alone."""
        values = self.secret(namespace, DATABASE_ACCOUNT)
        return login_at(self._reached(values), values, self._authorities(values).get("ca.crt", ""), folder)

    def _reached(self, account: Mapping[str, str]) -> tuple[str, int]:
        """Host and port at which this process reaches what an account is of: a Service of any namespace as all Services
        are, what stands outside of the cluster by its name."""
        host = account["host"]
        port = int(account["port"])
        named = service_of(host)
        if named is None:
            return host, port
        namespace, name = named
        service, _ = self.service(name, namespace)
        return self._reach(replace(service, port=port))

    def _authorities(self, account: Mapping[str, str]) -> Mapping[str, str]:
        """Who may have signed for what an account is of; empty where that speaks clear text."""
        return self.configmap(PLATFORM, AUTHORITIES_MAP) if account.get(TLS) == REQUIRED else {}

    def simulation(self, namespace: str) -> dict[str, str]:
        """What a vehicle's player was told to play; empty without an order."""
        listed = self.core.list_namespaced_config_map
        maps = self._call(listed, f"ConfigMaps of {namespace}", namespace, field_selector=f"metadata.name={CONFIGMAP}")
        return dict(maps.items[0].data or {}) if maps.items else {}

    def remove_simulation(self, namespace: str) -> None:
        """Takes a player's order back: it is silent from then on."""
        if self.simulation(namespace):
            delete = self.core.delete_namespaced_config_map
            self._call(delete, f"configmap {namespace}/{CONFIGMAP}", CONFIGMAP, namespace)

    def put_simulation(self, namespace: str, run: str, start: int, laps: int = 1, lap: int = 0) -> None:
        """Makes or replaces the ConfigMap that starts a vehicle's player. `start` in ns since 1970; with several `laps`
        one begins each `lap` ns."""
        driving = {"laps": str(laps), "lap": str(lap)} if laps > 1 else {}
        body = client.V1ConfigMap(
            metadata=client.V1ObjectMeta(name=CONFIGMAP, namespace=namespace),
            data={"run": run, "start": str(start), **driving},
        )
        try:
            self.core.replace_namespaced_config_map(CONFIGMAP, namespace, body, _request_timeout=ANSWER_SECONDS_MAX)
        except ApiException as error:
            if error.status != 404:
                raise RunError(f"configmap {namespace}/{CONFIGMAP}: {error.status} {error.reason}") from error
            self._call(self.core.create_namespaced_config_map, f"configmap {namespace}/{CONFIGMAP}", namespace, body)

    def pods(self, namespace: str) -> Sequence[Any]:
        """The pods of a namespace."""
        return list(self._call(self.core.list_namespaced_pod, f"pods of {namespace}", namespace).items)

    def pods_of_agents(self) -> Sequence[Any]:
        """The pods of all releases."""
        listed = self.core.list_pod_for_all_namespaces
        return list(self._call(listed, "pods of all agents", label_selector="robotkube.io/agent").items)

    def run_inside(self, namespace: str, pod: str, command: Sequence[str], seconds: float) -> str:
        """What a command in a pod's container prints, for at most so long. It has a connection of its own, since a
        stream changes what the others on its connection do."""
        own = config.new_client_from_config(str(self.kubeconfig))
        run = client.CoreV1Api(own).connect_get_namespaced_pod_exec
        options = {"command": list(command), "stdin": False, "stdout": True, "stderr": False, "tty": False}
        try:
            return str(stream(run, pod, namespace, _request_timeout=seconds, **options))
        except (ApiException, AttributeError, OSError) as error:
            refusal = error.__context__ if isinstance(error, AttributeError) else error  # it reads a body that is None
            raise RunError(f"pod {namespace}/{pod}: {command[0]} cannot be run in it: {refusal}") from error
        finally:
            own.close()

    def delete_pod(self, namespace: str, name: str) -> None:
        """Ends a pod; its Deployment makes another one."""
        self._call(self.core.delete_namespaced_pod, f"pod {namespace}/{name}", name, namespace)

    def applications(self) -> Mapping[str, Any]:
        """Argo CD's Applications by name."""
        applications = self._call(self.objects.list_namespaced_custom_object, "Argo CD Applications", *APPLICATIONS)
        return {item["metadata"]["name"]: item for item in applications["items"]}

    def pod_json(self, namespace: str, pod: str, path: str, port: int = HEALTH_PORT) -> Any:
        """GET of a pod's HTTP port through the API server."""
        return self._proxied(f"/api/v1/namespaces/{namespace}/pods/{pod}:{port}/proxy/{path}")

    def service_json(self, name: str, path: str, port: int, namespace: str = PLATFORM) -> Any:
        """GET of a Service's only port, by HTTP or HTTPS as it is named, through the API server."""
        scheme = "https:" if self.endpoint(name, namespace).encrypted else ""
        return self._proxied(f"/api/v1/namespaces/{namespace}/services/{scheme}{name}:{port}/proxy/{path}")

    def state(self, namespaces: Sequence[str]) -> str:
        """Pods that are not ready and tasks with their conditions, for people; never fails, since it explains
        failures."""
        lines = []
        try:
            lines += [line for namespace in namespaces for line in self._pod_lines(namespace)]
            lines += [_task_line(task) for task in self.tasks()]
        except RunError as error:
            lines.append(f"(the rest of the state cannot be read: {error})")
        return "\n".join(lines) or "all pods are ready and there is no task"

    def tasks(self) -> Sequence[Any]:
        """All tasks."""
        return list(self._call(self.objects.list_cluster_custom_object, "tasks", *TASKS)["items"])

    def tasks_of_rule(self, rule: str) -> Sequence[str]:
        """Namespace and name of each task that an event of the rule asks for; none without a rule."""
        return ["/".join(_key(task)) for task in self.tasks() if rule and task["spec"]["event"]["rule"] == rule]

    def task(self, namespace: str, name: str) -> Any:
        """A task, or None."""
        return next((task for task in self.tasks() if _key(task) == (namespace, name)), None)

    def create_task(self, body: Mapping[str, Any]) -> None:
        """Submits a task."""
        group, version, plural = TASKS
        namespace = body["metadata"]["namespace"]
        create = self.objects.create_namespaced_custom_object
        self._call(create, f"task {namespace}/{body['metadata']['name']}", group, version, namespace, plural, body)

    def delete_task(self, namespace: str, name: str) -> None:
        """Withdraws a task; one that is not there is fine."""
        group, version, plural = TASKS
        if self.task(namespace, name) is not None:
            delete = self.objects.delete_namespaced_custom_object
            self._call(delete, f"task {namespace}/{name}", group, version, namespace, plural, name)

    def kill(self, component: str) -> None:
        """Ends the pods of a part of the platform at once, as a crash would; its Deployment makes others."""
        for namespace in (PLATFORM, GATE):
            for pod in self.pods(namespace):
                if (pod.metadata.labels or {}).get("app.kubernetes.io/name") == component:
                    name = pod.metadata.name
                    delete = self.core.delete_namespaced_pod
                    self._call(delete, f"pod {namespace}/{name}", name, namespace, grace_period_seconds=0)

    def set_schedulable(self, node: str, schedulable: bool) -> None:
        """Cordons a node, or takes that back."""
        self._call(self.core.patch_node, f"node {node}", node, {"spec": {"unschedulable": not schedulable}})

    def _pod_lines(self, namespace: str) -> list[str]:
        return [
            f"pod {namespace}/{pod.metadata.name}: {pod.status.phase}, {_waiting(pod)}"
            for pod in self.pods(namespace)
            if not pod_ready(pod)
        ]

    def _proxied(self, path: str) -> Any:
        answer = self._call(
            self._client.call_api,
            f"GET {path}",
            path,
            "GET",
            auth_settings=["BearerToken"],
            _preload_content=False,
            _return_http_data_only=True,
        )
        try:
            return json.loads(answer.data)
        except ValueError as error:
            raise RunError(f"GET {path}: the answer is not JSON: {bytes(answer.data[:200])!r}") from error

    def _call(self, function: Any, what: str, *arguments: Any, **options: Any) -> Any:
        try:
            return function(*arguments, _request_timeout=ANSWER_SECONDS_MAX, **options)
        except ApiException as error:
            raise RunError(f"{what}: {error.status} {error.reason}: {str(error.body)[:300]}") from error
        except (OSError, urllib3.exceptions.HTTPError) as error:
            raise RunError(f"{what}: the API server does not answer: {error}") from error


def _key(task: Mapping[str, Any]) -> tuple[str, str]:
    return task["metadata"]["namespace"], task["metadata"]["name"]


def _task_line(task: Mapping[str, Any]) -> str:
    conditions = task.get("status", {}).get("conditions", [])
    summary = " ".join(f"{c['type']}={c['status']}({c.get('reason', '')})" for c in conditions)
    return f"task {task['metadata']['namespace']}/{task['metadata']['name']}: {summary or 'no status'}"


def pod_ready(pod: Any) -> bool:
    """Return whether a pod's condition Ready is true; a pod that has succeeded counts as well."""
    conditions = pod.status.conditions or []
    return pod.status.phase == "Succeeded" or any(c.type == "Ready" and c.status == "True" for c in conditions)


def _waiting(pod: Any) -> str:
    """Why a pod's containers wait, or how they ended."""
    words = []
    for status in pod.status.container_statuses or []:
        state, last = status.state, status.last_state
        if state and state.waiting:
            words.append(f"{state.waiting.reason}: {(state.waiting.message or '')[:200]}")
        if last and last.terminated:
            words.append(f"ended with {last.terminated.exit_code} ({last.terminated.reason})")
    unscheduled = [c.message for c in pod.status.conditions or [] if c.type == "PodScheduled" and c.status != "True"]
    return "; ".join([*words, *(text for text in unscheduled if text)]) or "not ready yet"
