"""What reaches main past manager and gate, or asks for more than a release may, is refused by Argo CD, and what nobody
asked for is taken away again. What the gate refuses of the manager's: delivery/gate/test_gate.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.deployment.core.releases import Release, Source, write_release, write_source
from robotkube.errors import InputError
from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.charts.adapters.oci import OciRegistry
from tests.stages.platform.running_platform import Platform, Writer, asleep, eventually

AGENT, PLAN = "vehicle-02", "20261121-100000-abcdef"
CHARTS = "oci://forge.robotkube.svc.cluster.local:3000/verified"
REFUSED_SECONDS_MAX = 90.0
VERSION = "0.2.2"
CONFIGMAP = """
apiVersion: v1
kind: ConfigMap
metadata: {name: {{ .Release.Name }}}
data: {reached: the cluster}
"""
CLUSTER_ROLE = """
apiVersion: rbac.authorization.k8s.io/v1
kind: ClusterRole
metadata: {name: everything-test}
rules: [{apiGroups: ["*"], resources: ["*"], verbs: ["*"]}]
"""
UNKNOWN_DIGEST = "sha256:" + "d" * 64


def push_chart(platform: Platform, folder: Path, name: str, organisation: str) -> str:
    """A chart with a ConfigMap and a ClusterRole that no gate has seen; returns its digest."""
    (folder / "templates").mkdir(parents=True)
    (folder / "Chart.yaml").write_text(f"apiVersion: v2\nname: {name}\nversion: {VERSION}\n")
    (folder / "values.yaml").write_text("{}\n")
    (folder / "templates" / "configmap.yaml").write_text(CONFIGMAP)
    (folder / "templates" / "clusterrole.yaml").write_text(CLUSTER_ROLE)
    with OciRegistry(platform.forge_url(), "gate", platform.password("gate")) as registry:
        return registry.push_chart(organisation, pack(folder, {}))


def files(name: str, chart: str, digest: str, annotation: str = "") -> dict[str, str | None]:
    """A release with its source; `annotation` stands where the chart's name should."""
    release = Release(AGENT, name, chart, VERSION, digest, {}, plan=PLAN)
    text = write_release(release)
    if annotation:
        text = text.replace(f"robotkube.io/chart: {chart}\n", f"robotkube.io/chart: {annotation}\n")
        assert annotation in text
    source = Source(AGENT, chart, digest, f"{CHARTS}/{chart}")
    return {release.path: text, source.path: write_source(source)}


@pytest.fixture(scope="module")
def manager_asleep(platform: Platform) -> Iterator[None]:
    """The manager does not run, since it would take away at once what nobody asked for."""
    eventually("all Applications synced and healthy", platform.settled)
    with asleep(platform, "manager"):
        yield


@pytest.fixture(scope="module")
def refused(platform: Platform, manager_asleep: None, tmp_path_factory: pytest.TempPathFactory) -> Writer:
    """Three releases on main that the gate has not seen, by the one account that may push there."""
    digest = push_chart(platform, tmp_path_factory.mktemp("chart") / "everything", "everything", "verified")
    staged = push_chart(platform, tmp_path_factory.mktemp("staged") / "staged", "staged", "staging")
    gate = platform.writer("gate", tmp_path_factory.mktemp("gate"))
    changes = files("everything", "everything", digest)
    changes |= files("foreign", "elsewhere", staged, annotation="../staging/staged")
    changes |= files("unknown", "mqtt-bridge", UNKNOWN_DIGEST)
    gate.push(changes, "test: releases that no gate has seen\n")
    return gate


def application(platform: Platform, name: str) -> dict[str, Any]:
    """The Application of a release of this module, empty when there is none."""
    return dict(platform.access.applications().get(f"{AGENT}-{name}", {}))


def conditions(found: Mapping[str, Any]) -> str:
    """All that Argo CD says against an Application."""
    status = found.get("status", {})
    texts = [f"{entry['type']}: {entry['message']}" for entry in status.get("conditions", [])]
    return "\n".join([*texts, status.get("operationState", {}).get("message", "")])


def test_a_cluster_role_is_refused_with_its_whole_release(platform: Platform, refused: Writer) -> None:
    """Argo CD may not even read one, so it compares nothing; if it might, the AppProject would refuse it."""

    def said() -> bool:
        text = conditions(application(platform, "everything"))
        return "ComparisonError" in text and 'cannot get resource "clusterroles"' in text

    eventually("the ClusterRole is refused", said, REFUSED_SECONDS_MAX)
    state = application(platform, "everything")["status"]
    assert state["sync"]["status"] == "Unknown"
    assert "operationState" not in state
    assert platform.kubectl("get", "clusterrole", "everything-test", "--ignore-not-found") == ""
    assert platform.kubectl("-n", AGENT, "get", "configmap", "everything", "--ignore-not-found") == ""


def test_a_chart_from_elsewhere_is_refused(platform: Platform, refused: Writer) -> None:
    def said() -> bool:
        text = conditions(application(platform, "foreign"))
        return "InvalidSpecError" in text and "is not permitted in project 'robotkube-apps'" in text

    eventually("the source is refused", said, REFUSED_SECONDS_MAX)
    assert application(platform, "foreign")["status"]["sync"]["status"] == "Unknown"
    assert platform.kubectl("-n", AGENT, "get", "configmap", "foreign", "--ignore-not-found") == ""


def test_a_digest_that_the_registry_does_not_have_changes_nothing(platform: Platform, refused: Writer) -> None:
    def said() -> bool:
        text = conditions(application(platform, "unknown"))
        return "ComparisonError" in text and "not found" in text

    eventually("the digest is not found", said, REFUSED_SECONDS_MAX)
    assert application(platform, "unknown")["status"]["sync"]["status"] == "Unknown"


def test_what_the_gate_refuses_is_merged_by_nobody(platform: Platform, refused: Writer, tmp_path: Path) -> None:
    """A staged chart, and in the same commit the policy that edits by hand are respected: approved, and not merged."""
    digest = push_chart(platform, tmp_path / "staged", "staged", "staging")
    name, approver = platform.scenario.story.person, platform.scenario.story.approver
    person = platform.writer(name, tmp_path / "person")
    changes = {**files("staged", "staged", digest), "policies/edits.yaml": "edits: respect\n"}
    commit = person.commit(changes, "test: a staged chart\n")
    number = person.proposals.propose(commit, "staged-by-a-person", "a staged chart", "a test")
    with platform.forge(name) as forge, platform.forge(approver) as other:
        review = {"event": "APPROVED", "commit_id": commit, "body": "seen"}
        other.post(f"/pulls/{number}/reviews", json=review).raise_for_status()

        def said() -> bool:
            return "it cannot be merged." in str(forge.get(f"/issues/{number}/comments").json())

        eventually("the gate has refused it", said)
        for account in (forge, other):
            for style in ("fast-forward-only", "rebase", "merge"):
                assert account.post(f"/pulls/{number}/merge", json={"Do": style}).status_code == 405
        assert not forge.get(f"/pulls/{number}").json()["merged"]
        forge.patch(f"/pulls/{number}", json={"state": "closed"}).raise_for_status()
    assert platform.kubectl("-n", AGENT, "get", "configmap", "staged", "--ignore-not-found") == ""
    with (
        OciRegistry(platform.forge_url(), "argocd", platform.password("argocd")) as registry,
        pytest.raises(InputError),
    ):
        registry.manifest_digest("staging/staged", digest)


def test_the_other_releases_go_on(platform: Platform, refused: Writer) -> None:
    assert platform.available(AGENT, "mqtt-bridge")


def test_what_is_taken_away_is_gone_by_gits_word_alone(platform: Platform, refused: Writer) -> None:
    """The one that is no valid release: the manager leaves files alone that it cannot read."""
    path = f"releases/{AGENT}/foreign.yaml"
    source = next(path for path in refused.clone.files(refused.clone.fetch(), ("sources",)) if "elsewhere" in path)
    refused.push({path: None, source: None}, "test: take the foreign release away\n")
    eventually("the Application is gone", lambda: not application(platform, "foreign"), REFUSED_SECONDS_MAX)


def test_the_manager_takes_away_what_nobody_asked_for(platform: Platform, refused: Writer) -> None:
    """By a pull request, as everything it does. The fixtures wake it again afterwards; it may be woken twice."""
    platform.kubectl("-n", "robotkube", "scale", "deployment/manager", "--replicas=1")

    def clean() -> bool:
        left = [name for name in refused.clone.files(refused.clone.fetch(), ("releases",)) if AGENT in name]
        return not any(name.endswith(("everything.yaml", "unknown.yaml")) for name in left)

    eventually("main is as the catalogue and the tasks want it", clean, REFUSED_SECONDS_MAX)
    gone = ("everything", "unknown")
    eventually(
        "the Applications are gone", lambda: not any(application(platform, n) for n in gone), REFUSED_SECONDS_MAX
    )
    message = refused.clone.log(None, 1)[0].message
    assert message.startswith("deploy(initial)")
    eventually("all other Applications synced and healthy", platform.settled)
