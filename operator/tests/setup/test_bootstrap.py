"""The bootstrap on a real forge: twice without a change, changed passwords, killed half-way, refusals."""

import secrets
import time
from dataclasses import replace
from pathlib import Path

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.setup.adapters.gitea_administration import GiteaAdministration
from robotkube.setup.loops.bootstrap import Bootstrap, FormerWebhook, Repository, SignInClient, plan_teams
from tests.stages import http_calls
from tests.stages.forge.gitea import ForgeProcess
from tests.stages.forge.installation import ACCOUNTS, CATALOGUE, Installation, forge_setup

pytestmark = pytest.mark.toolchain


def bootstrap() -> Bootstrap:
    return Bootstrap(30, time.monotonic, time.sleep)


def test_the_second_run_changes_nothing(installation: Installation, administration: GiteaAdministration) -> None:
    run = bootstrap()
    run.forge(installation.setup, administration)
    assert run.changed == []


def test_a_changed_password_is_set(installation: Installation, administration: GiteaAdministration) -> None:
    new = secrets.token_hex(12)
    accounts = tuple(replace(a, password=new) if a.name == "argocd" else a for a in installation.setup.accounts)
    run = bootstrap()
    run.forge(replace(installation.setup, accounts=accounts), administration)
    assert run.changed == ["account argocd"]
    assert http_calls.get(f"{installation.url}/api/v1/user", auth=("argocd", new)).status_code == 200
    back = bootstrap()
    back.forge(installation.setup, administration)
    assert back.changed == ["account argocd"]


def test_tags_become_the_gates_where_only_the_administrator_made_them(
    installation: Installation, forge_process: ForgeProcess, administration: GiteaAdministration
) -> None:
    owner = (forge_process.administrator, forge_process.administrator_password)
    path = f"{installation.url}/api/v1/repos/robotkube/catalogue/tag_protections"
    [rule] = http_calls.get(path, auth=owner).json()
    former = {"whitelist_usernames": [forge_process.administrator]}
    assert http_calls.patch(f"{path}/{rule['id']}", json=former, auth=owner).status_code == 200
    run = bootstrap()
    run.forge(installation.setup, administration)
    assert run.changed == ["protection of robotkube/catalogue"]
    assert http_calls.get(path, auth=owner).json()[0]["whitelist_usernames"] == ["gate"]


def test_access_that_is_taken_back_is_gone(installation: Installation, administration: GiteaAdministration) -> None:
    deployment, catalogue = installation.setup.repositories
    access = {**catalogue.access, "argocd": "read", "publisher": "write"}
    wider = replace(installation.setup, repositories=(deployment, replace(catalogue, access=access)))
    given, withdrawn = bootstrap(), bootstrap()
    given.forge(wider, administration)
    assert given.changed == ["team robotkube/catalogue-read", "team robotkube/catalogue-write"]
    withdrawn.forge(installation.setup, administration)
    assert withdrawn.changed == given.changed


def test_a_webhook_to_where_nobody_answers_any_more_goes_and_others_stay(
    installation: Installation, administration: GiteaAdministration
) -> None:
    repository, former = "robotkube/deployment", "http://127.0.0.1:9/former"
    for url in (former, "http://127.0.0.1:9/of-a-person"):
        administration.make_webhook(repository, url, ("push",), "s")
    setup = replace(installation.setup, former_webhooks=(FormerWebhook(repository, former),))
    run, again = bootstrap(), bootstrap()
    run.forge(setup, administration)
    again.forge(setup, administration)
    assert (run.changed, again.changed) == ([f"no webhook {repository} to {former}"], [])
    assert administration.remove_webhook(repository, "http://127.0.0.1:9/of-a-person")


def test_the_seed_is_the_first_commit_and_never_comes_again(installation: Installation) -> None:
    clone = installation.clone("manager", "robotkube/catalogue")
    commit = clone.repository[clone.tip()]
    while commit.parents:
        commit = commit.parents[0]
    assert {entry.name for entry in commit.tree} == {path.split("/")[0] for path in CATALOGUE}
    assert commit.author.name == "administrator"
    assert commit.message.startswith("Begin this repository")


def test_a_run_that_was_killed_is_finished_by_the_next(tmp_path: Path) -> None:
    """Each step is cut off once, on a forge of its own; the next run makes what is missing."""
    process = ForgeProcess(tmp_path / "forge")
    process.start()
    administration = GiteaAdministration(process.url, process.administrator, process.administrator_password)
    setup = forge_setup({name: secrets.token_hex(12) for name in ACCOUNTS}, "http://127.0.0.1:9/webhook")
    try:
        for method in ("make_account", "make_repository", "seed", "protect", "make_team", "make_webhook"):
            broken = Broken(administration, method)
            with pytest.raises(InputError, match="cut off"):
                bootstrap().forge(setup, broken)  # type: ignore[arg-type]
        last = bootstrap()
        last.forge(setup, administration)
        assert last.changed
        again = bootstrap()
        again.forge(setup, administration)
        assert again.changed == []
    finally:
        administration.disconnect()
        process.remove()


class Broken:
    """An administration that ends after the first call of one method."""

    def __init__(self, real: GiteaAdministration, method: str) -> None:
        self._real, self._method = real, method

    def __getattr__(self, name: str) -> object:
        method = getattr(self._real, name)
        if name != self._method:
            return method

        def once(*arguments: object) -> None:
            method(*arguments)
            raise InputError("cut off")

        return once


class KeptClientIds:
    """The port ClientIds in memory."""

    def __init__(self) -> None:
        self.ids: dict[str, str] = {}

    def publish(self, namespace: str, config_map: str, client_id: str) -> bool:
        before = self.ids.get(f"{namespace}/{config_map}")
        self.ids[f"{namespace}/{config_map}"] = client_id
        return before != client_id


def test_clients_by_which_people_sign_in_are_made_once(administration: GiteaAdministration) -> None:
    kept = KeptClientIds()
    clients = [SignInClient(name, f"https://{name}.example", "p", name) for name in ("a", "b")]
    first, again, moved = bootstrap(), bootstrap(), bootstrap()
    first.sign_in(clients, administration, kept)
    assert first.changed == ["client a", "client id in p/a", "client b", "client id in p/b"]
    ids = dict(kept.ids)
    assert ids["p/a"] != ids["p/b"]
    again.sign_in(clients, administration, kept)
    moved.sign_in([replace(clients[0], redirect="https://moved.example")], administration, kept)
    assert (again.changed, moved.changed, kept.ids) == ([], ["client a"], ids)


def test_of_several_clients_of_a_name_the_first_counts(
    administration: GiteaAdministration, forge_process: ForgeProcess
) -> None:
    """As somebody may make them, by the administrator's account."""
    assert administration.make_sign_in_client("twice", "https://first.example")
    first = administration.client_id("twice")
    path = f"{forge_process.url}/api/v1/user/applications/oauth2"
    other = {"name": "twice", "redirect_uris": ["https://other.example"], "confidential_client": True}
    owner = (forge_process.administrator, forge_process.administrator_password)
    assert http_calls.post(path, json=other, auth=owner).status_code == 201
    assert not administration.make_sign_in_client("twice", "https://first.example")
    assert administration.client_id("twice") == first


def test_a_client_that_went_meanwhile_is_made_at_the_next_run(administration: GiteaAdministration) -> None:
    with pytest.raises(UnavailableError, match="no OAuth2 application 'gone' any more"):
        administration.client_id("gone")


def test_a_forge_that_never_answers_ends_the_run_within_the_bound() -> None:
    now = [0.0]

    def sleep(seconds: float) -> None:
        now[0] += seconds

    administration = GiteaAdministration("http://127.0.0.1:9", "administrator", "x")
    run = Bootstrap(5, lambda: now[0], sleep, jitter=lambda: 0.75)  # 0.75 s, then 1.5 s: the bound cuts the last wait
    with pytest.raises(UnavailableError, match=r"http://127.0.0.1:9"):
        run.forge(forge_setup(dict.fromkeys(ACCOUNTS, "x"), "http://127.0.0.1:9/webhook"), administration)
    administration.disconnect()
    assert now[0] == 5


def test_an_empty_seed_is_refused(installation: Installation, administration: GiteaAdministration) -> None:
    empty = Repository("staging/empty", "", "main", {}, {"publisher": "read"}, ("publisher",))
    setup = replace(installation.setup, repositories=(empty,), webhooks=())
    with pytest.raises(InputError, match="seed of staging/empty: the folder holds no files"):
        bootstrap().forge(setup, administration)


def test_teams_give_the_fewest_rights(installation: Installation) -> None:
    teams = {f"{team.organisation}/{team.name}": team for team in plan_teams(installation.setup)}
    assert teams["robotkube/deployment-read"].members == {"manager", "argocd"}
    assert teams["robotkube/deployment-write"].members == {"gate", "operator-team", "reviewer"}
    assert teams["robotkube/deployment-pulls"].members == {"viewer"}
    assert teams["robotkube/deployment-pulls"].units == {"repo.pulls": "read"}
    assert teams["robotkube/catalogue-read"].members == {"manager", "publisher"}
    assert teams["robotkube/catalogue-write"].members == {"gate", "operator-team", "reviewer"}
    assert teams["robotkube/packages-write"].members == {"image-publisher"}
    assert teams["staging-publisher/packages-write"].members == {"publisher"}
    assert teams["staging/packages-write"].members == {"gate"}
    assert teams["staging/packages-write"].units == {"repo.packages": "write"}
    assert teams["verified/packages-write"].members == {"gate"}
    assert teams["verified/packages-read"].members == {"manager", "argocd", "suite-runner", "inspector"}
