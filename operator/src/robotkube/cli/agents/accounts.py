"""The command `robotkube agent list`: agents with their accounts at the broker, who is revoked, and what their Nodes
say."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from robotkube.cli.forge_access import REPOSITORY, forge_account, reaching
from robotkube.cli.output import Table
from robotkube.cli.platform import AGENT_LABEL, Platform
from robotkube.delivery.rights.core.accounts import Accounts, AgentAccount
from robotkube.delivery.rights.core.origins import Revocation, revocations
from robotkube.delivery.rights.settings import read_accounts
from robotkube.errors import InputError, did_you_mean
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.foundation.forge.adapters.git import GitHistory, fetch_history

READER = "argocd"  # which reads the repository and nothing else
OPEN, REVOKED = "open", "revoked"
COLUMNS = ("agent", "role", "account", "reason", "by", "commit", "nodes", "ready", "seen")

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
    """List agents: whether main lets their accounts in, and their Nodes. Who is connected just now the broker does not
    tell; a Node's lease says when its machine was heard of last."""
    platform = Platform(options)
    accounts = declared(platform)
    with history(options) as main:
        revoked = revocations(main.commits({}))
    return Table("agents", COLUMNS, rows(accounts.agents, revoked, platform.agent_nodes(), platform.node_leases()))


def rows(
    agents: Iterable[AgentAccount],
    revoked: Mapping[str, Revocation],
    nodes: Sequence[Document],
    leases: Iterable[Document],
) -> list[Document]:
    """A row for each agent; `nodes` and `leases` are Nodes of agents and the leases of all Nodes."""
    heard = {one["metadata"]["name"]: str(one.get("spec", {}).get("renewTime") or "") for one in leases}
    found: list[Document] = []
    for agent in sorted(agents, key=lambda one: one.name):
        own = [node["metadata"]["name"] for node in nodes if node["metadata"]["labels"][AGENT_LABEL] == agent.name]
        ready = sum(_ready(node) for node in nodes if node["metadata"]["name"] in own)
        seen = max((heard.get(name, "") for name in own), default="")
        row = {"agent": agent.name, "role": agent.role, "namespace": agent.namespace, **_account(revoked, agent.name)}
        found.append({**row, "nodes": len(own), "ready": ready, "seen": seen.partition(".")[0] + "Z" if seen else ""})
    return found


def _account(revoked: Mapping[str, Revocation], agent: str) -> Document:
    one = revoked.get(agent)
    if one is None:
        return {"account": OPEN, "reason": "", "by": "", "commit": ""}
    return {"account": REVOKED, "reason": one.reason, "by": one.commit.author, "commit": one.commit.id[:12]}


def _ready(node: Document) -> bool:
    conditions = node.get("status", {}).get("conditions") or ()
    return any(one.get("type") == "Ready" and one.get("status") == "True" for one in conditions)
