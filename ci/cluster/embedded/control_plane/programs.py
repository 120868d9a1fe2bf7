"""etcd, API server, controllers, scheduler and name service: processes of the host, bound to the bridge's address."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from ci.cluster.embedded.control_plane.pki import Authority, control_plane_identities
from ci.cluster.embedded.host.processes import Launcher, Process
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network.addresses import AddressPlan

WEIGHT = 400  # among the daemons: every node waits for these
KUBECONFIGS = {
    "admin": "kubeconfig",
    "controller-manager": "controller-manager.kubeconfig",
    "scheduler": "scheduler.kubeconfig",
    "proxy": "proxy.kubeconfig",
    "name-service": "name-service.kubeconfig",
}
CONTROLLER_QUERIES_PER_SECOND = 100
NO_OPTIONS: Mapping[str, str] = MappingProxyType({})
# One collection takes 0.5 core seconds, half a second from all others, and comes when there is much to do: while a plan
# is carried out.
SELDOM_COLLECTING = {"GOGC": "off", "GOMEMLIMIT": "2GiB"}


def write_credentials(authority: Authority, plan: AddressPlan, folders: ClusterFolders) -> None:
    """Certificates and kubeconfigs of the control plane."""
    authority.create()
    for identity in control_plane_identities(plan):
        authority.issue(identity)
        if identity.name in KUBECONFIGS:
            target = folders.base / KUBECONFIGS[identity.name]
            authority.write_kubeconfig(identity, f"https://{plan.gateway}:6443", target)


def start_etcd(launcher: Launcher, plan: AddressPlan) -> Process:
    """etcd with client certificates. Without fsync: the embedded cluster is made anew after a crash of the machine."""
    folders, pki = launcher.folders, launcher.folders.pki
    client = f"https://{plan.gateway}:2379"
    peer = f"http://{plan.gateway}:2380"
    command = ["etcd", f"--data-dir={folders.base / 'etcd'}", "--unsafe-no-fsync", "--log-level=warn"]
    command += [f"--listen-client-urls={client}", f"--advertise-client-urls={client}"]
    command += [
        f"--listen-peer-urls={peer}",
        f"--initial-advertise-peer-urls={peer}",
        f"--initial-cluster=default={peer}",
    ]
    command += [f"--cert-file={pki / 'etcd.crt'}", f"--key-file={pki / 'etcd.key'}"]
    command += ["--client-cert-auth", f"--trusted-ca-file={pki / 'etcd-ca.crt'}"]
    return launcher.start("etcd", command, weight=WEIGHT)


def start_api_server(launcher: Launcher, plan: AddressPlan, more: Mapping[str, str] = NO_OPTIONS) -> Process:
    """The API server; Node and RBAC authorization, no anonymous access. `more`: further options."""
    command = api_server_command(plan, launcher.folders, more)
    return launcher.start("kube-apiserver", command, environment=SELDOM_COLLECTING, weight=WEIGHT)


def api_server_command(plan: AddressPlan, folders: ClusterFolders, more: Mapping[str, str] = NO_OPTIONS) -> list[str]:
    """The API server's command line."""
    pki = folders.pki
    options = {
        "bind-address": plan.gateway,
        "advertise-address": plan.gateway,
        "secure-port": 6443,
        "service-cluster-ip-range": plan.services,
        "etcd-servers": f"https://{plan.gateway}:2379",
        "etcd-cafile": pki / "etcd-ca.crt",
        "etcd-certfile": pki / "apiserver-etcd.crt",
        "etcd-keyfile": pki / "apiserver-etcd.key",
        "client-ca-file": pki / "ca.crt",
        "tls-cert-file": pki / "apiserver.crt",
        "tls-private-key-file": pki / "apiserver.key",
        "kubelet-certificate-authority": pki / "ca.crt",
        "kubelet-client-certificate": pki / "apiserver-kubelet.crt",
        "kubelet-client-key": pki / "apiserver-kubelet.key",
        "kubelet-preferred-address-types": "InternalIP",  # no name of a node is in any name service
        "service-account-issuer": "https://kubernetes.default.svc.cluster.local",
        "service-account-key-file": pki / "sa.key",
        "service-account-signing-key-file": pki / "sa.key",
        "authorization-mode": "Node,RBAC",
        "anonymous-auth": "false",
        "enable-admission-plugins": "NodeRestriction",
        "profiling": "false",
        **more,
    }
    return ["kube-apiserver", *(f"--{name}={value}" for name, value in options.items())]


def start_controllers(launcher: Launcher, plan: AddressPlan) -> tuple[Process, Process]:
    """Controller manager and scheduler; they serve nothing, so no port of the host is taken."""
    folders, pki = launcher.folders, launcher.folders.pki
    manager = [
        "kube-controller-manager",
        f"--kubeconfig={folders.base / KUBECONFIGS['controller-manager']}",
        f"--root-ca-file={pki / 'ca.crt'}",
        f"--service-account-private-key-file={pki / 'sa.key'}",
        "--use-service-account-credentials",
        "--leader-elect=false",
        "--secure-port=0",
        f"--kube-api-qps={CONTROLLER_QUERIES_PER_SECOND}",
        f"--kube-api-burst={2 * CONTROLLER_QUERIES_PER_SECOND}",
    ]
    scheduler = [
        "kube-scheduler",
        f"--kubeconfig={folders.base / KUBECONFIGS['scheduler']}",
        "--leader-elect=false",
        "--secure-port=0",
    ]
    return (
        launcher.start("kube-controller-manager", manager, weight=WEIGHT),
        launcher.start("kube-scheduler", scheduler, weight=WEIGHT),
    )


def start_name_service(launcher: Launcher, plan: AddressPlan) -> Process:
    """CoreDNS on the gateway: one process of the host serves all nodes, so no pod waits for a pod."""
    corefile = launcher.folders.base / "Corefile"
    corefile.write_text(_corefile(plan, launcher.folders), encoding="utf-8")
    return launcher.start("name-service", ["coredns", "-conf", str(corefile)], weight=WEIGHT)


def _corefile(plan: AddressPlan, folders: ClusterFolders) -> str:
    # Every name outside of the cluster is answered at once: pods have no way there.
    return f"""cluster.local:53 in-addr.arpa:53 {{
  bind {plan.gateway}
  errors
  kubernetes cluster.local in-addr.arpa {{
    kubeconfig {folders.base / KUBECONFIGS["name-service"]}
    ttl 5
  }}
}}
.:53 {{
  bind {plan.gateway}
  errors
  template ANY ANY {{
    rcode NXDOMAIN
  }}
}}
"""
