"""Access of the command line to a platform: the API server, and by its service proxy the manager's pages."""

from __future__ import annotations

import argparse
import base64
import contextlib
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from robotkube.cli.gate_presence import GATE, GatePresence, presence
from robotkube.cli.inspections import INSPECTOR
from robotkube.delivery.inspection.core.strangers import PLURAL as INSPECTIONS
from robotkube.delivery.tasks.adapters.kubernetes_tasks import KubernetesTasks
from robotkube.delivery.tasks.core.task_description import GROUP, PLURAL, VERSION
from robotkube.errors import InputError, RefusalError, UnavailableError
from robotkube.foundation.certificates.adapters.certificate_authorities import trust_text
from robotkube.foundation.documents.core.json_codec import read_json_shortened
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.foundation.forge.adapters.relay import by_name
from robotkube.foundation.kubernetes.adapters import client
from robotkube.foundation.kubernetes.core.service_names import port_of, service_of

OBJECTS_MAX = 5000
PAGE_OBJECTS = 500
PAGES_MAX = 200
FORGE = "forge"  # its Service
ENCRYPTED = "https"  # the name of a Service's port that speaks TLS
EVIDENCE_KEYS = "evidence-keys"
MADE_KEYS = "robotkube.io/made-keys"  # its annotation with the ConfigMap of keys that were made in the cluster
IMAGES = "platform-images"
SUITE_RUNNER = "suite-runner"
SETTINGS_KEY = "config.yaml"
RIGHTS = "rights"
CERTIFICATES = "broker-certificates"
IMAGES_KEY, SERVICES_KEY = "images.yaml", "services.yaml"
DATABASE_ACCOUNT = "database-account"
AUTHORITIES = "robotkube-ca"
AGENT_LABEL = "robotkube.io/agent"
GATE_SELECTOR = "app.kubernetes.io/part-of=robotkube,app.kubernetes.io/component=gate"
DETECTOR_SELECTOR = "app.kubernetes.io/name=event-detector"


class Platform:
    """One platform, named by the options of the command line."""

    def __init__(self, options: argparse.Namespace) -> None:
        self._api = client.api_client(options.kubeconfig, options.context)
        self._namespace = options.platform_namespace
        self._argocd = options.argocd_namespace
        self._manager = options.manager

    def tasks(self, namespace: str = "") -> Sequence[Mapping[str, Any]]:
        """The TaskDescriptions of one or all namespaces."""
        scope = f"/namespaces/{namespace}" if namespace else ""
        return self._items(f"/apis/{GROUP}/{VERSION}{scope}/{PLURAL}")

    def task(self, key: str) -> Mapping[str, Any]:
        """One task by `<namespace>/<name>`; RefusalError when there is none."""
        return self._one("GET", key)

    def task_writer(self, dry_run: bool = False) -> KubernetesTasks:
        """A writer of tasks; with `dry_run` the API server only checks each write."""
        return KubernetesTasks(self.call, dry_run)

    def watch_tasks(self, changed: Callable[[str, Any, Any], None], namespace: str = "") -> client.ResourceWatch:
        """A watch on the tasks of one or all namespaces: `changed` gets key, object before and now (None: not
        there)."""
        scope = f"/namespaces/{namespace}" if namespace else ""
        return client.ResourceWatch(self._api, f"/apis/{GROUP}/{VERSION}{scope}/{PLURAL}", "", dict, changed)

    def watch_of_agents(
        self, kind: str, reduce: Callable[[Mapping[str, Any]], Any], changed: Callable[[str, Any, Any], None]
    ) -> client.ResourceWatch:
        """A watch on what agents have of a kind (`pods`, `nodes`), each reduced by `reduce`."""
        return client.ResourceWatch(self._api, f"/api/v1/{kind}", AGENT_LABEL, reduce, changed)

    def pods(self) -> Sequence[Mapping[str, Any]]:
        """The pods of agents' releases."""
        return self._items("/api/v1/pods", [("labelSelector", AGENT_LABEL)])

    def volumes(self) -> Sequence[Mapping[str, Any]]:
        """The cluster's PersistentVolumes."""
        return self._items("/api/v1/persistentvolumes")

    def detector_events(self) -> Mapping[str, Mapping[str, Any]]:
        """The pages `/events` of the event detectors that answer, by `<namespace>/<pod>`."""
        return {name: read_json_shortened(page) for name, page in self._detector_pages("events")}

    def detector_metrics(self) -> Mapping[str, str]:
        """The pages `/metrics` of the event detectors that answer, by `<namespace>/<pod>`."""
        return {name: page.decode() for name, page in self._detector_pages("metrics")}

    def _detector_pages(self, path: str) -> Iterator[tuple[str, bytes]]:
        for pod in self._items("/api/v1/pods", [("labelSelector", DETECTOR_SELECTOR)]):
            namespace, name = pod["metadata"]["namespace"], pod["metadata"]["name"]
            with contextlib.suppress(KeyError, RefusalError, UnavailableError):
                page = f"/api/v1/namespaces/{namespace}/pods/{name}:8081/proxy/{path}"
                yield f"{namespace}/{name}", client.call(self._api, "GET", page).data

    def withdraw(self, key: str, dry_run: bool) -> None:
        """Delete a task."""
        self._one("DELETE", key, [("dryRun", "All")] if dry_run else [])

    def applications(self) -> Sequence[Mapping[str, Any]]:
        """The Argo CD Applications."""
        return self._items(f"/apis/argoproj.io/v1alpha1/namespaces/{self._argocd}/applications")

    def inspections(self) -> Sequence[Mapping[str, Any]]:
        """The Inspections; none where the platform has no definition of them."""
        try:
            return self._items(f"/apis/{GROUP}/{VERSION}/namespaces/{self._namespace}/{INSPECTIONS}")
        except InputError:
            return ()

    def inspector(self) -> Mapping[str, Any] | None:
        """The Deployment of who writes the Inspections, empty when there is none; None when that may not be read."""
        try:
            return self._deployment(self._namespace, INSPECTOR)
        except InputError:
            return None

    def gate(self) -> GatePresence:
        """Return whether the gate is there."""
        try:
            namespace = self.gate_namespace()
            return presence(namespace, self._deployment(namespace, GATE))
        except InputError as error:
            return GatePresence(unknown=str(error))

    def _deployment(self, namespace: str, name: str) -> Mapping[str, Any]:
        """A Deployment, empty when there is none; InputError when it may not be read."""
        try:
            return self._read("GET", f"/apis/apps/v1/namespaces/{namespace}/deployments/{name}")
        except KeyError:
            return {}

    def versions(self) -> Mapping[str, str]:
        """The versions of what is reached, by program: the cluster, the platform's chart, the manager's image."""
        cluster = {"kubernetes": str(self._read("GET", "/version")["gitVersion"])}
        manager = self._deployment(self._namespace, self._manager)
        if not manager:
            raise InputError(f"no Deployment {self._manager} in namespace {self._namespace}; see --platform-namespace")
        labels = manager["metadata"].get("labels", {})
        images = [container["image"] for container in manager["spec"]["template"]["spec"]["containers"]]
        return cluster | {"platform": labels.get("helm.sh/chart", "unknown"), "manager": ", ".join(images)}

    def page(self, path: str) -> Mapping[str, Any]:
        """A JSON page of the manager."""
        return self._of_manager("GET", path)

    def explain(self, question: Mapping[str, Any]) -> Mapping[str, Any]:
        """The manager's explanation of what would become of a task."""
        return self._of_manager("POST", "/explain", question)

    def _of_manager(self, method: str, path: str, body: Any = None) -> Mapping[str, Any]:
        service = f"{self._manager_scheme}{self._manager}:8080"
        where = f"/api/v1/namespaces/{self._namespace}/services/{service}/proxy{path}"
        try:
            return self._read(method, where, body=body)
        except KeyError as error:
            missing = f"no Service {self._manager} in namespace {self._namespace}; see --platform-namespace"
            raise InputError(f"{missing} and --manager") from error

    @functools.cached_property
    def _manager_scheme(self) -> str:
        """What the API server's proxy has before the name of a Service that speaks TLS; empty also where the Service
        may not be read."""
        try:
            encrypted = self._service(self._manager)["ports"][0].get("name") == ENCRYPTED
        except InputError:
            return ""
        return "https:" if encrypted else ""

    def database_accounts(self, agent: str = "") -> Mapping[str, Mapping[str, str]]:
        """The values of the Secrets `database-account`, by agent that records; InputError when there is none."""
        query = [("fieldSelector", f"metadata.name={DATABASE_ACCOUNT}"), ("labelSelector", AGENT_LABEL)]
        accounts = {item["metadata"]["namespace"]: _texts(item) for item in self._items("/api/v1/secrets", query)}
        if agent:
            accounts = {name: values for name, values in accounts.items() if name == agent}
        if not accounts:
            raise InputError(f"no Secret {DATABASE_ACCOUNT} of {agent or 'any agent'}; does it have `records: true`?")
        return accounts

    def authorities(self) -> str:
        """Who may have signed the certificates of the platform's servers, as PEM; empty when there is none."""
        return str((self._config_map(AUTHORITIES).get("data") or {}).get("ca.crt", ""))

    def settings(self, process: str) -> Mapping[str, Any]:
        """The settings document of one of the platform's processes; empty when there is none."""
        data = self._config_map(process).get("data") or {}
        return read_mapping(data.get(SETTINGS_KEY, "{}"), f"configmap {self._namespace}/{process}")

    def address(self, service: str) -> tuple[str, int]:
        """The ClusterIP and the first port of one of the platform's Services."""
        spec = self._service(service)
        return str(spec["clusterIP"]), int(spec["ports"][0]["port"])

    def address_of(self, account: Mapping[str, str]) -> tuple[str, int]:
        """The host and port at which the server of an account is reached from here, by `host` and `port` of its Secret:
        a Service of this cluster at its ClusterIP, since pods alone resolve its name; one elsewhere at its name."""
        host = account["host"]
        port = int(account["port"])
        service = service_of(host)
        return (str(self._service(service[1], service[0])["clusterIP"]) if service else host), port

    def _service(self, service: str, namespace: str = "") -> Mapping[str, Any]:
        place = namespace or self._namespace
        try:
            document = self._read("GET", f"/api/v1/namespaces/{place}/services/{service}")
        except KeyError as error:
            hint = "" if namespace else "; see --platform-namespace"
            raise InputError(f"no Service {service} in namespace {place}{hint}") from error
        spec: Mapping[str, Any] = document["spec"]
        return spec

    def forge_account(self, account: str) -> tuple[str, str, str]:
        """The URL by which this process reaches the platform's forge, with username and password of one of its
        accounts."""
        url = self.forge_url()
        try:
            secret = self._read("GET", f"/api/v1/namespaces/{self._namespace}/secrets/forge-account-{account}")
        except KeyError as error:
            raise InputError(
                f"no Secret forge-account-{account} in namespace {self._namespace}; for a forge outside the cluster "
                "give --forge-url and --password-file"
            ) from error
        values = _texts(secret)
        named = url.startswith("https:") and not self._forge_of_others()  # that has a certificate for localhost, too
        return (by_name(url) if named else url), values["username"], values["password"]

    def forge_url(self) -> str:
        """The URL of the platform's forge at its Service's address, as browsers reach it. Where that speaks TLS, this
        process believes its certificate from then on, if the platform's authority signed it. One of others is where the
        manager's settings say, a Service of this cluster at its address."""
        if url := self._forge_of_others():
            service = service_of(urlsplit(url).netloc)
            if service is None:
                return url
            return f"{urlsplit(url).scheme}://{self._service(service[1], service[0])['clusterIP']}:{port_of(url)}"
        spec = self._service(FORGE)
        encrypted = spec["ports"][0].get("name") == ENCRYPTED
        if encrypted:
            trust_text(self.authorities())
        return f"{'https' if encrypted else 'http'}://{spec['clusterIP']}:{spec['ports'][0]['port']}"

    def _forge_of_others(self) -> str:
        """The URL of a forge that is not the platform's own; empty where that has one, and where the manager's settings
        may not be read."""
        try:
            url = str((self.settings(self._manager).get("forge") or {}).get("url") or "")
        except InputError:
            return ""
        return url if url and service_of(urlsplit(url).netloc) != (self._namespace, FORGE) else ""

    def forge_secret(self, account: str) -> str:
        """How kubectl gets the Secret of one of the forge's accounts; empty when there is none, or when it may not be
        read."""
        name = f"forge-account-{account}"
        try:
            self._read("GET", f"/api/v1/namespaces/{self._namespace}/secrets/{name}")
        except (InputError, KeyError):
            return ""
        return f"-n {self._namespace} get secret {name}"

    def evidence_keys(self) -> Mapping[str, str]:
        """The public keys that this installation trusts, as PEM texts by file name; InputError when it names none."""
        given = self._config_map(EVIDENCE_KEYS)
        keys: dict[str, str] = dict(given.get("data") or {})
        made = (given.get("metadata", {}).get("annotations") or {}).get(MADE_KEYS)
        if made:
            keys |= self._config_map(made).get("data") or {}
        if not keys:
            what = f"no public key in ConfigMap {EVIDENCE_KEYS}{f' or {made}' if made else ''}"
            raise InputError(f"{what} of namespace {self._namespace}; give --keys FOLDER")
        return keys

    def images(self) -> Mapping[str, str]:
        """The references by digest of the platform's images, by name."""
        return self._images(IMAGES_KEY)

    def service_images(self) -> Mapping[str, str]:
        """The references by digest of the images of application services, by name."""
        return self._images(SERVICES_KEY)

    def suite_runner(self) -> Mapping[str, Any]:
        """The settings document of the suite-runner; empty when there is none."""
        return self.settings(SUITE_RUNNER)

    @property
    def call(self) -> Callable[..., Any]:
        """Requests to the API server by the account of the kubeconfig, as those of `client.call`."""
        return functools.partial(client.call, self._api)

    def _images(self, key: str) -> Mapping[str, str]:
        data = self._config_map(IMAGES).get("data") or {}
        return read_mapping(data.get(key, "{}"), f"configmap {self._namespace}/{IMAGES}, {key}")

    def _config_map(self, name: str) -> Mapping[str, Any]:
        """A ConfigMap of the platform's namespace; empty when there is none."""
        try:
            return self._read("GET", f"/api/v1/namespaces/{self._namespace}/configmaps/{name}")
        except KeyError:
            return {}

    def rights_settings(self) -> str:
        """The settings of the process that keeps the broker's rights; InputError when there is none."""
        text = str((self._config_map(RIGHTS).get("data") or {}).get("config.yaml") or "")
        if not text:
            raise InputError(
                f"no ConfigMap {RIGHTS} in namespace {self._namespace}; see --platform-namespace. Rights at a broker "
                "of your own are its owner's"
            )
        return text

    def certificate_register(self) -> str:
        """The register of certificates that were issued to accounts at the broker; empty where they have none."""
        return str((self._config_map(CERTIFICATES).get("data") or {}).get("register.json") or "")

    def api_server(self) -> tuple[str, str]:
        """The API server's address and the PEM of the authority that the kubeconfig verifies it by, empty when it names
        none."""
        configuration = self._api.configuration
        authority = configuration.ssl_ca_cert
        return str(configuration.host), Path(authority).read_text(encoding="utf-8") if authority else ""

    def agent_nodes(self) -> Sequence[Mapping[str, Any]]:
        """The Nodes of agents."""
        return self._items("/api/v1/nodes", [("labelSelector", AGENT_LABEL)])

    def node_leases(self) -> Sequence[Mapping[str, Any]]:
        """The leases that Nodes renew; none when they may not be read."""
        try:
            return self._items("/apis/coordination.k8s.io/v1/namespaces/kube-node-lease/leases")
        except InputError:
            return ()

    def agents(self) -> Sequence[str]:
        """The namespaces of declared agents."""
        return [
            item["metadata"]["name"] for item in self._items("/api/v1/namespaces", [("labelSelector", AGENT_LABEL)])
        ]

    def gate_namespace(self) -> str:
        """The namespace in which the gate stands alone: the one of the usual name, else the one that says so."""
        usual = f"{self._namespace}-gate"
        labelled = self._items("/api/v1/namespaces", [("labelSelector", GATE_SELECTOR)])
        named = [item["metadata"]["name"] for item in labelled]
        return usual if usual in named or not named else named[0]

    def namespaces(self) -> Sequence[str]:
        """All namespaces of the cluster."""
        return [item["metadata"]["name"] for item in self._items("/api/v1/namespaces")]

    def project(self, name: str) -> Mapping[str, Any]:
        """An AppProject of Argo CD; InputError when there is none."""
        where = f"/apis/argoproj.io/v1alpha1/namespaces/{self._argocd}/appprojects/{name}"
        try:
            return self._read("GET", where)
        except KeyError as error:
            raise InputError(f"no AppProject {name} in namespace {self._argocd}; see --argocd-namespace") from error

    def everything(self, path: str) -> Iterator[Mapping[str, Any]]:
        """All objects of a kind, page after page; InputError when the cluster does not know the kind, or has more than
        are asked for."""
        token = ""
        for _ in range(PAGES_MAX):
            query = [("limit", str(PAGE_OBJECTS)), ("continue", token)]
            try:
                page = self._read("GET", path, query)
            except KeyError as error:
                raise InputError(f"the cluster has no {path}; is the platform installed?") from error
            yield from page["items"]
            token = page["metadata"].get("continue", "")
            if not token:
                return
        raise InputError(f"the cluster has more than {PAGES_MAX * PAGE_OBJECTS} {path}; remove old ones")

    def _one(self, method: str, key: str, query: Sequence[tuple[str, str]] = ()) -> Mapping[str, Any]:
        namespace, separator, name = key.partition("/")
        if not separator or not namespace or not name or "/" in name:
            raise InputError(f"task {key!r} must be <namespace>/<name>, as `robotkube task list` prints it")
        try:
            return self._read(method, f"/apis/{GROUP}/{VERSION}/namespaces/{namespace}/{PLURAL}/{name}", query)
        except KeyError as error:
            raise RefusalError("UnknownTask", f"there is no task {key}") from error

    def _items(self, path: str, query: Sequence[tuple[str, str]] = ()) -> Sequence[Mapping[str, Any]]:
        try:
            items: Sequence[Mapping[str, Any]] = self._read("GET", path, [("limit", str(OBJECTS_MAX)), *query])["items"]
        except KeyError as error:
            raise InputError(f"the cluster has no {path}; is the platform installed?") from error
        return items

    def _read(
        self, method: str, path: str, query: Sequence[tuple[str, str]] = (), body: Any = None
    ) -> Mapping[str, Any]:
        answer: Mapping[str, Any] = read_json_shortened(client.call(self._api, method, path, query, body).data)
        return answer


def _texts(secret: Mapping[str, Any]) -> Mapping[str, str]:
    return {key: base64.b64decode(value).decode() for key, value in (secret.get("data") or {}).items()}
