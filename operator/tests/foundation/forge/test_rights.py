"""What the forge itself refuses: the manager proposes and nothing else, nobody passes the gate by."""

import secrets
import subprocess
from contextlib import closing

import httpx
import pytest

from tests.stages import http_calls
from tests.stages.attacks import shown
from tests.stages.forge.gitea import HOOKS
from tests.stages.forge.installation import ACCOUNTS, VIEWER, Installation, message, release_files
from tests.stages.waiting import until

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
    manager = installation.clone("manager")
    plan = installation.plan()
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
    manager = installation.clone("manager")
    plan = installation.plan()
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
    gate = installation.clone("gate")
    plan = installation.plan()
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
    gate, own = (
        http_calls.client(base_url=catalogue, auth=(n, installation.passwords[n])) for n in ("gate", "publisher")
    )
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


def open_change(installation: Installation, repository: str) -> tuple[httpx.Client, int, str]:
    """A person's connection to the API, and an open pull request of theirs that another person approved."""
    person = installation.clone("operator-team", repository)
    topic = f"mine-{secrets.token_hex(3)}"
    commit = person.commit({"README.md": f"{topic}\n"}, "mine\n", [person.tip()])
    assert person.push(commit, "refs/for/main", [f"topic={topic}", "title=mine"]) == ""
    base = f"{installation.url}/api/v1/repos/{repository}"
    own, other = (
        http_calls.client(base_url=base, auth=(name, installation.passwords[name]), timeout=30)
        for name in ("operator-team", "reviewer")
    )
    with other:
        number = next(int(pull["number"]) for pull in other.get("/pulls").json() if pull["head"]["sha"] == commit)
        review = {"event": "APPROVED", "commit_id": commit, "body": "seen"}
        assert other.post(f"/pulls/{number}/reviews", json=review).status_code == 200
    return own, number, commit


@pytest.mark.parametrize("repository", REPOSITORIES)
def test_nobody_merges_in_the_forge(installation: Installation, repository: str) -> None:
    """Not its author, not who approved it, not by the page's button, and not later by the forge itself."""
    own, number, commit = open_change(installation, repository)
    tip = installation.clone("gate", repository).tip()
    with own:
        until(lambda: own.get(f"/pulls/{number}").json()["mergeable"], "looked for conflicts")
        for account in ("operator-team", "reviewer"):
            own.auth = httpx.BasicAuth(account, installation.passwords[account])
            for style in ("fast-forward-only", "rebase", "rebase-merge", "merge", "squash", "manually-merged"):
                for more in ({}, {"force_merge": True}, {"merge_when_checks_succeed": True}):
                    body = {"Do": style, "MergeCommitID": commit, **more}
                    answer = own.post(f"/pulls/{number}/merge", json=body)
                    assert answer.status_code in (403, 405, 409), (style, more, answer.status_code, answer.text)
            with closing(page_of(installation, account)) as page:
                answer = page.post(f"/{repository}/pulls/{number}/merge", data={"do": "fast-forward-only"})
                assert (answer.status_code, "You are not allowed to update branch" in answer.text) == (400, True)
        assert own.patch(f"/pulls/{number}", json={"state": "closed"}).status_code == 201
        assert not own.get(f"/pulls/{number}").json()["merged"]
    assert installation.clone("gate", repository).tip() == tip


def page_of(installation: Installation, account: str) -> httpx.Client:
    """The forge's pages as somebody uses them who has logged in."""
    page = http_calls.client(base_url=installation.url, timeout=30, follow_redirects=True)
    fields = {"user_name": account, "password": installation.passwords[account]}
    answer = page.post("/user/login", data=fields, headers={"Origin": installation.url})
    assert answer.status_code == 200, answer.text[:500]
    return page


@pytest.mark.parametrize("account", ["operator-team", "reviewer"])
@pytest.mark.parametrize("repository", REPOSITORIES)
def test_a_person_moves_main_in_no_other_way(installation: Installation, repository: str, account: str) -> None:
    person = installation.clone(account, repository)
    tip = person.tip()
    commit = person.commit({"policies/edits.yaml": "edits: respect\n"}, "mine\n", [tip])
    assert person.push(commit, "refs/heads/main") != ""
    assert person.push(commit, "refs/heads/main", force=True) != ""
    assert person.delete("refs/heads/main") != ""
    branch = f"person-{secrets.token_hex(3)}"
    assert person.push(commit, f"refs/heads/{branch}") == ""
    base = f"{installation.url}/api/v1/repos/{repository}"
    patch = "diff --git a/x.txt b/x.txt\nnew file mode 100644\n--- /dev/null\n+++ b/x.txt\n@@ -0,0 +1 @@\n+x\n"
    with http_calls.client(base_url=base, auth=(account, installation.passwords[account]), timeout=30) as own:
        for method, path, body in (
            ("POST", "/contents/x.txt", {"content": "eA==", "message": "x", "branch": "main"}),
            (
                "POST",
                "/contents",
                {"branch": "main", "files": [{"operation": "create", "path": "x", "content": "eA=="}]},
            ),
            ("POST", "/diffpatch", {"branch": "main", "content": patch, "message": "x"}),
            ("PATCH", "/branches/main", {"name": f"old-{branch}"}),
            ("PUT", "/branches/main", {"new_commit_id": commit, "old_commit_id": tip, "force": True}),
            ("DELETE", "/branches/main", None),
            ("PATCH", "", {"default_branch": branch}),
            ("PATCH", "", {"default_merge_style": "merge", "allow_merge_commits": True, "allow_manual_merge": True}),
            ("PATCH", "/branch_protections/main", {"enable_merge_whitelist": False}),
            ("DELETE", "/branch_protections/main", None),
            ("PUT", f"/collaborators/{account}", {"permission": "admin"}),
            ("POST", "/keys", {"title": "mine", "key": "ssh-ed25519 AAAA", "read_only": False}),
        ):
            answer = own.request(method, path, json=body)
            assert answer.status_code in (401, 403, 404, 405, 422), (method, path, answer.status_code, answer.text)
    form = {"commit_choice": "direct", "tree_path": "x.txt", "content": "x", "last_commit": tip, "commit_summary": "x"}
    with closing(page_of(installation, account)) as page:
        answer = page.post(f"/{repository}/_new/main/", data=form)
        assert (answer.status_code, "Cannot commit to protected branch" in answer.text) == (400, True)
    assert person.delete(f"refs/heads/{branch}") == ""
    assert person.tip() == tip


@pytest.mark.parametrize("repository", REPOSITORIES)
def test_who_sees_pull_requests_alone_reads_them_and_nothing_else(installation: Installation, repository: str) -> None:
    own, number, commit = open_change(installation, repository)
    with own, closing(page_of(installation, VIEWER)) as page:
        for path in ("", "/files", "/commits"):
            assert page.get(f"/{repository}/pulls/{number}{path}").status_code == 200
        assert "topic" not in page.get(f"/{repository}").text
        for path in ("src/branch/main", f"commit/{commit}", "raw/branch/main/README.md", "settings"):
            assert page.get(f"/{repository}/{path}").status_code == 404
        own.auth = httpx.BasicAuth(VIEWER, installation.passwords[VIEWER])
        for path in ("/contents/README.md", "/branches", "/commits", "/git/trees/main", "/archive/main.zip", "/pulls"):
            assert own.get(path).status_code in (403, 404)
        git = f"{installation.url}/{repository}.git/info/refs"
        for service in ("git-upload-pack", "git-receive-pack"):
            answer = http_calls.get(git, params={"service": service}, auth=own.auth)
            assert answer.status_code in (401, 403, 404)


@pytest.mark.parametrize("repository", REPOSITORIES)
def test_who_sees_pull_requests_alone_neither_proposes_nor_approves(
    installation: Installation, repository: str
) -> None:
    """Else one person could propose in this name, and approve in his own."""
    own, number, commit = open_change(installation, repository)
    branch = f"person-{secrets.token_hex(3)}"
    person = installation.clone("operator-team", repository)
    mine = person.commit({"README.md": branch}, "mine\n", [person.tip()])
    assert person.push(mine, f"refs/heads/{branch}") == ""
    viewer = installation.clone(VIEWER, repository)
    copied = viewer.repository.odb
    copied.add_disk_alternate(f"{person.repository.path}objects")
    for reference in ("refs/for/main", "refs/heads/main", "refs/heads/of-viewer", f"refs/heads/{branch}"):
        assert viewer.push(mine, reference, ["topic=viewed", "title=viewed"]) != ""
    with own:
        own.auth = httpx.BasicAuth(VIEWER, installation.passwords[VIEWER])
        opened = own.post("/pulls", json={"base": "main", "head": branch, "title": "viewed"})
        assert opened.status_code in (403, 404), opened.text
        review = {"event": "APPROVED", "commit_id": commit, "body": "seen"}
        given = own.post(f"/pulls/{number}/reviews", json=review)
        assert given.status_code in (403, 404) or given.json()["official"] is False
        for method, path, body in (
            ("POST", f"/pulls/{number}/merge", {"Do": "merge"}),
            ("PATCH", f"/pulls/{number}", {"state": "closed"}),
            ("POST", "/contents/x.txt", {"content": "eA==", "message": "x", "branch": "main"}),
        ):
            assert own.request(method, path, json=body).status_code in (403, 404, 405), path
        with closing(page_of(installation, VIEWER)) as page:
            answer = page.post(f"/{repository}/compare/main...{branch}", data={"title": "viewed"})
            assert answer.status_code in (400, 403, 404)
        own.auth = httpx.BasicAuth("operator-team", installation.passwords["operator-team"])
        opened = own.get("/pulls", params={"state": "all", "limit": 50}).json()
        assert "viewed" not in {one["title"] for one in opened}
    assert person.delete(f"refs/heads/{branch}") == ""


@pytest.mark.parametrize("repository", [*REPOSITORIES, "RobotKube/Deployment"])
@pytest.mark.parametrize("reference", RESERVED)
def test_a_person_writes_nothing_but_branches(installation: Installation, repository: str, reference: str) -> None:
    person = installation.clone("operator-team", repository)
    commit = person.commit({"README.md": reference}, "mine\n", [person.tip()])
    refused = person.push(commit, reference, force=True)
    assert f"{reference}: only the account gate writes notes, tags and whatever else is no branch" in refused
    assert "not operator-team; push a branch (refs/heads/<name>) or propose (refs/for/<branch>)" in refused
    shown("elsewhere", refused, "notes-pushed")
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
    with http_calls.client(base_url=f"{installation.url}/api/v1", auth=who, timeout=30) as forge:
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
