"""Installs the platform on a running cluster, as a person would: Argo CD from its own manifests, then `helm
install robotkube`.

Nothing here knows how the cluster was made. Every wait has a bound; a wait that runs out says which object it
waited for and shows the events and the last log lines of its pods.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

from ci import evidence, given_argocd, toolchain
from ci.client_certificates import client_certificate
from ci.cluster_contract.provider import ChartProfile, ServicePort
from ci.cluster_contract.topology import Topology, chart_agents
from ci.errors import SetUpError
from ci.folders import PROJECT
from ci.images.services import SERVICE_NAMES
from gitops.argocd import render
from robotkube.cli.live.component_lines import InstallationWatch
from robotkube.delivery.preflight.core.argocd import DEFINITIONS, PARAMETERS, ArgoCd, argocd_installed, speech
from robotkube.delivery.preflight.core.values import merged
from robotkube.errors import InputError
from robotkube.foundation.kubernetes.adapters.client import api_client

NAMESPACE, GATE, ARGOCD = "robotkube", "robotkube-gate", "argocd"  # of the release, of its gate alone, of Argo CD
CHART = PROJECT / "charts" / "robotkube"
INSTALL_TIMEOUT_SECONDS = 420
ROLLOUT_TIMEOUT_SECONDS = 240
RESTRICTED = {"pod-security.kubernetes.io/enforce": "restricted"}
# What Helm asks of an object that is there before the chart that has it.
HELMS_LABEL = {"app.kubernetes.io/managed-by": "Helm"}
HELMS_OWN = {"meta.helm.sh/release-name": NAMESPACE, "meta.helm.sh/release-namespace": NAMESPACE}
NO_VALUES: Mapping[str, Any] = MappingProxyType({})
PLATFORM_IMAGES = ("platform", "suites", "ros", "mosquitto", "gitea", "ferretdb")
AGENT = "robotkube.io/agent"  # label of volume claims and volumes
KEY_SECRET = "evidence-key"  # noqa: S105
LOG_LINES = 15
TIMED_OUT = "timed out waiting for the condition"  # what Helm and kubectl say, and not for what


@dataclass(frozen=True)
class Installer:
    """The installer of a platform: `kubectl` and `helm` against one cluster; `work` is a folder for the values files
    that are generated, `profile` what the chart is told on this kind of cluster."""

    binaries: Path
    kubeconfig: Path
    work: Path
    profile: ChartProfile = field(default_factory=ChartProfile)

    def kubectl(self, *arguments: str, text: str | None = None, seconds: int = 60) -> str:
        """Run kubectl; SetUpError with its message when it fails."""
        return self._run("kubectl", arguments, text, seconds)

    def helm(self, *arguments: str, seconds: int = INSTALL_TIMEOUT_SECONDS + 30) -> str:
        """Run helm; SetUpError with its message when it fails."""
        return self._run("helm", arguments, None, seconds)

    def _run(self, program: str, arguments: Sequence[str], text: str | None, seconds: int) -> str:
        command = [*self._command(program), *arguments]
        try:
            done = subprocess.run(command, input=text, capture_output=True, text=True, timeout=seconds, check=False)
        except subprocess.TimeoutExpired as error:
            raise SetUpError(f"{program} {' '.join(arguments[:4])}: no answer within {seconds} s") from error
        if done.returncode:
            raise SetUpError(f"{program} {' '.join(arguments[:4])}: {done.stderr.strip()[-1500:]}")
        return done.stdout

    def _command(self, program: str) -> list[str]:
        return [str(self.binaries / program), "--kubeconfig", str(self.kubeconfig)]

    def argocd(self, references: Mapping[str, str]) -> str:
        """Apply Argo CD's own manifests, with our images, and wait until its definitions are known. One that somebody
        else has installed stays as it is. Returns what there is to say."""
        if self._argocd_is_given():
            return self.argocd_of_others()
        source = toolchain.module_dir("github.com/argoproj/argo-cd/v3") / "manifests" / "install.yaml"
        pulled = {name: moved(reference, self.profile.registry) for name, reference in references.items()}
        stated = stated_values(self.profile)
        nodes = stated.get("platform", {}).get("nodeSelector") or render.PLATFORM_NODES
        policies = stated.get("networkPolicies") or {}
        forge = render.external_forge(stated)
        manifests = render.render(source.read_text(encoding="utf-8"), pulled, policies, nodes, forge)
        self.namespace(ARGOCD, RESTRICTED)
        self.repo_server_clients()
        apply = ("apply", "--server-side", "--force-conflicts", "-n", ARGOCD, "-f", "-")
        self.kubectl(*apply, text=manifests, seconds=120)
        kinds = [f"crd/{kind}.argoproj.io" for kind in ("applications", "applicationsets", "appprojects")]
        self.kubectl("wait", "--for=condition=Established", "--timeout=60s", *kinds, seconds=70)
        return ""

    def argocd_of_others(self) -> str:
        """Keep what the platform will write into an Argo CD that was there, and say which it is; SetUpError names what
        it lacks to be used."""
        if not self.kubectl("get", "namespace", ARGOCD, "--ignore-not-found", "-o", "name"):
            raise SetUpError(
                f"Argo CD's definitions are there, and there is no namespace {ARGOCD}: a run uses an Argo CD in that "
                "one alone. With one elsewhere install the platform with Helm and its namespace in argocd.namespace "
                "(docs/how-to/install-from-a-bundle.md); without one take the definitions away: "
                f"kubectl delete crd {' '.join(DEFINITIONS)}"
            )
        verdict = argocd_installed(self._present_argocd())
        wrong = [*(f"{problem.what}: {problem.fix}" for problem in verdict.problems), *filter(None, [verdict.unseen])]
        if wrong:
            raise SetUpError(f"namespace {ARGOCD} was not made here, and its Argo CD is not used: {'; '.join(wrong)}")
        self.namespace(NAMESPACE, RESTRICTED)
        given_argocd.keep(self.kubectl)
        return f"{verdict.says}, which was there"

    def _present_argocd(self) -> ArgoCd:
        """What is there of Argo CD; ports of its Service are not looked at."""
        kinds = ("deployments,statefulsets", "-l", "app.kubernetes.io/part-of=argocd")
        workloads = json.loads(self.kubectl("-n", ARGOCD, "get", *kinds, "-o", "json"))["items"]
        told = self.kubectl("-n", ARGOCD, "get", f"configmap/{PARAMETERS}", "--ignore-not-found", "-o", "json")
        parameters = json.loads(told or "{}").get("data") or {}
        return ArgoCd(ARGOCD, self._definitions_of_argocd(), workloads, parameters, frozenset())

    def _of_given_argocd(self) -> dict[str, Any]:
        """Values by which managers reach the server of an Argo CD that was there, unless the profile has some."""
        stated = stated_values(self.profile).get("argocd") or {}
        if "server" in stated or not self._argocd_is_given():
            return {}
        server = given_argocd.server_values(self.kubectl, speech(self._present_argocd()))
        return {"argocd": {"server": server}} if server else {}

    def _argocd_is_given(self) -> bool:
        """Return whether there is one that was not made here; on a cluster that was, there is none."""
        if not self.profile.added:
            return False
        namespace = json.loads(self.kubectl("get", "namespace", ARGOCD, "--ignore-not-found", "-o", "json") or "{}")
        if not namespace:
            return bool(self._definitions_of_argocd())
        return not self.profile.added.items() <= namespace["metadata"].get("annotations", {}).items()

    def _definitions_of_argocd(self) -> frozenset[str]:
        names = (f"crd/{name}" for name in DEFINITIONS)
        present = self.kubectl("get", *names, "--ignore-not-found", "-o", "name")
        return frozenset(line.rpartition("/")[2] for line in present.split())

    def repo_server_clients(self) -> None:
        """The Secret with the certificate without which Argo CD's repo-server answers nobody; one that is there stays,
        since the programs read it only when they start."""
        if self.kubectl("-n", ARGOCD, "get", "secret", render.CLIENTS, "--ignore-not-found", "-o", "name"):
            return
        made = client_certificate("argocd")
        secret = {
            "apiVersion": "v1",
            "kind": "Secret",
            "metadata": {"name": render.CLIENTS, "namespace": ARGOCD},
            "stringData": {
                "client-ca.crt": made.certificate,
                "client.crt": made.certificate,
                "client.key": made.key,
            },
        }
        self.kubectl("apply", "--server-side", "-f", "-", text=yaml.safe_dump(secret))

    def namespace(self, name: str, labels: Mapping[str, str], annotations: Mapping[str, str] = NO_VALUES) -> None:
        """A namespace with labels and annotations, whether it is there or not."""
        metadata = {"name": name, "labels": dict(labels), "annotations": {**annotations, **self.profile.added}}
        namespace = {"apiVersion": "v1", "kind": "Namespace", "metadata": metadata}
        self.kubectl("apply", "--server-side", "--force-conflicts", "-f", "-", text=yaml.safe_dump(namespace))

    def platform(
        self,
        references: Mapping[str, str],
        topology: Topology,
        chart: Path = CHART,
        values: Mapping[str, Any] = NO_VALUES,
        say: Callable[[str], None] = lambda line: None,
    ) -> None:
        """`helm upgrade --install robotkube` with the cluster's profile, the images and the agents of the topology, and
        further `values`. `say` is told of each component when it is ready, and of what hangs.

        Two namespaces come first: a chart cannot say that its own takes only restricted pods, and the gate's has the
        key in it before the gate starts.
        """
        place = self.work / "values.yaml"
        self.work.mkdir(parents=True, exist_ok=True)
        self.namespace(NAMESPACE, RESTRICTED)
        given = {
            **self.values(references, topology),
            "evidence": self.signing_key(),
            **values,
        }
        place.write_text(yaml.safe_dump(given), encoding="utf-8")
        files = [*(chart / name for name in self.profile.files), place]
        options = ["-n", NAMESPACE, *(word for file in files for word in ("-f", str(file)))]
        install = ("upgrade", "--install", NAMESPACE, str(chart), *options)
        namespaces = (NAMESPACE, GATE, ARGOCD)
        with self.watching(namespaces, say) as followed:
            try:
                self._install(install, namespaces)
            except SetUpError as error:
                hanging = followed.lines.hanging() if followed else ()
                raise SetUpError(what_hangs(str(error), [line.words for line in hanging])) from error
        if chart == CHART:  # until then an older gate had the key there
            self.kubectl("-n", NAMESPACE, "delete", "secret", KEY_SECRET, "--ignore-not-found")

    def values(self, references: Mapping[str, str], topology: Topology) -> dict[str, Any]:
        """What the chart is told of images, agents, an Argo CD that was there, and of the cluster upon these."""
        known = merged(platform_values(references, topology), self._of_given_argocd())
        return merged(known, self.profile.values)

    def watching(
        self, namespaces: Sequence[str], say: Callable[[str], None]
    ) -> AbstractContextManager[InstallationWatch | None]:
        """Lines about components, None where this kubeconfig is one that kubectl alone can read."""
        try:
            api = api_client(str(self.kubeconfig))
        except InputError:
            return nullcontext()
        return InstallationWatch(api, namespaces, lambda line: say(line.words))

    def _install(self, command: Sequence[str], namespaces: Sequence[str]) -> None:
        """Run Helm's command and wait for what it installs."""
        try:
            self.helm(*command, "--timeout", f"{INSTALL_TIMEOUT_SECONDS}s")
        except SetUpError as error:
            states = "\n".join(map(self.state, namespaces))
            raise SetUpError(f"{error}\n{states}") from error
        self.bind_volume_claims()
        for namespace in namespaces:
            self.rollout(namespace)

    def console(self) -> ServicePort | None:
        """The console's Service; None where the chart was installed without one."""
        where = "jsonpath={.spec.clusterIP}:{.spec.ports[0].port}"
        address_and_port = self.kubectl("-n", NAMESPACE, "get", "service", "console", "--ignore-not-found", "-o", where)
        address, _, port = address_and_port.strip().rpartition(":")
        return ServicePort(NAMESPACE, "console", address, int(port)) if address else None

    def bind_volume_claims(self) -> None:
        """Bind volume claims of agents with one node now. Left to the first pod, the scheduler checks once in a second
        whether the volume that it chose is bound: the first event's recorder started that much later."""
        volume_claims, volumes = (
            json.loads(self.kubectl("get", kind, *more, "-o", "json"))["items"]
            for kind, *more in (("persistentvolumeclaims", "-A", "-l", AGENT), ("persistentvolumes",))
        )
        bound = chosen_volumes(volume_claims, volumes)
        if bound:
            text = yaml.safe_dump({"apiVersion": "v1", "kind": "List", "items": bound})
            self.kubectl("apply", "--server-side", "--field-manager=robotkube-installation", "-f", "-", text=text)

    def signing_key(self, namespace: str = GATE) -> dict[str, Any]:
        """The Secret with this user's signing key, where the gate mounts it and not by Helm, which would keep a copy;
        returns what the chart has to know of it."""
        key = evidence.signing_key()
        if namespace == GATE:
            self.namespace(GATE, RESTRICTED | HELMS_LABEL, HELMS_OWN)
        secret = {
            "apiVersion": "v1",
            "kind": "Secret",
            "metadata": {"name": KEY_SECRET, "namespace": namespace},
            "stringData": {"key.pem": evidence.key_file().read_text(encoding="utf-8")},
        }
        self.kubectl("apply", "--server-side", "--force-conflicts", "-f", "-", text=yaml.safe_dump(secret))
        return {"existingSecret": KEY_SECRET, "trustedKeys": {f"key-{key.key_id}": key.public_key}}

    def rollout(self, namespace: str) -> None:
        """Wait until every Deployment and StatefulSet of a namespace is rolled out."""
        listed = json.loads(self.kubectl("-n", namespace, "get", "deployments,statefulsets", "-o", "json"))
        for item in listed["items"]:
            name = f"{item['kind'].lower()}/{item['metadata']['name']}"
            wait = ("-n", namespace, "rollout", "status", name, f"--timeout={ROLLOUT_TIMEOUT_SECONDS}s")
            try:
                self.kubectl(*wait, seconds=ROLLOUT_TIMEOUT_SECONDS + 10)
            except SetUpError as error:
                raise SetUpError(f"{error}\n{self.state(namespace)}") from error

    def state(self, namespace: str) -> str:
        """Pods of a namespace, and events and last log lines of those that are not ready: what a person would look at
        first.
        """
        try:
            pods = json.loads(self.kubectl("-n", namespace, "get", "pods", "-o", "json"))["items"]
            lines = [self.kubectl("-n", namespace, "get", "pods", "-o", "wide")]
            for pod in filter(_not_ready, pods):
                name = pod["metadata"]["name"]
                field = f"--field-selector=involvedObject.name={name}"
                lines.append(self.kubectl("-n", namespace, "get", "events", field))
                tail = ("logs", name, "--all-containers", f"--tail={LOG_LINES}", "--ignore-errors")
                lines.append(self.kubectl("-n", namespace, *tail))
        except SetUpError as error:
            return f"(state of {namespace} cannot be read: {error})"
        return "\n".join(lines)


def stated_values(profile: ChartProfile) -> Mapping[str, Any]:
    """What a profile says of the platform's chart, its files and values laid over each other."""
    stated: dict[str, Any] = {}
    files = (yaml.safe_load((CHART / name).read_text(encoding="utf-8")) for name in profile.files)
    for values in (*files, profile.values):
        stated = merged(stated, values)
    return stated


def what_hangs(text: str, hanging: Sequence[str]) -> str:
    """What a program says that waited in vain, with what hangs in the place of its words for that."""
    return text.replace(TIMED_OUT, "\n".join(hanging)) if hanging else text


def moved(reference: str, registry: str) -> str:
    """An image reference as the cluster pulls it: what stands before its last slash is the registry's HOST/PATH."""
    return f"{registry}/{reference.rpartition('/')[2]}" if registry else reference


def chosen_volumes(
    volume_claims: Sequence[Mapping[str, Any]], volumes: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Volumes to apply so that each waiting claim gets a free one of its agent, if all of these are on one node."""
    free = [one for one in volumes if one["status"].get("phase") == "Available" and not one["spec"].get("claimRef")]
    chosen = []
    for volume_claim in (claim for claim in volume_claims if claim["status"].get("phase") == "Pending"):
        agent = volume_claim["metadata"]["labels"][AGENT]
        own = [one for one in free if one["metadata"].get("labels", {}).get(AGENT) == agent]
        if len({json.dumps(one["spec"].get("nodeAffinity"), sort_keys=True) for one in own}) != 1:
            continue
        free.remove(own[0])
        place = {"namespace": volume_claim["metadata"]["namespace"], "name": volume_claim["metadata"]["name"]}
        reference = {"apiVersion": "v1", "kind": "PersistentVolumeClaim", **place}
        volume = {"apiVersion": "v1", "kind": "PersistentVolume", "metadata": {"name": own[0]["metadata"]["name"]}}
        chosen.append({**volume, "spec": {"claimRef": reference}})
    return chosen


def _not_ready(pod: Mapping[str, Any]) -> bool:
    if pod["status"].get("phase") == "Succeeded":
        return False
    conditions = pod["status"].get("conditions", [])
    return not any(entry["type"] == "Ready" and entry["status"] == "True" for entry in conditions)


def platform_values(references: Mapping[str, str], topology: Topology) -> dict[str, Any]:
    """Values of charts/robotkube for a topology."""
    images = {name: references[name] for name in PLATFORM_IMAGES}
    services = {name: reference for name, reference in references.items() if name in SERVICE_NAMES}
    others = set(references.values()) - set(services.values())  # Argo CD's among them
    return {
        "images": images,
        **({"serviceImages": services} if services else {}),
        "agents": chart_agents(topology.nodes),
        "inspection": {"images": sorted(others)},
    }
