"""The Pod Security Standard "restricted" over a pod's specification: every rule with words of its own.

The rules are those of https://kubernetes.io/docs/concepts/security/pod-security-standards/ (baseline and restricted
together, for Linux). Kubernetes refuses a pod with one long sentence; here each broken rule names place, finding, fix.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

Findings = Iterator[str]
Inspect = Callable[["Pod"], Findings]

CONTAINER_LISTS = ("containers", "initContainers", "ephemeralContainers")
VOLUME_TYPES = frozenset(
    {"configMap", "csi", "downwardAPI", "emptyDir", "ephemeral", "persistentVolumeClaim", "projected", "secret"}
)
SECCOMP_TYPES = ("RuntimeDefault", "Localhost")
SELINUX_TYPES = ("", "container_t", "container_init_t", "container_kvm_t", "container_engine_t")
SAFE_SYSCTLS = frozenset(
    {
        "kernel.shm_rmid_forced",
        "net.ipv4.ip_local_port_range",
        "net.ipv4.ip_local_reserved_ports",
        "net.ipv4.ip_unprivileged_port_start",
        "net.ipv4.ping_group_range",
        "net.ipv4.tcp_fin_timeout",
        "net.ipv4.tcp_keepalive_intvl",
        "net.ipv4.tcp_keepalive_probes",
        "net.ipv4.tcp_keepalive_time",
        "net.ipv4.tcp_rmem",
        "net.ipv4.tcp_syncookies",
        "net.ipv4.tcp_wmem",
    }
)
APPARMOR_ANNOTATION = "container.apparmor.security.beta.kubernetes.io/"
PROBES = ("startupProbe", "readinessProbe", "livenessProbe")
HOOKS = ("postStart", "preStop")


@dataclass(frozen=True)
class Pod:
    """A pod template: where it stands (`Deployment app`), its annotations and its specification."""

    place: str
    annotations: Mapping[str, Any]
    spec: Mapping[str, Any]

    @property
    def containers(self) -> Iterator[tuple[str, Mapping[str, Any]]]:
        """Every container of any sort, with its place in words."""
        for kind in CONTAINER_LISTS:
            for container in items(self.spec.get(kind)):
                yield f"{self.place}: container {container.get('name', '(without a name)')}", container

    @property
    def contexts(self) -> Iterator[tuple[str, Mapping[str, Any]]]:
        """The security contexts of the pod and of every container."""
        yield f"{self.place}: pod", mapping(self.spec.get("securityContext"))
        for place, container in self.containers:
            yield place, mapping(container.get("securityContext"))


@dataclass(frozen=True)
class SecurityRule:
    """One control: `inspect` yields a sentence per place that breaks it; `fix` is what to write instead."""

    name: str
    inspect: Inspect
    fix: str


def mapping(value: Any) -> Mapping[str, Any]:
    """`value` if it is a mapping, else an empty one."""
    return value if isinstance(value, Mapping) else {}


def items(value: Any) -> Sequence[Mapping[str, Any]]:
    """The mappings in `value` if it is a list, else none."""
    return [item for item in value if isinstance(item, Mapping)] if isinstance(value, list) else []


def _host_namespaces(pod: Pod) -> Findings:
    for key in ("hostNetwork", "hostPID", "hostIPC"):
        if pod.spec.get(key):
            yield f"{pod.place}: {key} is true: the pod would share this with its node"


def _privileged(pod: Pod) -> Findings:
    for place, context in pod.contexts:
        if context.get("privileged"):
            yield f"{place}: privileged is true: it could do everything that root can do on the node"


def _host_process(pod: Pod) -> Findings:
    for place, context in pod.contexts:
        if mapping(context.get("windowsOptions")).get("hostProcess"):
            yield f"{place}: windowsOptions.hostProcess is true"


def _host_ports(pod: Pod) -> Findings:
    for place, container in pod.containers:
        for port in items(container.get("ports")):
            if port.get("hostPort"):
                yield f"{place}: hostPort {port['hostPort']}: it would occupy a port of the node"


def _host_probes(pod: Pod) -> Findings:
    for place, container in pod.containers:
        lifecycle = mapping(container.get("lifecycle"))
        handlers = [(key, mapping(container.get(key))) for key in PROBES]
        handlers += [(key, mapping(lifecycle.get(key))) for key in HOOKS]
        for key, handler in handlers:
            for way in ("httpGet", "tcpSocket"):
                if mapping(handler.get(way)).get("host"):
                    yield f"{place}: {key}.{way}.host names another host: the node would call it"


def _volumes(pod: Pod) -> Findings:
    for volume in items(pod.spec.get("volumes")):
        for kind in sorted(set(volume) - {"name"} - VOLUME_TYPES):
            reason = ": a folder of the node" if kind == "hostPath" else ""
            yield f"{pod.place}: volume {volume.get('name')}: type {kind}{reason}"


def _proc_mount(pod: Pod) -> Findings:
    for place, context in pod.contexts:
        if context.get("procMount") not in (None, "Default"):
            yield f"{place}: procMount is {context['procMount']!r}"


def _sysctls(pod: Pod) -> Findings:
    for entry in items(mapping(pod.spec.get("securityContext")).get("sysctls")):
        if entry.get("name") not in SAFE_SYSCTLS:
            yield f"{pod.place}: sysctl {entry.get('name')} reaches beyond the pod"


def _apparmor(pod: Pod) -> Findings:
    for key, value in pod.annotations.items():
        if (
            key.startswith(APPARMOR_ANNOTATION)
            and value != "runtime/default"
            and not f"{value}".startswith("localhost/")
        ):
            yield f"{pod.place}: annotation {key} is {value!r}"
    for place, context in pod.contexts:
        kind = mapping(context.get("appArmorProfile")).get("type")
        if kind not in (None, *SECCOMP_TYPES):
            yield f"{place}: appArmorProfile.type is {kind!r}"


def _selinux(pod: Pod) -> Findings:
    for place, context in pod.contexts:
        options = mapping(context.get("seLinuxOptions"))
        if options.get("type", "") not in SELINUX_TYPES:
            yield f"{place}: seLinuxOptions.type is {options['type']!r}"
        for key in ("user", "role"):
            if options.get(key):
                yield f"{place}: seLinuxOptions.{key} is {options[key]!r}"


def _escalation(pod: Pod) -> Findings:
    for place, container in pod.containers:
        if mapping(container.get("securityContext")).get("allowPrivilegeEscalation") is not False:
            yield f"{place}: allowPrivilegeEscalation is not false: a set-uid program would give it more rights"


def _inherited(pod: Pod, key: str) -> Iterator[tuple[str, Any]]:
    """What counts for each container: its own setting, else the pod's."""
    common = mapping(pod.spec.get("securityContext")).get(key)
    for place, container in pod.containers:
        own = mapping(container.get("securityContext")).get(key)
        yield place, common if own is None else own


def _non_root(pod: Pod) -> Findings:
    for place, value in _inherited(pod, "runAsNonRoot"):
        if value is not True:
            yield f"{place}: runAsNonRoot is not true: it may run as root"


def _root_user(pod: Pod) -> Findings:
    for place, context in pod.contexts:
        if context.get("runAsUser") == 0:
            yield f"{place}: runAsUser is 0: this is root"


def _seccomp(pod: Pod) -> Findings:
    for place, value in _inherited(pod, "seccompProfile"):
        kind = mapping(value).get("type")
        if kind not in SECCOMP_TYPES:
            yield f"{place}: seccompProfile.type is {kind or 'not set'}: no system call would be refused"


def _capabilities(pod: Pod) -> Findings:
    for place, container in pod.containers:
        given = mapping(mapping(container.get("securityContext")).get("capabilities"))
        if "ALL" not in (given.get("drop") or ()):
            yield f"{place}: capabilities.drop does not hold ALL"
        more = sorted(set(map(str, given.get("add") or ())) - {"NET_BIND_SERVICE"})
        if more:
            yield f"{place}: capabilities.add holds {', '.join(more)}"


RULES = (
    SecurityRule("host-namespaces", _host_namespaces, "leave hostNetwork, hostPID and hostIPC out"),
    SecurityRule("privileged", _privileged, "leave privileged out of every securityContext"),
    SecurityRule("host-process", _host_process, "leave windowsOptions.hostProcess out"),
    SecurityRule("host-ports", _host_ports, "leave hostPort out; name the port with containerPort alone"),
    SecurityRule("host-probes", _host_probes, "leave `host` out of probes and hooks; they reach the pod itself"),
    SecurityRule("volume-types", _volumes, f"use only volumes of the types {', '.join(sorted(VOLUME_TYPES))}"),
    SecurityRule("proc-mount", _proc_mount, "leave procMount out"),
    SecurityRule("sysctls", _sysctls, "leave the setting out; only sysctls of the pod's own namespaces are allowed"),
    SecurityRule("apparmor", _apparmor, "leave it out, or use RuntimeDefault"),
    SecurityRule("selinux", _selinux, "leave seLinuxOptions out"),
    SecurityRule(
        "privilege-escalation", _escalation, "write securityContext.allowPrivilegeEscalation: false in every container"
    ),
    SecurityRule("run-as-non-root", _non_root, "write securityContext.runAsNonRoot: true in the pod"),
    SecurityRule("run-as-user", _root_user, "give a user number that is not 0, such as runAsUser: 10001"),
    SecurityRule("seccomp", _seccomp, "write securityContext.seccompProfile: {type: RuntimeDefault} in the pod"),
    SecurityRule("capabilities", _capabilities, "write securityContext.capabilities: {drop: [ALL]} in every container"),
)
