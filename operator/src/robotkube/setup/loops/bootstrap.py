"""The steps that set up accounts, repositories and Argo CD's wiring: each reads first and changes what differs.

Running it twice changes nothing. It waits for forge, database and Argo CD together no longer than `wait_seconds`; steps
that fail for a passing reason are tried again within the same bound, all others end it with the error.
"""

from __future__ import annotations

import logging
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from robotkube.backoffs import Random, backoff
from robotkube.errors import UnavailableError
from robotkube.setup.ports import ArgoCDConfiguration, ClientIds, DatabaseAdministration, ForgeAdministration

RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX = 1.0, 2.0
LEVELS = ("read", "write")
PULLS = "pulls"
# What an access to a repository is in Gitea's units. Who sees pull requests alone can neither fetch, nor propose, which
# takes the code.
UNITS: Mapping[str, Mapping[str, str]] = {
    PULLS: {"repo.pulls": "read"},
    **{level: {"repo.code": level, "repo.pulls": level} for level in LEVELS},
}
HOOK_SECRET = "webhook.github.secret"  # noqa: S105 - the key; the gate sends hooks as GitHub does
TRUSTED_SERVERS = "argocd-tls-certs-cm"
# Argo CD takes the hooks of these forges unsigned while their keys have no value.
UNUSED_HOOKS = (
    "webhook.gitlab.secret",
    "webhook.gogs.secret",
    "webhook.bitbucket.uuid",
    "webhook.bitbucketserver.secret",
    "webhook.azuredevops.username",
    "webhook.azuredevops.password",
)

log = logging.getLogger(__name__)
T = TypeVar("T")


@dataclass(frozen=True)
class ForgeAccount:
    """An account of the forge."""

    name: str
    password: str


@dataclass(frozen=True)
class Organisation:
    """An organisation; `packages`: account -> read | write on its charts and images."""

    name: str
    packages: Mapping[str, str]


@dataclass(frozen=True)
class Repository:
    """A repository `<organisation>/<name>`. `seed`: path -> content of the first commit, used only when it is empty;
    `access`: account -> pulls | read | write; `main`: who may push the branch and merge pull requests."""

    name: str
    description: str
    branch: str
    seed: Mapping[str, bytes]
    access: Mapping[str, str]
    main: tuple[str, ...]

    @property
    def organisation(self) -> str:
        """The part before the slash."""
        return self.name.partition("/")[0]


@dataclass(frozen=True)
class Webhook:
    """Deliveries of `repository`'s events to `url`, signed with `secret`."""

    repository: str
    url: str
    events: tuple[str, ...]
    secret: str


@dataclass(frozen=True)
class FormerWebhook:
    """Deliveries of `repository`'s events to a `url` at which nobody answers any more."""

    repository: str
    url: str


@dataclass(frozen=True)
class ForgeSetup:
    """What the forge has to hold, and `former_webhooks` that it must not."""

    accounts: tuple[ForgeAccount, ...]
    organisations: tuple[Organisation, ...]
    repositories: tuple[Repository, ...]
    webhooks: tuple[Webhook, ...]
    former_webhooks: tuple[FormerWebhook, ...] = ()


@dataclass(frozen=True)
class SignInClient:
    """A client of the forge by which people sign in at a process: they are sent back to `redirect`, and the process
    reads the client's id from a ConfigMap."""

    name: str
    redirect: str
    namespace: str
    config_map: str


@dataclass(frozen=True)
class DatabaseAccount:
    """An account that may read and write `database` and nothing else; it is kept in that database."""

    database: str
    username: str
    password: str


@dataclass(frozen=True)
class ArgoCDSetup:
    """Argo CD's side: `account` may log in with `password` and do what `rbac` (policy lines) says; `hook_secret` signs
    push hooks; AppProject `closed_project` allows nothing; certificates of the servers in `trusted` hold when the
    authorities there (PEM) signed them. Deployments `trust_readers` restart when these change, and after them
    `hook_readers`, also when secrets of hooks change."""

    account: str
    password: str
    rbac: str
    hook_secret: str
    closed_project: str
    hook_readers: tuple[str, ...]
    trusted: Mapping[str, str] = field(default_factory=dict)
    trust_readers: tuple[str, ...] = ()


@dataclass(frozen=True)
class Team:
    """Accounts of an organisation with the same access: `units` (Gitea's names) to one repository, or packages."""

    organisation: str
    name: str
    units: Mapping[str, str]
    members: frozenset[str]
    repository: str = ""


def plan_teams(setup: ForgeSetup) -> tuple[Team, ...]:
    """The fewest rights that give `access` and `packages`: a team per repository and level, per organisation
    of packages and level."""
    teams: list[Team] = []
    for repository in setup.repositories:
        short = repository.name.partition("/")[2]
        for level, units in UNITS.items():
            members = _accounts(repository.access, level)
            teams.append(Team(repository.organisation, f"{short}-{level}", units, members, repository.name))
    for organisation in setup.organisations:
        for level in LEVELS:
            members = _accounts(organisation.packages, level)
            teams.append(Team(organisation.name, f"packages-{level}", {"repo.packages": level}, members))
    return tuple(team for team in teams if team.members)


def _accounts(access: Mapping[str, str], level: str) -> frozenset[str]:
    return frozenset(account for account, given in access.items() if given == level)


class Bootstrap:
    """A run of the steps. `monotonic` is a clock in seconds, `sleep` waits that many seconds; both are given for
    tests."""

    def __init__(
        self,
        wait_seconds: float,
        monotonic: Callable[[], float],
        sleep: Callable[[float], None],
        jitter: Random = random.random,
    ) -> None:
        self._monotonic = monotonic
        self._sleep = sleep
        self._jitter = jitter
        self._end = monotonic() + wait_seconds
        self.changed: list[str] = []

    def _step(self, what: str, make: Callable[[], bool]) -> None:
        """One step; UnavailableError is met again until the bound is over."""
        attempts = 0
        while True:
            try:
                changed = make()
                break
            except UnavailableError as error:
                if self._monotonic() >= self._end:
                    raise
                log.warning("waiting step=%r reason=%s", what, error)
                pause = backoff(attempts, RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX, self._jitter)
                self._sleep(min(pause, self._end - self._monotonic()))
                attempts += 1
        if changed:
            self.changed.append(what)
        log.info("step done step=%r changed=%s", what, str(changed).lower())

    def forge(self, setup: ForgeSetup, forge: ForgeAdministration) -> None:
        """Accounts, organisations, repositories with their seed, teams, protection, webhooks, in that order; webhooks
        to former addresses go when those to today's are there."""
        self._step("forge answers", forge.answers)
        for account in setup.accounts:
            self._step(f"account {account.name}", lambda a=account: forge.make_account(a.name, a.password))  # type: ignore[misc]
        for organisation in setup.organisations:
            self._step(f"organisation {organisation.name}", lambda o=organisation: forge.make_organisation(o.name))  # type: ignore[misc]
        for repository in setup.repositories:
            self._repository(repository, forge)
        for team in plan_teams(setup):
            self._step(f"team {team.organisation}/{team.name}", lambda t=team: _make_team(forge, t))  # type: ignore[misc]
        for repository in setup.repositories:  # after the teams: Gitea drops accounts without write from the list
            self._step(
                f"protection of {repository.name}",
                lambda r=repository: forge.protect(r.name, r.branch, r.main),  # type: ignore[misc]
            )
        for hook in setup.webhooks:
            self._step(
                f"webhook {hook.repository} to {hook.url}",
                lambda h=hook: forge.make_webhook(h.repository, h.url, h.events, h.secret),  # type: ignore[misc]
            )
        for former in setup.former_webhooks:
            self._step(
                f"no webhook {former.repository} to {former.url}",
                lambda f=former: forge.remove_webhook(f.repository, f.url),  # type: ignore[misc]
            )

    def _repository(self, repository: Repository, forge: ForgeAdministration) -> None:
        name = repository.name
        branch = repository.branch
        self._step(f"repository {name}", lambda: forge.make_repository(name, repository.description, branch))
        # Seeded before anybody else may write it.
        self._step(f"seed of {name}", lambda: forge.seed(name, branch, repository.seed))

    def sign_in(self, clients: Sequence[SignInClient], forge: ForgeAdministration, client_ids: ClientIds) -> None:
        """Clients by which people sign in, and their ids where processes read them."""
        for client in clients:
            self._step(
                f"client {client.name}",
                lambda c=client: forge.make_sign_in_client(c.name, c.redirect),  # type: ignore[misc]
            )
            self._step(
                f"client id in {client.namespace}/{client.config_map}",
                lambda c=client: client_ids.publish(c.namespace, c.config_map, forge.client_id(c.name)),  # type: ignore[misc]
            )

    def database(self, accounts: Sequence[DatabaseAccount], database: DatabaseAdministration) -> None:
        """One account per recording agent."""
        self._step("database answers", database.answers)
        for account in accounts:
            self._step(
                f"database account {account.username}",
                lambda a=account: database.make_account(a.database, a.username, a.password),  # type: ignore[misc]
            )

    def argocd(self, setup: ArgoCDSetup, argocd: ArgoCDConfiguration) -> None:
        """Authorities, account, rights, hook secrets, closed project. Last, when those who read authorities have
        them, the hooks' readers restart: an ApplicationSet that failed is generated again after three minutes, whatever
        hooks say meanwhile."""
        self._step("Argo CD answers", argocd.answers)
        if setup.trusted:
            self._step(TRUSTED_SERVERS, lambda: argocd.patch_config_map(TRUSTED_SERVERS, setup.trusted))
            # A kubelet brings them to a pod that runs within two minutes only.
            self._restart(setup.trust_readers, setup, argocd, hooks=False)
        login = {f"accounts.{setup.account}": "login"}
        self._step("argocd-cm", lambda: argocd.patch_config_map("argocd-cm", login))
        rights = {"policy.robotkube.csv": setup.rbac}
        self._step("argocd-rbac-cm", lambda: argocd.patch_config_map("argocd-rbac-cm", rights))
        self._step(f"password of {setup.account}", lambda: argocd.set_password(setup.account, setup.password))
        secrets = {HOOK_SECRET: setup.hook_secret}
        self._step("hook secrets", lambda: argocd.set_hook_secrets(secrets, UNUSED_HOOKS))
        self._step(f"project {setup.closed_project}", lambda: argocd.close_project(setup.closed_project))
        if setup.trusted:
            for reader in setup.trust_readers:
                self._step(f"deployment {reader} rolled out", lambda r=reader: argocd.rolled_out(r))  # type: ignore[misc]
        self._restart(setup.hook_readers, setup, argocd, hooks=True)

    def _restart(self, readers: Sequence[str], setup: ArgoCDSetup, argocd: ArgoCDConfiguration, hooks: bool) -> None:
        for reader in readers:
            self._step(
                f"deployment {reader}",
                lambda r=reader: argocd.restart_on_change(r, hooks, setup.trusted),  # type: ignore[misc]
            )


def _make_team(forge: ForgeAdministration, team: Team) -> bool:
    return forge.make_team(team.organisation, team.name, team.units, team.members, team.repository)
