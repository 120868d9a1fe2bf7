"""Settings of the console (docs/reference/console.md)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotkube.delivery.console.core.asking import Writers
from robotkube.delivery.console.core.poses import MARK
from robotkube.delivery.console.core.signing_in import SignIn
from robotkube.delivery.console.ports import ManagerPages
from robotkube.delivery.deployment.core.policies.agents import read_declared
from robotkube.foundation.certificates.settings import read_authorities
from robotkube.foundation.documents.core.patterns import (
    ADDRESSES,
    AGENTS_MQTT_TOPIC,
    ALL,
    HOST,
    HTTP_URL,
    NAME,
    NAME_OR_ALL,
    WORD,
)
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.runtime import settings_file as files
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.broker_settings import read_broker

LOOPBACK = "127.0.0.1"
SCOPES = ["openid", "profile", "groups", "read:user"]  # without the last one a token of Gitea may do all that he may
SCOPE = re.compile(r"[!#-\[\]-~]{1,100}", re.ASCII)  # RFC 6749, section 3.3
TEXT = re.compile(r"[^\0\n]{1,500}")
GROUP = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9 ._:/@-]{0,198}[A-Za-z0-9._/@-])?", re.ASCII)
OPTIONAL_OF_SIGN_IN = (
    *("client_id", "client_id_file", "client_secret", "pages", "by_id_token"),
    *("username_claim", "groups_claim", "scopes", "authorities"),
)


@dataclass(frozen=True)
class PoseSource:
    """The source of poses: the broker, and the topic of an agent's."""

    broker: BrokerAccount
    topic: str


@dataclass(frozen=True)
class ConsoleConfiguration:
    """Everything the process needs, secrets included. Without `sign_in` everybody who reaches it reads, with
    `by_forward` nobody but who may forward ports to its pod reaches it; without `poses` the map has none. `hosts`:
    names by which browsers reach it; `proxies`: whose word counts for who asks; `client_id_file`: has the client id
    where `sign_in` has none; `gate`, `certificates`: addresses of the pages of gate and process certificates, empty
    where they are not read; `writers`: who may ask for tasks; `authorities`: files with those that may have signed
    certificates of managers, of the gate, and of the provider, besides the usual ones."""

    listen: files.Listen
    log_level: str
    namespace: str
    argocd_namespace: str
    agents: tuple[Mapping[str, Any], ...]
    managers: tuple[ManagerPages, ...]
    hosts: frozenset[str]
    proxies: tuple[str, ...]
    links: Mapping[str, str]
    page: Path | None
    poses: PoseSource | None
    sign_in: SignIn | None
    writers: tuple[Writers, ...]
    authorities: tuple[Path, ...] = ()
    client_id_file: Path | None = None
    by_forward: bool = False
    gate: str = ""
    certificates: str = ""

    @property
    def address(self) -> str:
        """The address of the page: with `by_forward` at the pod's own loopback address, which a forward of the API
        server's reaches and no network."""
        return LOOPBACK if self.by_forward else self.listen.address

    def who_signs_in(self) -> str:
        """A sentence that says whether people sign in, and whether they can by now."""
        file = self.client_id_file
        if self.by_forward:
            return "nobody: who may forward ports to its pod reads"
        if self.sign_in is None:
            return "nobody: everybody who reaches it reads"
        return "by the provider" if file is None or file.exists() else f"by the provider, once {file} is there"


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> ConsoleConfiguration:
    """The settings document of the console."""
    required = ["listen", "log_level", "namespaces", "agents", "managers", "hosts"]
    root = reader.mapping(
        document,
        "",
        required,
        [
            *("poses", "broker", "page", "links", "proxies", "sign_in", "anybody_reads", "by_forward", "authorities"),
            *("gate", "certificates"),
        ],
    )
    namespaces = reader.mapping(root.get("namespaces") or {}, "namespaces", ["platform", "argocd"])
    links = reader.mapping(root.get("links") or {}, "links", [], ["forge", "argocd"])
    page = root.get("page")
    return ConsoleConfiguration(
        listen=files.listen(reader, root.get("listen")),
        log_level=files.log_level(reader, root.get("log_level")),
        namespace=reader.word(namespaces.get("platform"), "namespaces.platform", NAME),
        argocd_namespace=reader.word(namespaces.get("argocd"), "namespaces.argocd", NAME),
        agents=tuple(_agents(reader, root.get("agents"))),
        managers=tuple(_managers(reader, root.get("managers"))),
        hosts=frozenset(_words(reader, root.get("hosts"), "hosts", HOST)),
        proxies=_words(reader, root.get("proxies") or [], "proxies", ADDRESSES),
        links={key: reader.word(links.get(key), f"links.{key}", HTTP_URL, default="") for key in ("forge", "argocd")},
        page=None if page is None else Path(reader.word(page, "page", files.PATH)),
        poses=_poses(reader, root),
        sign_in=_sign_in(reader, root),
        authorities=_authorities(reader, root),
        writers=tuple(_writers(reader, root.get("sign_in"))),
        client_id_file=_client_id_file(reader, root.get("sign_in")),
        by_forward=_by_forward(reader, root),
        gate=_url(reader, root, "gate"),
        certificates=_url(reader, root, "certificates"),
    )


def _url(reader: Reader, root: Mapping[str, Any], key: str) -> str:
    """The address of a process's pages; empty where there is none."""
    if root.get(key) is None:
        return ""
    given = reader.mapping(root[key], key, ["url"])
    return reader.word(given.get("url"), f"{key}.url", HTTP_URL)


def _agents(reader: Reader, value: Any) -> Sequence[Mapping[str, Any]]:
    agents = []
    for index, item in enumerate(reader.sequence(value, "agents")):
        name, role, namespace = read_declared(reader, item, f"agents[{index}]")
        records = isinstance(item, Mapping) and bool(item.get("records"))
        agents.append({"name": name, "role": role, "namespace": namespace, "records": records})
    return agents


def _managers(reader: Reader, value: Any) -> Sequence[ManagerPages]:
    managers = []
    for index, item in enumerate(reader.sequence(value, "managers")):
        path = f"managers[{index}]"
        manager = reader.mapping(item, path, ["name", "url"], ["namespaces"])
        name = reader.word(manager.get("name"), f"{path}.name", NAME)
        url = reader.word(manager.get("url"), f"{path}.url", HTTP_URL)
        namespaces = _words(reader, manager.get("namespaces") or [ALL], f"{path}.namespaces", NAME_OR_ALL)
        managers.append(ManagerPages(name, url, frozenset(namespaces)))
    return managers


def _poses(reader: Reader, root: Mapping[str, Any]) -> PoseSource | None:
    if root.get("poses") is None:
        return None
    poses = reader.mapping(root["poses"], "poses", ["topic"])
    topic = reader.word(poses.get("topic"), "poses.topic", AGENTS_MQTT_TOPIC)
    if topic.split("/").count(MARK) != 1:
        reader.problems.append(f"poses.topic: must have {MARK} as one of its levels, such as mqtt/vehicles/{MARK}/pose")
    return PoseSource(read_broker(reader, root.get("broker")), topic)


def _by_forward(reader: Reader, root: Mapping[str, Any]) -> bool:
    given = root.get("by_forward", False)
    if given not in (True, False):
        reader.problems.append(f"by_forward: {given!r} must be true or false")
    others = [key for key in ("sign_in", "anybody_reads") if root.get(key)]
    if given is True and others:
        reader.problems.append(f"by_forward: is true, and {others[0]} says that others read; take out one of the two")
    return given is True


def _sign_in(reader: Reader, root: Mapping[str, Any]) -> SignIn | None:
    value = root.get("sign_in")
    if value is None:
        if root.get("anybody_reads") is not True and root.get("by_forward") is not True:
            reader.problems.append(
                "sign_in: missing; or say that everybody who reaches it reads (anybody_reads: true), or who may "
                "forward ports to it (by_forward: true)"
            )
        return None
    required = ["issuer", "url", "groups"]
    given = reader.mapping(value, "sign_in", required, [*OPTIONAL_OF_SIGN_IN, "writers"])
    groups = _words(reader, given.get("groups"), "sign_in.groups", TEXT)
    if not groups:
        reader.problems.append("sign_in.groups: must name one group or more, such as robotkube or robotkube:Owners")
    secret = given.get("client_secret")
    return SignIn(
        issuer=reader.word(given.get("issuer"), "sign_in.issuer", HTTP_URL),
        client_id=_client_id(reader, given),
        client_secret="" if secret is None else files.secret(reader, secret, "sign_in.client_secret"),
        url=reader.word(given.get("url"), "sign_in.url", HTTP_URL),
        groups=frozenset(groups),
        username_claim=reader.word(given.get("username_claim"), "sign_in.username_claim", WORD, "preferred_username"),
        groups_claim=reader.word(given.get("groups_claim"), "sign_in.groups_claim", WORD, "groups"),
        scopes=_words(reader, given.get("scopes") or SCOPES, "sign_in.scopes", SCOPE),
        pages=reader.word(given.get("pages"), "sign_in.pages", HTTP_URL, default=""),
        by_id_token="by_id_token" in given and reader.truth(given["by_id_token"], "sign_in.by_id_token"),
    )


def _client_id(reader: Reader, given: Mapping[str, Any]) -> str:
    """The client's id, empty where a file has it."""
    if (given.get("client_id") is None) == (given.get("client_id_file") is None):
        reader.problems.append("sign_in: needs one of client_id and client_id_file, the file that will have it")
        return ""
    return reader.word(given.get("client_id"), "sign_in.client_id", WORD, default="")


def _client_id_file(reader: Reader, sign_in: Any) -> Path | None:
    value = sign_in.get("client_id_file") if isinstance(sign_in, Mapping) else None
    return None if value is None else Path(reader.word(value, "sign_in.client_id_file", files.PATH))


def _writers(reader: Reader, sign_in: Any) -> Sequence[Writers]:
    """Who may ask for tasks, and where; nobody without sign-in."""
    value = sign_in.get("writers") if isinstance(sign_in, Mapping) else None
    writers = []
    for index, item in enumerate(reader.sequence(value, "sign_in.writers")):
        path = f"sign_in.writers[{index}]"
        given = reader.mapping(item, path, ["group", "namespaces"])
        group = reader.word(given.get("group"), f"{path}.group", GROUP)
        writers.append(Writers(group, frozenset(_words(reader, given.get("namespaces"), f"{path}.namespaces", NAME))))
    return writers


def _authorities(reader: Reader, root: Mapping[str, Any]) -> tuple[Path, ...]:
    sign_in = root.get("sign_in")
    files = [read_authorities(reader, root, "")]
    files += [read_authorities(reader, sign_in, "sign_in")] if isinstance(sign_in, Mapping) else []
    return tuple(file for file in files if file is not None)


def _words(reader: Reader, value: Any, path: str, pattern: re.Pattern[str]) -> tuple[str, ...]:
    items = enumerate(reader.sequence(value, path))
    return tuple(reader.word(item, f"{path}[{index}]", pattern) for index, item in items)
