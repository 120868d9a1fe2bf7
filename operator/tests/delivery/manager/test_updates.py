"""A new version of a chart on its way to the releases: in plans of its own, and reverted when it fails."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.deployment.core.commit_messages import CommitMessage, read_message
from robotkube.delivery.deployment.core.plan_notes import PlanOutcome, ReleaseOutcome, note_text
from robotkube.delivery.deployment.core.releases import Release, application_name
from robotkube.delivery.manager.core.observation import ContainerState, PodState
from robotkube.delivery.manager.core.updates.probe_answers import ProbeLoss
from robotkube.delivery.manager.core.updates.rule_events import RuleEvent
from robotkube.delivery.manager.loops.reconciler import APPLICATIONS, CATALOGUE, DEPLOYMENT
from robotkube.delivery.manager.loops.updates.first_runs import FirstRuns
from robotkube.errors import UnavailableError
from robotkube.foundation.documents.core.digests import sha256
from robotkube.registry.charts.core.packing import published_digest
from robotkube.registry.evidence.adapters.dsse import KeyFile
from robotkube.registry.evidence.core.statements import Artefact, Listing
from tests.stages.delivery.manager.manager_in_memory import REGISTRY, START_NS, Stage, schema_file
from tests.stages.registry.signed_evidence import PLATFORM, POLICY_TEXT, Signing

BRIDGE = "mqtt-bridge"
TOGETHER = "default: {canary: false}\n"
CANARY = "default: {canary: true, successSeconds: 30, failureSeconds: 100}\n"


@pytest.fixture
def release_of(tmp_path: Path, stage: Stage) -> str:
    """A newer version of the bridge is in the catalogue; its number."""
    return publish(stage, tmp_path, 1)


def publish(stage: Stage, folder: Path, step: int, **more: Any) -> str:
    """The catalogue gets the bridge's newest version again, with a higher number, and `more` in its entry."""
    path = max((REGISTRY / "charts" / BRIDGE).glob("*.yaml"))
    document = yaml.safe_load(path.read_text())
    major, minor, patch = document["spec"]["version"].split(".")
    number = f"{major}.{minor}.{int(patch) + step}"
    schema = "".join(schema_file(BRIDGE, document["spec"]["version"]).values())
    document["spec"] |= {"version": number, "replaces": document["spec"]["version"], **more}
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


def test_without_a_canary_one_plan_updates_all_releases_of_the_chart_and_no_others(
    stage: Stage, release_of: str
) -> None:
    policy(stage, TOGETHER)
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


def test_by_default_the_canary_then_the_others(stage: Stage, tmp_path: Path) -> None:
    number = publish(stage, tmp_path, 1)
    go(stage)
    assert sorted(versions(stage).values()).count(number) == 1
    shown = stage.manager.statistics.updates_page()
    [(canary, tried)] = [(k, one) for k, one in shown["releases"].items() if one["state"] == "trial"]
    assert tried["text"] == f"mqtt-bridge {number} must be healthy for 30 s"
    waiting = [one["text"] for one in shown["releases"].values() if one["state"] == "waiting"]
    assert waiting == [f"mqtt-bridge {number} follows when it has succeeded for {canary}"] * 3
    assert [(one["chart"], one["version"]) for one in shown["withheld"]] == [(BRIDGE, number)]
    settle(stage)
    stage.go(10, seconds=2)
    assert sorted(versions(stage).values()).count(number) == 1
    stage.go(10, seconds=4)
    assert set(versions(stage).values()) == {number}
    settle(stage)
    stage.go(12, seconds=4)
    assert stage.manager.statistics.updates_page() == {"messages": [], "withheld": [], "releases": {}}


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
    policy(stage, TOGETHER)
    away = replace(stage.cluster.machines[1], ready=False)
    stage.cluster.machines[1] = away
    number = publish(stage, tmp_path, 1)
    go(stage)
    assert versions(stage)[away.agent] != number
    assert sorted(versions(stage).values()).count(number) == 3
    stage.cluster.machines[1] = replace(away, ready=True)
    go(stage)
    assert versions(stage)[away.agent] == number


def test_what_dies_on_a_vehicle_that_was_offline_is_taken_back_there_alone(stage: Stage, tmp_path: Path) -> None:
    policy(stage, TOGETHER)
    away = replace(stage.cluster.machines[1], ready=False)
    stage.cluster.machines[1] = away
    number = publish(stage, tmp_path, 1)
    go(stage)
    settle(stage)
    stage.go(10, seconds=5)
    back = START_NS + int(stage.seconds * 1e9)
    stage.cluster.machines[1] = replace(away, ready=True, ready_since=back)
    go(stage)
    assert set(versions(stage).values()) == {number}
    updated = stage.releases()
    settle(stage)
    [late] = [r for r in stage.releases().values() if r.chart == BRIDGE and r.namespace == away.agent]
    name = application_name(late.namespace, late.name)
    now = START_NS + int(stage.seconds * 1e9)
    stage.cluster.states[name] = replace(stage.cluster.states[name], health="Degraded", health_since=now)
    stage.go(8, seconds=5)
    message = last(stage)
    assert (message.kinds, message.reverts) == (("revert",), ())
    assert message.subject.startswith(f"deploy(revert): mqtt-bridge {number} back on {away.agent}: {late.key}")
    assert {a for a, one in versions(stage).items() if one != number} == {away.agent}
    assert all(stage.releases()[path] == one for path, one in updated.items() if path != late.path)
    settle(stage)
    stage.manager = stage.start()
    go(stage)
    stage.go(30, seconds=10)
    assert {a for a, one in versions(stage).items() if one != number} == {away.agent}
    assert stage.manager.statistics.updates_page()["releases"][late.key]["state"] == "kept_back"


def test_a_healthy_version_is_taken_back_by_its_results(stage: Stage, tmp_path: Path) -> None:
    machines = stage.cluster.machines
    stage.cluster.machines = [replace(machine, capabilities=machine.capabilities | {"lidar"}) for machine in machines]
    policy(stage, "default: {first: [vehicle-00]}\n")
    stage.settle()
    before = versions(stage)
    number = publish(stage, tmp_path, 1, success={"noEventOf": ["lidar-proximity"], "seconds": 60})
    settle(stage)
    go(stage)
    assert [agent for agent, one in versions(stage).items() if one == number] == ["vehicle-00"]
    settle(stage)
    stage.go(8, seconds=5)
    [text] = stage.manager.statistics.updates_page()["messages"]
    assert text.endswith("without an event of lidar-proximity for 60 s")
    now = START_NS + int(stage.seconds * 1e9)
    stage.cluster.events.append(RuleEvent("lidar-proximity", now, "cloud-0", ("vehicle-00", "vehicle-01")))
    stage.go(8, seconds=1)
    message = last(stage)
    assert message.kinds == ("revert",)
    assert "vehicle-00/mqtt-bridge had an event of rule lidar-proximity" in message.subject
    assert versions(stage) == before


@pytest.mark.parametrize("restarted", [True, False])
def test_a_healthy_version_is_taken_back_by_its_probes(stage: Stage, tmp_path: Path, restarted: bool) -> None:
    policy(stage, "default: {first: [vehicle-00]}\n")
    stage.settle()
    before = versions(stage)
    number = publish(stage, tmp_path, 1, success={"probesOf": ["bridge"], "seconds": 60})
    settle(stage)
    go(stage)
    settle(stage)
    [canary] = [release for release in stage.releases().values() if release.version == number]
    pod = PodState(
        canary.namespace, "bridge-0", canary.key, uid="u", containers=(ContainerState("bridge", True, True),)
    )
    stage.cluster.running[canary.key] = [pod]
    stage.go(8, seconds=5)
    [text] = stage.manager.statistics.updates_page()["messages"]
    assert text.endswith("with probes of bridge that say yes for 60 s")
    now = START_NS + int(stage.seconds * 1e9)
    if restarted:
        ended = ContainerState("bridge", True, True, 1, now, "Error, exit code 1")
        stage.cluster.running[canary.key] = [replace(pod, containers=(ended,))]
        stage.manager = stage.start()  # what a pod's status says is read by a new process, too
    else:
        stage.cluster.losses.append(ProbeLoss(canary.key, "u", "bridge", now))
    stage.go(8, seconds=1)
    message = last(stage)
    assert message.kinds == ("revert",)
    assert f"{canary.key} had container bridge" in message.subject
    assert versions(stage) == before


def outcome(observed: int | None, *keys: str) -> str:
    releases = tuple(ReleaseOutcome(key, "Synced", "Healthy", (), ()) for key in keys)
    return note_text(PlanOutcome("p", "c", None, None, observed, releases, ()))


class Notes:
    """Notes of commits; None: the forge does not answer."""

    def __init__(self, texts: dict[str, str] | None) -> None:
        self.known = texts

    def texts(self, commits: Sequence[str]) -> Mapping[str, str]:
        if self.known is None:
            raise UnavailableError("away")
        return {commit: self.known[commit] for commit in commits if commit in self.known}


@pytest.mark.parametrize(
    ("texts", "ran"),
    [
        ({"c": outcome(99, "vehicle-00/bridge")}, True),
        ({"c": outcome(100, "vehicle-00/bridge")}, False),
        ({"c": outcome(None, "vehicle-00/bridge")}, False),
        ({"c": outcome(99, "vehicle-01/bridge")}, False),
        ({"other": outcome(99, "vehicle-00/bridge")}, False),
        ({"c": "no outcome"}, False),
        ({}, False),
        (None, True),
    ],
)
def test_first_runs_are_read_from_the_outcomes_of_plans(texts: dict[str, str] | None, ran: bool) -> None:
    release = Release("vehicle-00", "bridge", BRIDGE, "0.2.0", "sha256:1", {})
    assert FirstRuns(Notes(texts)).ran_before(release, "c", 100) is ran


def test_first_runs_that_this_process_saw() -> None:
    release = Release("vehicle-00", "bridge", BRIDGE, "0.2.0", "sha256:1", {})
    runs = FirstRuns(None)
    runs.note([release], {release.key}, 50)
    runs.note([release], set(), 60)
    assert runs.ran_before(release, "c", 51)
    assert not runs.ran_before(release, "c", 50)
    runs.note([replace(release, digest="sha256:2")], set(), 70)
    assert not runs.ran_before(release, "c", 51)


def test_a_policy_that_cannot_be_read_holds_updates_and_nothing_else(stage: Stage, tmp_path: Path) -> None:
    policy(stage, "default: {canary: perhaps}\n")
    stage.manager = stage.start()
    number = publish(stage, tmp_path, 1)
    key = stage.ask()
    go(stage)
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")
    policy(stage, TOGETHER)
    go(stage)
    assert set(versions(stage).values()) == {number}


def test_a_persons_edit_that_is_reverted_bars_no_version(stage: Stage, release_of: str) -> None:
    policy(stage, TOGETHER)
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
