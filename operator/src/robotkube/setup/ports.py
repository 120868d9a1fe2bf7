"""The ports of what sets a platform up, tries it and takes it down, to forge, database, cluster and Argo CD: every
`make_*`, `patch_*`, `set_*` reads first and says whether it changed anything.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol


class ForgeAdministration(Protocol):
    """The forge as its administrator; UnavailableError when it does not answer, InputError when it refuses."""

    def answers(self) -> bool:
        """Check that it serves and knows the administrator: False (nothing changes), UnavailableError before."""
        ...

    def make_account(self, name: str, password: str) -> bool:
        """Make an account with that password."""
        ...

    def make_organisation(self, name: str) -> bool:
        """Make a private organisation."""
        ...

    def make_repository(self, repository: str, description: str, branch: str) -> bool:
        """Make a private, empty repository with pull requests."""
        ...

    def seed(self, repository: str, branch: str, files: Mapping[str, bytes]) -> bool:
        """Make the first commit, only when the repository is empty."""
        ...

    def protect(self, repository: str, branch: str, pushers: Sequence[str]) -> bool:
        """Protect the branch: only `pushers` push it, nobody by force, nobody else merges; only they make tags."""
        ...

    def make_team(
        self, organisation: str, team: str, units: Mapping[str, str], members: frozenset[str], repository: str
    ) -> bool:
        """Make a team with exactly these members and units; for one repository, or for none when it is empty."""
        ...

    def make_webhook(self, repository: str, url: str, events: Sequence[str], secret: str) -> bool:
        """Make a webhook with signed deliveries, one per repository and url."""
        ...

    def remove_webhook(self, repository: str, url: str) -> bool:
        """Remove the webhooks of a repository to `url`."""
        ...

    def make_sign_in_client(self, name: str, redirect: str) -> bool:
        """Make a public client of this name, which people sign in by with PKCE and are sent back to `redirect` from."""
        ...

    def client_id(self, name: str) -> str:
        """The id of the client of this name, which the forge has drawn; UnavailableError when there is none."""
        ...


class ClientIds(Protocol):
    """ConfigMaps from which processes read by which client people sign in; UnavailableError when one is not there, or
    the API server does not answer, InputError when it refuses."""

    def publish(self, namespace: str, config_map: str, client_id: str) -> bool:
        """Set the key `client_id` of a ConfigMap."""
        ...


class DatabaseAdministration(Protocol):
    """The database as its administrator."""

    def answers(self) -> bool:
        """Check that it serves and knows the administrator: False (nothing changes), UnavailableError before."""
        ...

    def make_account(self, database: str, username: str, password: str) -> bool:
        """Make an account of `database` with readWrite on it and nothing else."""
        ...


class ArgoCDConfiguration(Protocol):
    """Argo CD's own objects in its namespace; UnavailableError when they or the API server are not there yet."""

    def answers(self) -> bool:
        """Check that Argo CD has made its secret's server.secretkey: False (no change), UnavailableError before."""
        ...

    def patch_config_map(self, name: str, data: Mapping[str, str]) -> bool:
        """Set keys of a ConfigMap."""
        ...

    def set_hook_secrets(self, given: Mapping[str, str], unused: Sequence[str]) -> bool:
        """Set keys of argocd-secret; each of `unused` without a value gets a random one that nobody keeps."""
        ...

    def set_password(self, account: str, password: str) -> bool:
        """Set a local account's password unless the stored hash fits it."""
        ...

    def close_project(self, name: str) -> bool:
        """Make an AppProject allow nothing."""
        ...

    def restart_on_change(self, deployment: str, hooks: bool, trusted: Mapping[str, str]) -> bool:
        """Restart a Deployment when, and only when, `trusted` (server -> PEM, if any) or, with `hooks`, the secrets of
        hooks are not those it was last restarted for."""
        ...

    def rolled_out(self, deployment: str) -> bool:
        """Check that the pods of a Deployment are those it asks for now, and ready: False, UnavailableError before."""
        ...


class InstalledReleases(Protocol):
    """The releases that Argo CD installed from the deployment repository; UnavailableError when the API server does not
    answer."""

    def withdraw(self) -> bool:
        """Delete the ApplicationSet, and by that its Argo CD Applications; False when there was none."""
        ...

    def remaining(self) -> Sequence[str]:
        """Names of the Argo CD Applications that are still there."""
        ...


class GateKeyObjects(Protocol):
    """The Secret with the gate's key, which this side can make and not read, and the ConfigMaps with public keys.
    UnavailableError when the API server does not answer, InputError when it refuses."""

    def has_key(self) -> bool:
        """Return whether there is a Secret of that name, whatever is in it."""
        ...

    def public_keys(self) -> Mapping[str, Mapping[str, str]]:
        """Namespace -> the public keys of its ConfigMap by file name; none where there is no ConfigMap."""
        ...

    def publish(self, namespace: str, keys: Mapping[str, str]) -> None:
        """Add public keys to the namespace's ConfigMap, which is made when there is none."""
        ...

    def withdraw(self, namespace: str, name: str) -> None:
        """Take a public key out of the namespace's ConfigMap."""
        ...

    def keep(self, private_key: str) -> bool:
        """Make the Secret; False when somebody else has made it meanwhile."""
        ...


class AskedTask(Protocol):
    """The one task of an installation test. UnavailableError when the API server does not answer, InputError when it
    refuses."""

    def ask(self) -> None:
        """Make it."""
        ...

    def read(self) -> Mapping[str, Any] | None:
        """The object as it is now; None when it is gone."""
        ...

    def withdraw(self) -> None:
        """Delete it; nothing when it is gone."""
        ...


class RecordedEvents(Protocol):
    """What the database has of one recording; UnavailableError when it does not answer."""

    def answers(self) -> None:
        """Return when it serves and knows the account."""
        ...

    def messages(self) -> bool:
        """Return whether a message of the recording is stored."""
        ...

    def ended(self) -> bool:
        """Return whether the recording has its end."""
        ...
