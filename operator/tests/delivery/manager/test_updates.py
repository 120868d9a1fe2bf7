"""A new version of a chart on its way to the releases: in plans of its own, and reverted when it fails."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from robotkube.delivery.deployment.core.commit_messages import CommitMessage, read_message
from robotkube.delivery.deployment.core.releases import application_name
from robotkube.delivery.manager.loops.reconciler import APPLICATIONS, CATALOGUE, DEPLOYMENT
from robotkube.foundation.documents.core.digests import sha256
from robotkube.registry.charts.core.packing import published_digest
from robotkube.registry.evidence.adapters.dsse import KeyFile
from robotkube.registry.evidence.core.statements import Artefact, Listing
from tests.stages.delivery.manager_in_memory import REGISTRY, START_NS, Stage, schema_file
from tests.stages.registry.signed_evidence import PLATFORM, POLICY_TEXT, Signing

BRIDGE = "mqtt-bridge"
CANARY = "default: {canary: true, successSeconds: 30, failureSeconds: 100}\n"


@pytest.fixture
def release_of(tmp_path: Path, stage: Stage) -> str:
    """A newer version of the bridge is in the catalogue; its number."""
    return publish(stage, tmp_path, 1)


def publish(stage: Stage, folder: Path, step: int) -> str:
    """The catalogue gets the bridge's newest version again, with a higher number."""
    path = max((REGISTRY / "charts" / BRIDGE).glob("*.yaml"))
    document = yaml.safe_load(path.read_text())
    major, minor, patch = document["spec"]["version"].split(".")
    number = f"{major}.{minor}.{int(patch) + step}"
    schema = "".join(schema_file(BRIDGE, document["spec"]["version"]).values())
    document["spec"] |= {"version": number, "replaces": document["spec"]["version"]}
    about = Artefact(BRIDGE, number, f"sha256:{'f' * 63}{step}", PLATFORM)
    listed = Listing(published_digest(document["spec"], []), sha256(schema.encode()))
    signing = Signing(KeyFile(folder / "key" / "key.pem"), listed=listed)
    envelopes = signing.sign(about)
    evidence = {"evidence": sha256(envelopes["summary"]), "policy": signing.policy.digest}
    document["status"] = {"state": "verified", "digest": about.digest, "images": [], **evidence}
    files = {f"{about.folder}/{name}.json": data.decode() for name, data in envelopes.items()}
    files |= {f"charts/{BRIDGE}/{number}.yaml": yaml.safe_dump(document)}
    files |= {f"charts/{BRIDGE}/{number}.schema.json": schema}
    stage.catalogue.push({**files, "policies/verification.yaml": POLICY_TEXT}, "publish")
    return number


def policy(stage: Stage, text: str) -> None:
    stage.repository.push({"policies/updates.yaml": text}, "policy: people's decision")


def go(stage: Stage) -> None:
    """Whatever is due now, with catalogue and main read anew."""
    for what in (CATALOGUE, DEPLOYMENT):
        stage.go(wake=what)


def versions(stage: Stage) -> dict[str, str]:
    return {r.namespace: r.version for r in stage.releases().values() if r.chart == BRIDGE}


def settle(stage: Stage) -> None:
    """Argo CD has done everything, and everything is healthy from now on."""
    stage.cluster.settle(stage.releases())
    since = START_NS + int(stage.seconds * 1e9)
    stage.cluster.states = {k: replace(s, health_since=since) for k, s in stage.cluster.states.items()}
    stage.go(wake=APPLICATIONS)


def last(stage: Stage) -> CommitMessage:
    return read_message(stage.repository.commits[stage.repository.tip].message)


def test_by_default_one_plan_updates_all_releases_of_the_chart_and_no_others(stage: Stage, release_of: str) -> None:
    before = stage.releases()
    stage.ask()
    go(stage)
    assert set(versions(stage).values()) == {release_of}
    message = last(stage)
    assert message.subject == f"deploy(update): mqtt-bridge {release_of}"
    assert (message.kinds, message.causes) == (("update",), ())
    after = stage.releases()
    others = {path: release for path, release in before.items() if release.chart != BRIDGE}
    assert others == {path: after[path] for path in others}
    updates = [plan for plan in stage.plans() if plan["cause"] == "update"]
    assert len(updates) == 1
    stage.go(30, seconds=5)
    assert len([plan for plan in stage.plans() if plan["cause"] == "update"]) == 1


def test_the_canary_then_the_others(stage: Stage, tmp_path: Path) -> None:
    policy(stage, CANARY)
    number = publish(stage, tmp_path, 1)
    go(stage)
    assert sorted(versions(stage).values()).count(number) == 1
    settle(stage)
    stage.go(10, seconds=2)
    assert sorted(versions(stage).values()).count(number) == 1
    stage.go(10, seconds=4)
    assert set(versions(stage).values()) == {number}


def test_a_failed_canary_is_reverted_exactly_and_never_tried_again(stage: Stage, tmp_path: Path) -> None:
    policy(stage, CANARY)
    go(stage)
    before = stage.releases()
    number = publish(stage, tmp_path, 1)
    go(stage)
    update = stage.repository.tip
    [canary] = [release for release in stage.releases().values() if release.version == number]
    settle(stage)
    name = application_name(canary.namespace, canary.name)
    now = START_NS + int(stage.seconds * 1e9)
    stage.cluster.states[name] = replace(stage.cluster.states[name], health="Degraded", health_since=now)
    stage.go(8, seconds=3)
    message = last(stage)
    assert (message.kinds, message.reverts) == (("revert",), (update,))
    assert message.subject.startswith(f"deploy(revert): mqtt-bridge {number} back: {canary.key}")
    after = stage.releases()
    assert all(after[path].same_but_plan(release) for path, release in before.items())
    settle(stage)
    stage.manager = stage.start()
    go(stage)
    stage.go(30, seconds=10)
    assert number not in versions(stage).values()
    newer = publish(stage, tmp_path, 2)
    go(stage)
    assert newer in versions(stage).values()


def test_people_let_a_digest_be_tried_again(stage: Stage, tmp_path: Path) -> None:
    test_a_failed_canary_is_reverted_exactly_and_never_tried_again(stage, tmp_path)
    stage.catalogue.push({f"charts/{BRIDGE}/{versions_of(stage)[-1]}.yaml": None}, "withdraw the newest")
    policy(stage, CANARY.replace("30", "20"))
    go(stage)
    assert versions_of(stage)[-1] in versions(stage).values()


def versions_of(stage: Stage) -> list[str]:
    """The bridge's versions in the catalogue, oldest first."""
    paths = stage.catalogue.trees[stage.catalogue.tip]
    folder = f"charts/{BRIDGE}/"
    return sorted(Path(path).stem for path in paths if path.startswith(folder) and path.endswith(".yaml"))


def test_an_offline_vehicle_gets_it_when_it_is_back(stage: Stage, tmp_path: Path) -> None:
    away = replace(stage.cluster.machines[1], ready=False)
    stage.cluster.machines[1] = away
    number = publish(stage, tmp_path, 1)
    go(stage)
    assert versions(stage)[away.agent] != number
    assert sorted(versions(stage).values()).count(number) == 3
    stage.cluster.machines[1] = replace(away, ready=True)
    go(stage)
    assert versions(stage)[away.agent] == number


def test_a_policy_that_cannot_be_read_holds_updates_and_nothing_else(stage: Stage, tmp_path: Path) -> None:
    policy(stage, "default: {canary: perhaps}\n")
    stage.manager = stage.start()
    number = publish(stage, tmp_path, 1)
    key = stage.ask()
    go(stage)
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")
    policy(stage, "{}\n")
    go(stage)
    assert set(versions(stage).values()) == {number}


def test_a_persons_edit_that_is_reverted_bars_no_version(stage: Stage, release_of: str) -> None:
    go(stage)
    assert set(versions(stage).values()) == {release_of}
    settle(stage)
    [path] = [r.path for r in stage.releases().values() if r.chart == BRIDGE and r.namespace == "vehicle-00"]
    text = stage.repository.files(stage.repository.tip, ("releases",))[path]
    edit = stage.repository.push({path: text.replace("  values:\n", "  values:\n    edited: by hand\n")}, "by hand")
    go(stage)
    assert last(stage).reverts == (edit,)
    stage.manager = stage.start()
    go(stage)
    assert set(versions(stage).values()) == {release_of}
    stage.go(30, seconds=10)
    assert last(stage).kinds != ("revert", "update")
    assert set(versions(stage).values()) == {release_of}
