"""The process that sets the platform up after install and upgrade: accounts, repositories, Argo CD's wiring.

Started by `robotkube-bootstrap`. Settings: docs/reference/settings.md. Exit code 0 when everything is as it
shall be, 2 when settings or answers are wrong, 3 when forge, database or Argo CD did not answer within the stated time.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from kubernetes import client
from kubernetes import config as kubernetes_config

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.certificate_authorities import trust
from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.foundation.certificates.settings import read_authorities, read_server_verification
from robotkube.foundation.database.adapters.accounts import MongoAccounts
from robotkube.foundation.documents.core.former_keys import FormerKey
from robotkube.foundation.documents.core.patterns import HTTP_URL, NAME, REPOSITORY, WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.process import Process, run
from robotkube.setup.adapters.argocd_configuration import KubernetesArgoCDConfiguration
from robotkube.setup.adapters.client_ids import ConfigMapClientIds
from robotkube.setup.adapters.gitea_administration import GiteaAdministration
from robotkube.setup.loops.bootstrap import (
    LEVELS,
    UNITS,
    ArgoCDSetup,
    Bootstrap,
    DatabaseAccount,
    ForgeAccount,
    ForgeSetup,
    FormerWebhook,
    Organisation,
    Repository,
    SignInClient,
    Webhook,
)

GRACE_SECONDS = 5.0
WAIT_SECONDS_MAX = 3600
DATABASE_KINDS = ("mongo", "ferretdb")
EVENTS = ("push", "pull_request", "pull_request_comment")
SEED_BYTES_MAX = 1024 * 1024
SEED_FILES_MAX = 500
FORMER_KEYS = (FormerKey("hook_reader", "hook_readers", "argocd", convert=lambda name: [name]),)


@dataclass(frozen=True)
class ForgeConfiguration:
    """The forge and who administers it; `clients` are those by which people sign in."""

    url: str
    authorities: Path | None
    administrator: files.Credentials
    setup: ForgeSetup
    clients: tuple[SignInClient, ...] = ()


@dataclass(frozen=True)
class DatabaseConfiguration:
    """The database and who administers it. `tls`: how it proves who it is; None: connections are in clear text."""

    host: str
    port: int
    administrator: files.Credentials
    accounts: tuple[DatabaseAccount, ...]
    tls: ServerVerification | None = None


@dataclass(frozen=True)
class BootstrapConfiguration:
    """The settings of the Job; a part that is None belongs to somebody else."""

    log_level: str
    wait_seconds: int
    forge: ForgeConfiguration | None
    database: DatabaseConfiguration | None
    argocd_namespace: str
    argocd: ArgoCDSetup


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> BootstrapConfiguration:
    """Read the settings document of the Job."""
    root = reader.mapping(document, "", ["log_level", "wait_seconds", "argocd"], ["forge", "database"])
    keys = ["namespace", "account", "rbac", "hook", "closed_project"]
    argocd = reader.mapping(root.get("argocd") or {}, "argocd", keys, ["hook_readers", "trust_readers"])
    return BootstrapConfiguration(
        log_level=files.log_level(reader, root.get("log_level")),
        wait_seconds=_whole(reader, root.get("wait_seconds"), "wait_seconds", WAIT_SECONDS_MAX),
        forge=_forge(reader, root["forge"]) if root.get("forge") else None,
        database=_database(reader, root["database"]) if root.get("database") else None,
        argocd_namespace=reader.word(argocd.get("namespace"), "argocd.namespace", WORD),
        argocd=_argocd(reader, argocd, _trusted(reader, root.get("forge") or {})),
    )


def _whole(reader: Reader, value: Any, path: str, largest: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 < value <= largest:
        reader.problems.append(f"{path}: must be a whole number from 1 to {largest}")
        return 1
    return value


def _trusted(reader: Reader, forge: Mapping[str, Any]) -> Mapping[str, str]:
    """The forge's name and the PEM of its authorities, where settings name them: what Argo CD has to know."""
    path = read_authorities(reader, forge, "forge")
    if path is None:
        return {}
    try:
        return {urlsplit(str(forge.get("url"))).hostname or "": path.read_text(encoding="ascii")}
    except (OSError, UnicodeDecodeError) as error:
        reader.problems.append(f"forge.authorities: {path} cannot be read: {error}; it is of ConfigMap robotkube-ca")
        return {}


def _argocd(reader: Reader, argocd: Mapping[str, Any], trusted: Mapping[str, str]) -> ArgoCDSetup:
    account = reader.mapping(argocd.get("account") or {}, "argocd.account", ["name", "credentials"])
    hook = reader.mapping(argocd.get("hook") or {}, "argocd.hook", ["secret"])
    return ArgoCDSetup(
        account=reader.word(account.get("name"), "argocd.account.name", WORD),
        password=files.credentials(reader, account.get("credentials"), "argocd.account.credentials").password,
        rbac=reader.prose(argocd.get("rbac"), "argocd.rbac"),
        hook_secret=files.secret(reader, hook.get("secret"), "argocd.hook.secret"),
        closed_project=reader.word(argocd.get("closed_project"), "argocd.closed_project", WORD),
        hook_readers=_hook_readers(reader, argocd),
        trusted=trusted,
        trust_readers=_deployments(reader, argocd, "trust_readers"),
    )


def _hook_readers(reader: Reader, argocd: Mapping[str, Any]) -> tuple[str, ...]:
    names = _deployments(reader, argocd, "hook_readers")
    if not names:
        reader.problems.append("argocd.hook_readers: must name what restarts on a new hook secret")
    return names


def _deployments(reader: Reader, argocd: Mapping[str, Any], key: str) -> tuple[str, ...]:
    path = f"argocd.{key}"
    return tuple(reader.word(name, path, WORD) for name in reader.sequence(argocd.get(key), path))


def _database(reader: Reader, value: Any) -> DatabaseConfiguration:
    values = reader.mapping(value, "database", ["kind", "host", "port", "administrator", "accounts"], ["authorities"])
    if values.get("kind") not in DATABASE_KINDS:
        reader.problems.append(f"database.kind: must be one of {', '.join(DATABASE_KINDS)}")
    host = reader.word(values.get("host"), "database.host", WORD)
    return DatabaseConfiguration(
        host=host,
        port=_whole(reader, values.get("port"), "database.port", files.PORT_MAX),
        administrator=files.credentials(reader, values.get("administrator"), "database.administrator"),
        accounts=tuple(_database_account(reader, *item) for item in _items(reader, values, "database", "accounts")),
        tls=read_server_verification(reader, values.get("authorities"), "database.authorities", host),
    )


def _items(reader: Reader, values: Mapping[str, Any], path: str, key: str) -> Iterable[tuple[Any, str]]:
    for index, item in enumerate(reader.sequence(values.get(key), f"{path}.{key}")):
        yield item, f"{path}.{key}[{index}]"


def _database_account(reader: Reader, value: Any, path: str) -> DatabaseAccount:
    values = reader.mapping(value, path, ["username", "database", "credentials"])
    account = files.credentials(reader, values.get("credentials"), f"{path}.credentials")
    username = reader.word(values.get("username"), f"{path}.username", WORD)
    if account.username and account.username != username:
        reader.problems.append(f"{path}.credentials: its username is {account.username!r}, the account is {username!r}")
    return DatabaseAccount(reader.word(values.get("database"), f"{path}.database", WORD), username, account.password)


def _forge(reader: Reader, value: Any) -> ForgeConfiguration:
    keys = ["url", "administrator", "accounts", "organisations", "repositories", "webhooks"]
    values = reader.mapping(value, "forge", keys, ["former_webhooks", "authorities", "sign_in_clients"])
    return ForgeConfiguration(
        url=reader.word(values.get("url"), "forge.url", HTTP_URL),
        authorities=read_authorities(reader, values, "forge"),
        administrator=files.credentials(reader, values.get("administrator"), "forge.administrator"),
        setup=ForgeSetup(
            accounts=tuple(_account(reader, *item) for item in _items(reader, values, "forge", "accounts")),
            organisations=tuple(_organisation(reader, *i) for i in _items(reader, values, "forge", "organisations")),
            repositories=tuple(_repository(reader, *i) for i in _items(reader, values, "forge", "repositories")),
            webhooks=tuple(_webhook(reader, *item) for item in _items(reader, values, "forge", "webhooks")),
            former_webhooks=_former_webhooks(reader, values) if "former_webhooks" in values else (),
        ),
        clients=tuple(_sign_in_client(reader, *i) for i in _items(reader, values, "forge", "sign_in_clients")),
    )


def _account(reader: Reader, value: Any, path: str) -> ForgeAccount:
    values = reader.mapping(value, path, ["name", "credentials"])
    name = reader.word(values.get("name"), f"{path}.name", WORD)
    return ForgeAccount(name, files.credentials(reader, values.get("credentials"), f"{path}.credentials").password)


def _organisation(reader: Reader, value: Any, path: str) -> Organisation:
    values = reader.mapping(value, path, ["name", "packages"])
    name = reader.word(values.get("name"), f"{path}.name", WORD)
    return Organisation(name, _access(reader, values.get("packages"), f"{path}.packages", LEVELS))


def _access(reader: Reader, value: Any, path: str, levels: Sequence[str]) -> Mapping[str, str]:
    words = " or ".join([", ".join(levels[:-1]), levels[-1]])
    if not isinstance(value, Mapping):
        reader.problems.append(f"{path}: must be a mapping of accounts to {words}")
        return {}
    reader.problems += [f"{path}.{name}: must be {words}" for name, level in value.items() if level not in levels]
    return value


def _repository(reader: Reader, value: Any, path: str) -> Repository:
    values = reader.mapping(value, path, ["name", "description", "branch", "seed", "access", "main"])
    return Repository(
        name=reader.word(values.get("name"), f"{path}.name", REPOSITORY),
        description=reader.prose(values.get("description"), f"{path}.description"),
        branch=reader.word(values.get("branch"), f"{path}.branch", WORD),
        seed=_seed(reader, reader.word(values.get("seed"), f"{path}.seed", files.PATH), f"{path}.seed"),
        access=_access(reader, values.get("access"), f"{path}.access", tuple(UNITS)),
        main=tuple(
            reader.word(item, f"{path}.main", WORD) for item in reader.sequence(values.get("main"), f"{path}.main")
        ),
    )


def _seed(reader: Reader, folder: str, path: str) -> Mapping[str, bytes]:
    """Every file below the folder by its relative path; what a mounted volume keeps for itself (..data) is left out."""
    root = Path(folder)
    if not folder or not root.is_dir():
        reader.problems.append(f"{path}: {folder!r} is not a folder")
        return {}
    contents: dict[str, bytes] = {}
    for file in sorted(root.rglob("*")):
        relative = file.relative_to(root)
        if file.is_file() and not any(part.startswith("..") for part in relative.parts):
            contents[relative.as_posix()] = file.read_bytes()
    if len(contents) > SEED_FILES_MAX or sum(map(len, contents.values())) > SEED_BYTES_MAX:
        reader.problems.append(f"{path}: {folder} holds more than {SEED_FILES_MAX} files or {SEED_BYTES_MAX} bytes")
    return contents


def _webhook(reader: Reader, value: Any, path: str) -> Webhook:
    values = reader.mapping(value, path, ["repository", "url", "events", "secret"])
    events = tuple(str(event) for event in reader.sequence(values.get("events"), f"{path}.events"))
    reader.problems += [f"{path}.events: {e!r} must be one of {', '.join(EVENTS)}" for e in events if e not in EVENTS]
    return Webhook(
        repository=reader.word(values.get("repository"), f"{path}.repository", REPOSITORY),
        url=reader.word(values.get("url"), f"{path}.url", HTTP_URL),
        events=events,
        secret=files.secret(reader, values.get("secret"), f"{path}.secret"),
    )


def _former_webhooks(reader: Reader, values: Mapping[str, Any]) -> tuple[FormerWebhook, ...]:
    former = []
    for item, path in _items(reader, values, "forge", "former_webhooks"):
        hook = reader.mapping(item, path, ["repository", "url"])
        repository = reader.word(hook.get("repository"), f"{path}.repository", REPOSITORY)
        former.append(FormerWebhook(repository, reader.word(hook.get("url"), f"{path}.url", HTTP_URL)))
    return tuple(former)


def _sign_in_client(reader: Reader, value: Any, path: str) -> SignInClient:
    values = reader.mapping(value, path, ["name", "redirect", "config_map"])
    place = reader.mapping(values.get("config_map") or {}, f"{path}.config_map", ["namespace", "name"])
    return SignInClient(
        name=reader.word(values.get("name"), f"{path}.name", WORD),
        redirect=reader.word(values.get("redirect"), f"{path}.redirect", HTTP_URL),
        namespace=reader.word(place.get("namespace"), f"{path}.config_map.namespace", NAME),
        config_map=reader.word(place.get("name"), f"{path}.config_map.name", NAME),
    )


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """All parts of the set-up, one after the other, within one bound."""
    configuration = files.start_with_settings(process, read_configuration, environment, FORMER_KEYS)

    def sleep(seconds: float) -> None:
        if process.stopping.wait(seconds):
            raise InputError("ended by a signal before everything was made; run the Job again")

    bootstrap = Bootstrap(configuration.wait_seconds, time.monotonic, sleep)
    if configuration.forge:
        trust(configuration.forge.authorities)
        administrator = configuration.forge.administrator
        forge = GiteaAdministration(configuration.forge.url, administrator.username, administrator.password)
        bootstrap.forge(configuration.forge.setup, forge)
        if configuration.forge.clients:
            client_ids = ConfigMapClientIds(_api_client(environment))
            bootstrap.sign_in(configuration.forge.clients, forge, client_ids)
    if configuration.database:
        settings = configuration.database
        account = settings.administrator
        database = MongoAccounts(settings.host, settings.port, account.username, account.password, settings.tls)
        bootstrap.database(settings.accounts, database)
    argocd = KubernetesArgoCDConfiguration(_api_client(environment), configuration.argocd_namespace)
    bootstrap.argocd(configuration.argocd, argocd)
    process.log("everything is made", changed=len(bootstrap.changed))


def _api_client(environment: Mapping[str, str]) -> client.ApiClient:
    """A client with the pod's ServiceAccount; outside a cluster with the file in KUBECONFIG."""
    try:
        if environment.get("KUBERNETES_SERVICE_HOST"):
            kubernetes_config.load_incluster_config()
        else:
            kubernetes_config.load_kube_config(environment.get("KUBECONFIG"))
    except kubernetes_config.ConfigException as error:
        raise InputError(f"no way to the API server: {error}; give the pod a token, or set KUBECONFIG") from error
    return client.ApiClient()


def main() -> None:
    """Run until SIGTERM or the end of the work; exit codes as in `foundation.runtime.process`."""
    run("bootstrap", body, grace_seconds=GRACE_SECONDS)


if __name__ == "__main__":
    main()
