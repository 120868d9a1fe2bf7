"""What the forge itself refuses: the manager proposes and nothing else, nobody passes the gate by."""

import secrets
import subprocess

import httpx
import pytest

from tests.stages.forge.gitea import HOOKS
from tests.stages.forge.installation import ACCOUNTS, Installation, message, release_files

pytestmark = pytest.mark.toolchain

REPOSITORIES = ("robotkube/deployment", "robotkube/catalogue")
RESERVED = ("refs/notes/robotkube", "refs/notes/commits", "refs/drafts/main", "refs/headed/main")


@pytest.mark.parametrize(
    ("reference", "force"),
    [
        ("refs/heads/main", False),
        ("refs/heads/main", True),
        ("refs/heads/feature", False),
        ("refs/tags/v1", False),
    ],
)
def test_the_manager_pushes_nothing(installation: Installation, reference: str, force: bool) -> None:
    manager, plan = installation.clone("manager"), installation.plan()
    commit = manager.commit(release_files(plan, "pushed"), message(plan), [manager.tip()])
    tip = manager.tip()
    assert manager.push(commit, reference, force=force) != ""
    assert manager.tip() == tip


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("POST", "/statuses/{commit}", {"state": "success", "context": "gate"}),
        ("PATCH", "/branch_protections/main", {"enable_push_whitelist": False}),
        ("DELETE", "/branch_protections/main", None),
        ("POST", "/branch_protections", {"rule_name": "*", "enable_push": True}),
        ("PUT", "/collaborators/manager", {"permission": "admin"}),
        ("POST", "/contents/x.txt", {"content": "eA==", "message": "x", "branch": "main"}),
        ("POST", "/hooks", {"type": "gitea", "config": {"url": "http://127.0.0.1:1", "content_type": "json"}}),
        ("DELETE", "", None),
    ],
)
def test_the_manager_has_no_other_way(
    installation: Installation, method: str, path: str, body: dict[str, object] | None
) -> None:
    commit = installation.clone("manager").tip()
    client = installation.client("manager")
    assert client.request(method, path.format(commit=commit), json=body).status_code in (403, 404)


def test_the_manager_does_not_merge(installation: Installation) -> None:
    manager, plan = installation.clone("manager"), installation.plan()
    commit = manager.commit(release_files(plan, "merged"), message(plan), [manager.tip()])
    number = installation.propose(manager, commit, plan)
    for way in ("rebase", "fast-forward-only", "manually-merged"):
        body = {"Do": way, "MergeCommitID": commit}
        assert installation.client("manager").post(f"/pulls/{number}/merge", json=body).status_code == 405
    installation.client("gate").patch(f"/pulls/{number}", json={"state": "closed"})
    assert not installation.pull_request(number)["merged"]


def test_the_gate_does_not_force_main(installation: Installation) -> None:
    gate = installation.clone("gate")
    tip = gate.tip()
    root = gate.repository[tip]
    while root.parents:
        root = root.parents[0]
    assert gate.push(str(root.id), "refs/heads/main", force=True) != "" or str(root.id) == tip
    assert gate.tip() == tip


@pytest.mark.parametrize("account", ["manager", "argocd", "publisher"])
def test_only_the_gate_pushes_main_of_the_deployment_repository(installation: Installation, account: str) -> None:
    gate, plan = installation.clone("gate"), installation.plan()
    tip = gate.tip()
    other = installation.clone(account) if account != "publisher" else gate
    if account == "publisher":  # it cannot even read it
        answer = installation.client("publisher").get("")
        assert answer.status_code == 404
        return
    commit = other.commit(release_files(plan, "direct"), message(plan), [other.tip()])
    assert other.push(commit, "refs/heads/main") != ""
    assert gate.tip() == tip


@pytest.mark.parametrize("account", ["manager", "publisher", "operator-team"])
@pytest.mark.parametrize("force", [False, True])
def test_only_the_gate_pushes_main_of_the_catalogue(installation: Installation, account: str, force: bool) -> None:
    clone = installation.clone(account, "robotkube/catalogue")
    tip = clone.tip()
    commit = clone.commit({"policies/release.yaml": "assurance: none\n"}, "mine\n", [tip])
    assert clone.push(commit, "refs/heads/main", force=force) != ""
    assert clone.tip() == tip


def test_the_publisher_proposes_to_the_catalogue_and_does_not_merge(installation: Installation) -> None:
    publisher = installation.clone("publisher", "robotkube/catalogue")
    commit = publisher.commit({"applications/mine.yaml": "mine\n"}, "submit\n", [publisher.tip()])
    assert publisher.push(commit, "refs/for/main", ["topic=submit-mine", "title=mine"]) == ""
    catalogue = f"{installation.url}/api/v1/repos/robotkube/catalogue"
    gate, own = (httpx.Client(base_url=catalogue, auth=(n, installation.passwords[n])) for n in ("gate", "publisher"))
    with gate, own:
        number = next(p["number"] for p in gate.get("/pulls").json() if p["head"]["sha"] == commit)
        for way in ("rebase", "fast-forward-only", "manually-merged"):
            body = {"Do": way, "MergeCommitID": commit}
            assert own.post(f"/pulls/{number}/merge", json=body).status_code == 405
        for method, path in (("PATCH", "/branch_protections/main"), ("POST", f"/statuses/{commit}")):
            assert own.request(method, path, json={"state": "success"}).status_code in (403, 404)
        gate.patch(f"/pulls/{number}", json={"state": "closed"}).raise_for_status()
        assert not gate.get(f"/pulls/{number}").json()["merged"]


def test_the_gate_does_not_force_main_of_the_catalogue(installation: Installation) -> None:
    gate = installation.clone("gate", "robotkube/catalogue")
    tip = gate.tip()
    other = gate.commit({"README.md": "another history\n"}, "anew\n", [tip])
    tree = gate.repository[other].tree.id
    who = gate.repository[tip].author
    root = str(gate.repository.create_commit(None, who, who, "anew\n", tree, []))
    assert gate.push(root, "refs/heads/main", force=True) != ""
    assert gate.tip() == tip


@pytest.mark.parametrize("repository", [*REPOSITORIES, "RobotKube/Deployment"])
@pytest.mark.parametrize("reference", RESERVED)
def test_a_person_writes_nothing_but_branches(installation: Installation, repository: str, reference: str) -> None:
    person = installation.clone("operator-team", repository)
    commit = person.commit({"README.md": reference}, "mine\n", [person.tip()])
    refused = person.push(commit, reference, force=True)
    assert f"{reference}: only the account gate writes notes, tags and whatever else is no branch" in refused
    assert "not operator-team; push a branch (refs/heads/<name>) or propose (refs/for/<branch>)" in refused
    branch = f"refs/heads/person-{secrets.token_hex(3)}"
    assert (person.push(commit, branch), person.delete(branch)) == ("", "")


@pytest.mark.parametrize("repository", REPOSITORIES)
def test_notes_and_tags_of_the_gate_stay(installation: Installation, repository: str) -> None:
    gate, person = (installation.clone(account, repository) for account in ("gate", "operator-team"))
    mine = person.commit({"README.md": "mine"}, "mine\n", [person.tip()])
    for reference in (f"refs/{kind}/reserved-{secrets.token_hex(3)}" for kind in ("notes", "tags")):
        assert gate.push(gate.tip(), reference) == ""
        assert person.push(mine, reference, force=True) != ""
        assert person.delete(reference) != ""
        assert gate.delete(reference) == ""  # it was there


def update_hook(reference: str, **environment: str) -> tuple[int, str]:
    """Exit code and words of the hook, where no program can be found that it could start."""
    given = {"PATH": "/nowhere", **environment}
    command = ["/bin/sh", str(HOOKS / "update"), reference, "0" * 40, "1" * 40]
    done = subprocess.run(command, env=given, capture_output=True, text=True, timeout=10, check=False)
    return done.returncode, done.stderr


def test_the_hook_starts_no_program_and_refuses_whom_it_does_not_know() -> None:
    person = {"GITEA_PUSHER_NAME": "operator-team"}
    for reference in ("refs/heads/main", "refs/heads/of/mine"):
        assert update_hook(reference, **person) == (0, "")
    for reference in (*RESERVED, "refs/tags/v1", "refs/heads", "refs/heads/", "refs/for", ""):
        assert update_hook(reference, GITEA_PUSHER_NAME="gate") == (0, "")
        for pusher in ("operator-team", "Gate", "gate ", ""):
            code, words = update_hook(reference, GITEA_PUSHER_NAME=pusher)
            assert (code, "only the account gate" in words) == (1, True), words
        code, words = update_hook(reference)
        assert (code, "not who pushes without a name;" in words) == (1, True), words
    for pusher in ("gate", "operator-team"):
        code, words = update_hook("refs/pull/1/head", GITEA_PUSHER_NAME=pusher)
        assert (code, "only the forge writes heads of pull requests" in words) == (1, True)
    assert update_hook("refs/pull/1/head", GITEA_INTERNAL_PUSH="true") == (0, "")


@pytest.mark.parametrize("account", ACCOUNTS)
def test_nobody_makes_repositories_or_organisations(installation: Installation, account: str) -> None:
    name = f"own-{secrets.token_hex(3)}"
    who = (account, installation.passwords[account])
    with httpx.Client(base_url=f"{installation.url}/api/v1", auth=who, timeout=30) as forge:
        for path, body in (
            ("/user/repos", {"name": name}),
            ("/orgs/robotkube/repos", {"name": name}),
            ("/repos/robotkube/deployment/forks", {"name": name}),
            ("/repos/robotkube/catalogue/forks", {"name": name}),
            ("/repos/migrate", {"repo_name": name, "clone_addr": f"{installation.url}/robotkube/catalogue.git"}),
            ("/orgs", {"username": name}),
        ):
            answer = forge.post(path, json=body)
            assert answer.status_code in (403, 404, 409, 422), (path, answer.status_code, answer.text)
        assert [
            repository["full_name"]
            for repository in forge.get("/user/repos").json()
            if repository["owner"]["login"] == account
        ] == []
        assert forge.get(f"/orgs/{name}").status_code == 404
