"""The command `robotkube agent list`: agents with their accounts at the broker, who is revoked, reserved or enrolled,
and what their Nodes say."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robotkube.cli.agents.joining import token_ends
from robotkube.cli.forge_access import REPOSITORY, forge_account, reaching
from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.delivery.certificates.core import register as registers
from robotkube.delivery.deployment.core.releases import RELEASES, Release, read_tree
from robotkube.delivery.rights.core.accounts import Accounts, AgentAccount
from robotkube.delivery.rights.core.origins import Enrollment, Revocation, enrollments, revocations
from robotkube.delivery.rights.settings import read_accounts
from robotkube.errors import InputError, did_you_mean
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.times import time_text
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.foundation.forge.adapters.git import GitHistory, fetch_history
from robotkube.foundation.kubernetes.core.node_agents import TRIAL_MEANS, node_agents, shared_nodes

READER = "argocd"  # which reads the repository and nothing else
OPEN, REVOKED, RESERVED = "open", "revoked", "reserved"
VALUES, MAIN = "values", "main"
COLUMNS = (
    *("agent", "role", "declared", "account", "reason", "by", "commit", "nodes", "ready", "seen"),
    *("kubelet", "releases", "certificate_until", "join_until"),
)
TRIAL = ("node", "agents", "trial")

Document = Mapping[str, Any]


def reading(parser: argparse.ArgumentParser) -> None:
    """Add the arguments by which main of the deployment repository is read."""
    reaching(parser)
    parser.add_argument("--username", default=READER, help="account that reads the deployment repository")
    parser.add_argument("--clone", type=Path, metavar="FOLDER", help="read this clone of the deployment repository")


@contextmanager
def history(options: argparse.Namespace) -> Iterator[GitHistory]:
    """Main's history, of the clone that is named or fetched from the forge."""
    with tempfile.TemporaryDirectory(prefix="robotkube-agents-") as folder:
        clone = options.clone or Path(folder) / "deployment.git"
        if not options.clone:
            access = forge_account(options, options.username)
            fetch_history(access.url, REPOSITORY, access.username, access.password, clone)
        yield GitHistory(clone)


def declared(platform: Platform) -> Accounts:
    """The accounts that the platform's settings declare; InputError when it keeps no rights."""
    where = "ConfigMap rights, config.yaml"
    reader = Reader(where)
    accounts = read_accounts(reader, read_mapping(platform.rights_settings(), where))
    reader.finish()
    return accounts


def declared_agent(accounts: Accounts, name: str) -> AgentAccount:
    """The account of an agent; InputError names those that there are."""
    for agent in accounts.agents:
        if agent.name == name:
            return agent
    known = [agent.name for agent in accounts.agents]
    instead = f"{did_you_mean(name, known)}there are: {', '.join(known) or 'none'}"
    raise InputError(f"no agent {name} is declared; {instead}")


def list_agents(options: argparse.Namespace) -> Table:
    """List agents: where they are declared, whether main lets their accounts in, their Nodes, and what runs there. Who
    is connected just now the broker does not tell; a Node's lease says when its machine was heard of last.
    `certificate_until` is when the certificate ends that proves the account, where accounts have any and it is not
    revoked; `join_until` when the token of a file ends that nobody needs any more once the Node is there. Nodes that
    are several agents' follow, with what that means."""
    platform = Platform(options)
    accounts = declared(platform)
    with history(options) as main:
        commits = main.commits({})
        files = main.files(commits[-1].id, (RELEASES,)) if commits else {}
    said = OfMain(revocations(commits), enrollments(commits), _versions(read_tree(files).releases.values()))
    nodes = platform.agent_nodes()
    leases = platform.node_leases()
    ends = Ends(token_ends(platform), registers.read(platform.certificate_register()).ends())
    shared = Table("shared_nodes", TRIAL, shared_rows(nodes))
    return Table("agents", COLUMNS, rows(accounts.agents, said, nodes, leases, ends), more=(shared,))


@dataclass(frozen=True)
class OfMain:
    """What main says of agents: who is revoked and who enrolled, by name, and the chart versions of their releases, by
    namespace."""

    revoked: Mapping[str, Revocation]
    enrolled: Mapping[str, Enrollment]
    versions: Mapping[str, Sequence[str]] = field(default_factory=dict)


@dataclass(frozen=True)
class Ends:
    """Until when an agent's machine can join, as it is said there, and its account's certificate is valid, in seconds
    since 1970; by agent."""

    tokens: Mapping[str, str] = field(default_factory=dict)
    certificates: Mapping[str, float] = field(default_factory=dict)


def rows(
    agents: Iterable[AgentAccount],
    said: OfMain,
    nodes: Sequence[Document],
    leases: Iterable[Document],
    ends: Ends,
) -> list[Document]:
    """A row for each agent; `nodes` and `leases` are Nodes of agents and the leases of all Nodes."""
    heard = {lease["metadata"]["name"]: str(lease.get("spec", {}).get("renewTime") or "") for lease in leases}
    listed: list[Document] = []
    for agent in sorted(agents, key=lambda one: one.name):
        own = [node for node in nodes if agent.name in _owners(node)]
        seen = max((heard.get(node["metadata"]["name"], "") for node in own), default="")
        row = {
            **{"agent": agent.name, "role": agent.role, "namespace": agent.namespace, **_account(said, agent)},
            **{"nodes": len(own), "ready": sum(_ready(node) for node in own)},
            **{"seen": _whole_seconds(seen), "kubelet": _kubelets(own)},
            **{"releases": list(said.versions.get(agent.namespace, ()))},
            **{"certificate_until": _time(ends.certificates.get(agent.name))},
            **{"join_until": ends.tokens.get(agent.name, "")},
        }
        listed.append(row)
    return listed


def shared_rows(nodes: Iterable[Document]) -> list[Document]:
    """A row for each Node that is several agents', which is trial mode."""
    shared = shared_nodes((node["metadata"]["name"], node["metadata"].get("labels") or {}) for node in nodes)
    return [{"node": node, "agents": list(agents), "trial": TRIAL_MEANS} for node, agents in shared.items()]


def _owners(node: Document) -> list[str]:
    return [agent.name for agent in node_agents(node["metadata"].get("labels") or {})]


def _time(seconds: float | None) -> str:
    return _whole_seconds(time_text(int(seconds) * 10**9)) if seconds else ""


def _whole_seconds(time: str) -> str:
    """A time of RFC 3339 without a part of a second."""
    return time.partition(".")[0] + "Z" if time else ""


def _account(said: OfMain, agent: AgentAccount) -> Document:
    """The place where an agent is declared, and the state of its account, with the commit that shut or enrolled it."""
    enrolled = None if agent.role else said.enrolled.get(agent.name)
    role, declared_by = (enrolled.role, MAIN) if enrolled else (agent.role, VALUES)
    revoked = said.revoked.get(agent.name)
    shut_or_enrolled = revoked or enrolled
    account = REVOKED if revoked else OPEN if role else RESERVED
    by, commit = (shut_or_enrolled.commit.author, shut_or_enrolled.commit.id[:12]) if shut_or_enrolled else ("", "")
    reason = revoked.reason if revoked else ""
    return {"role": role, "declared": declared_by, "account": account, "reason": reason, "by": by, "commit": commit}


def _kubelets(nodes: Iterable[Document]) -> list[str]:
    """The versions of the kubelets of Nodes."""
    said = {str(node.get("status", {}).get("nodeInfo", {}).get("kubeletVersion") or "") for node in nodes}
    return sorted(said - {""})


def _versions(releases: Iterable[Release]) -> dict[str, list[str]]:
    """The chart versions of releases, by namespace."""
    charts: dict[str, list[str]] = {}
    for release in sorted(releases, key=lambda one: one.key):
        charts.setdefault(release.namespace, []).append(f"{release.chart} {release.version}")
    return {namespace: list(dict.fromkeys(named)) for namespace, named in charts.items()}


def _ready(node: Document) -> bool:
    conditions = node.get("status", {}).get("conditions") or ()
    return any(condition.get("type") == "Ready" and condition.get("status") == "True" for condition in conditions)
