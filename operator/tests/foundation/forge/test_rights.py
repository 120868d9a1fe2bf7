"""What the forge itself refuses: the manager proposes and nothing else, nobody passes the gate by."""

import httpx
import pytest

from tests.stages.forge.installation import Installation, message, release_files

pytestmark = pytest.mark.toolchain


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
