"""The read model: what sources write is one consistent table, and what is away is said, with what was there before."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from robotkube.delivery.console.adapters.cluster_documents import agent_document, pod_document, release_documents
from robotkube.delivery.console.adapters.cluster_watches import read_shown_pod
from robotkube.delivery.console.core import table as kinds
from robotkube.delivery.console.core.documents import stranger_documents, task_document
from robotkube.delivery.console.core.recordings import recording_documents
from robotkube.delivery.console.loops import model as model_module
from robotkube.delivery.console.loops.model import ReadModel
from robotkube.delivery.console.loops.page_reading import CertificateReader, DetectorReader, GateReader, ManagerReader
from robotkube.delivery.console.ports import Detector, ManagerPages
from robotkube.delivery.manager.adapters.kubernetes_cluster import read_node, read_nodes
from robotkube.delivery.manager.core.placement.placement import NodeState
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.kubernetes.core.node_agents import NodeAgent
from tests.delivery.console import documents as given

URL, GATE = "http://manager:8080", "https://gate:8080"
ACCOUNTS = "http://certificates:8081/accounts"
DETECTOR = Detector("cloud-0/recorder-0", given.RECORDER, "10.0.0.7", "recorder")
EVENTS = "http://10.0.0.7:8081/events"
RECORDINGS = "http://10.0.0.7:8081/recordings"


class Pages:
    """Pages in memory; a page that is not there is one that nobody answers for."""

    def __init__(self, **pages: Any) -> None:
        self.pages: dict[str, Any] = {
            f"{URL}/plans": given.plans(),
            f"{URL}/catalogue": given.CATALOGUE,
            RECORDINGS: given.recordings(),
            **pages,
        }
        self.settings: Mapping[str, Any] = given.RULES

    def get(self, url: str) -> Mapping[str, Any]:
        if url not in self.pages:
            raise UnavailableError(f"{url}: nobody answers")
        if self.pages[url] is None:
            raise InputError(f"{url}: 404")
        page: Mapping[str, Any] = self.pages[url]
        return page

    def read(self, namespace: str, name: str) -> Mapping[str, Any]:
        assert (namespace, name) == ("cloud-0", "recorder")
        return self.settings


@pytest.fixture
def model() -> ReadModel:
    return ReadModel("e", lambda: 7)


def put_release(model: ReadModel, *items: Mapping[str, Any]) -> None:
    for key, document in release_documents(items).items():
        model.put_release(key, document)


def test_a_release_knows_who_asks_for_it_whichever_comes_first(model: ReadModel) -> None:
    put_release(model, given.application())
    model.put_task(given.TASK, task_document(given.task()))
    put_release(model, given.application(given.BRIDGE))
    assert [d["demands"] for d in model.documents(kinds.RELEASES).values()] == [[given.TASK], [given.TASK]]
    model.put_task(given.TASK, None)
    assert [d["demands"] for d in model.documents(kinds.RELEASES).values()] == [[], []]


def test_an_event_is_known_by_its_task_until_its_detector_says_more(model: ReadModel) -> None:
    model.put_task(given.TASK, task_document(given.task()))
    [event] = model.documents(kinds.EVENTS).values()
    assert (event["rule"], event["causes"], event["agents"]) == ("near", [], ["vehicle-00", "vehicle-01"])
    model.put_events(given.edges("start"), "cloud-0/detector")
    [event] = model.documents(kinds.EVENTS).values()
    assert (event["distance_m"], event["ended_ms"]) == (399.8, None)
    model.put_task(given.TASK, task_document(given.task(state="False")))
    assert model.documents(kinds.EVENTS)[given.EVENT]["distance_m"] == 399.8
    model.put_events(given.edges("stop"), "cloud-0/detector")
    [event] = model.documents(kinds.EVENTS).values()
    assert (event["began_ms"], event["ended_ms"]) == (given.BEGAN // 1_000_000, given.BEGAN // 1_000_000 + 50_000)


def test_of_too_many_events_those_that_ended_go_first(model: ReadModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_module, "EVENTS_MAX", 2)
    [edge] = given.edges("start")["events"]
    [end] = given.edges("stop")["events"]
    later = [{**edge, "id": name, "time": edge["time"] + number} for number, name in enumerate(("b", "c"))]
    model.put_events({"events": [edge, end, *later]}, "cloud-0/detector")
    assert set(model.documents(kinds.EVENTS)) == {"b", "c"}


def test_who_tells_without_end_loses_his_own_events(model: ReadModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_module, "EVENTS_MAX", 4)
    [edge] = given.edges("start")["events"]
    model.put_events(given.edges("start", "stop"), "cloud-0/detector")
    later = [{**edge, "id": str(number), "time": edge["time"] + number} for number in range(1, 9)]
    model.put_events({"events": later}, "vehicle-00/detector")
    assert set(model.documents(kinds.EVENTS)) == {given.EVENT, "6", "7", "8"}


def test_an_agent_says_nothing_of_another_ones_events(model: ReadModel) -> None:
    model.put_events(given.edges("start"), "cloud-0/detector")
    [edge] = given.edges("stop")["events"]
    model.put_events({"events": [{**edge, "rule": "another"}]}, "vehicle-00/detector")
    event = model.documents(kinds.EVENTS)[given.EVENT]
    assert (event["rule"], event["ended_ms"], event["detector"]) == ("near", None, "cloud-0/detector")
    model.put_events(given.edges("stop"), "cloud-0/detector-after-a-restart")
    assert model.documents(kinds.EVENTS)[given.EVENT]["ended_ms"] is not None


def test_a_manager_that_is_away_leaves_what_it_said(model: ReadModel) -> None:
    pages = Pages()
    now = 0.0
    reader = ManagerReader(model, pages, ManagerPages("manager", URL), lambda: now)
    assert reader.step()
    assert list(model.documents(kinds.PLANS)) == [given.PLAN]
    assert set(model.documents(kinds.CATALOGUE)) == {"application/recording", "chart/event-detector/0.2.3"}
    pages.pages.clear()
    assert not reader.step()
    source = model.documents(kinds.SOURCES)["manager/manager"]
    assert (source["ok"], source["problem"]) == (False, f"{URL}/plans: nobody answers")
    assert source["advice"]
    assert list(model.documents(kinds.PLANS)) == [given.PLAN]


@pytest.mark.parametrize("gate_first", [True, False])
def test_a_plan_knows_what_the_gate_checked_whichever_page_comes_first(model: ReadModel, gate_first: bool) -> None:
    decisions = given.decisions("refused", images="x is not covered")
    pages = Pages(**{f"{GATE}/decisions": decisions, f"{GATE}/unchecked": given.unchecked()})
    readers = [
        GateReader(model, pages, GATE),
        ManagerReader(model, pages, ManagerPages("manager", URL), lambda: 0.0),
    ]
    assert all(reader.step() for reader in (readers if gate_first else readers[::-1]))
    decision = model.documents(kinds.PLANS)[given.PLAN]["decision"]
    assert (decision["verdict"], decision["checks"][1]["problems"]) == ("refused", ["x is not covered"])
    pages.pages[f"{GATE}/decisions"] = {"decisions": []}
    assert all(reader.step() for reader in readers)
    kept = model.documents(kinds.PLANS)[given.PLAN]["decision"]
    assert kept == decision, "a gate that starts anew has forgotten it, the console has not"
    version = model.version
    assert all(reader.step() for reader in readers)
    assert model.version == version, "nothing new is nothing to send"


def test_a_gate_that_is_away_leaves_what_it_said_and_one_of_another_form_is_away(model: ReadModel) -> None:
    pages = Pages(**{f"{GATE}/decisions": given.decisions(), f"{GATE}/unchecked": given.unchecked()})
    reader = GateReader(model, pages, GATE)
    model.put_plans(given.plans(), "manager")
    assert reader.step()
    for page, problem in ((None, "404"), ({}, "cannot be read"), ({"decisions": [{}]}, "cannot be read")):
        pages.pages[f"{GATE}/decisions"] = page
        assert not reader.step()
        assert problem in model.documents(kinds.SOURCES)["gate-pages"]["problem"]
    assert model.documents(kinds.PLANS)[given.PLAN]["decision"]["verdict"] == "accepted"


def test_commits_past_the_gate_come_from_its_page_and_go_with_it(model: ReadModel) -> None:
    pages = Pages(**{f"{GATE}/decisions": given.decisions(), f"{GATE}/unchecked": given.unchecked()})
    reader = GateReader(model, pages, GATE)
    assert reader.step()
    [commit] = model.documents(kinds.UNCHECKED).values()
    assert (commit["how"], commit["signed_by"], commit["made_good"]) == ("break-glass", ["ada", "grace"], "")
    assert commit["time_ms"] == 1_795_255_210_000
    pages.pages[f"{GATE}/unchecked"] = {"tip": "", "problem": "", "commits": []}
    assert not reader.step(), "it began anew, and nobody knows yet whether something stands"
    assert "has not read main" in model.documents(kinds.SOURCES)["gate-pages"]["problem"]
    assert len(model.documents(kinds.UNCHECKED)) == 1
    pages.pages[f"{GATE}/unchecked"] = {"tip": "1", "problem": "no commit has a record", "commits": []}
    assert reader.step()
    [(key, records)] = model.documents(kinds.UNCHECKED).items()
    assert (key, records["how"], records["problem"]) == ("records", "records", "no commit has a record")
    pages.pages[f"{GATE}/unchecked"] = {"tip": "1", "problem": "", "commits": []}
    assert reader.step()
    assert not model.documents(kinds.UNCHECKED)


def test_certificates_come_from_their_process_and_a_problem_of_it_is_said(model: ReadModel) -> None:
    pages = Pages(**{ACCOUNTS: {"problem": "nothing was looked at yet", "accounts": None}})
    reader = CertificateReader(model, pages, ACCOUNTS.removesuffix("/accounts"))
    assert not reader.step()
    assert model.documents(kinds.SOURCES)["certificates"]["problem"] == "nothing was looked at yet"
    pages.pages[ACCOUNTS] = given.accounts()
    assert reader.step()
    certificates = model.documents(kinds.CERTIFICATES)
    assert set(certificates) == {"vehicle-00/vehicle-00", "robotkube/observer"}
    of_vehicle = certificates["vehicle-00/vehicle-00"]
    assert [of_vehicle[key] for key in ("from_ms", "until_ms", "renewal_ms")] == [
        *(1_795_250_000_000, 1_803_026_000_000, 1_800_434_000_500)
    ]
    assert certificates["robotkube/observer"]["until_ms"] is None
    pages.pages[ACCOUNTS] = {**given.accounts(), "problem": "Secret vehicle-00/broker-account is missing"}
    assert not reader.step()
    assert "is missing" in model.documents(kinds.SOURCES)["certificates"]["problem"]
    for page, problem in ((None, "404"), ({}, "cannot be read"), ({"accounts": [{}]}, "cannot be read")):
        pages.pages[ACCOUNTS] = page
        assert not reader.step()
        assert problem in model.documents(kinds.SOURCES)["certificates"]["problem"]
    assert model.documents(kinds.CERTIFICATES) == certificates, "as of when somebody answered"


def test_of_too_many_decisions_the_oldest_go(model: ReadModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_module, "DECISIONS_MAX", 1)
    [decision] = given.decisions()["decisions"]
    model.put_decisions({"decisions": [decision, {**decision, "pull_request": 13}]})
    model.put_plans(given.plans({**given.plans()["plans"][0], "plan": "b", "pull_request": 13}), "manager")
    assert [plan["decision"] is None for plan in model.documents(kinds.PLANS).values()] == [True, False]


def test_plans_of_one_manager_do_not_take_those_of_another_away(model: ReadModel) -> None:
    model.put_plans(given.plans(plan="a"), "north")
    model.put_plans(given.plans(plan="b"), "south")
    model.put_plans({"plans": []}, "north")
    assert set(model.documents(kinds.PLANS)) == {"b"}


def test_a_chart_says_where_it_runs(model: ReadModel) -> None:
    pages = Pages()
    reader = ManagerReader(model, pages, ManagerPages("manager", URL), lambda: 0.0)
    reader.step()
    put_release(model, given.application())
    reader.step()
    assert model.documents(kinds.CATALOGUE)["chart/event-detector/0.2.3"]["releases"] == [given.RECORDER]


@pytest.mark.parametrize("page", [{}, {"plans": [{}]}, {"plans": 3}, {"plans": ["x"]}])
def test_a_page_of_another_form_is_a_source_that_is_away(model: ReadModel, page: object) -> None:
    reader = ManagerReader(model, Pages(**{f"{URL}/plans": page}), ManagerPages("manager", URL), lambda: 0.0)
    assert not reader.step()
    assert "cannot be read" in model.documents(kinds.SOURCES)["manager/manager"]["problem"]


def test_events_and_rules_come_from_detectors_and_rules_go_with_them(model: ReadModel) -> None:
    pages = Pages(**{EVENTS: given.edges("start")})
    there = [DETECTOR]
    reader = DetectorReader(model, pages, pages, lambda: there, lambda: 0.0)
    assert reader.step()
    assert list(model.documents(kinds.EVENTS)) == [given.EVENT]
    rules = model.documents(kinds.RULES)
    assert rules[f"{given.RECORDER}/near"]["start_distance_m"] == 400
    assert rules[f"{given.RECORDER}/yard"]["areas"] == [[[[0, 0], [1, 0], [1, 1], [0, 0]]]]
    del pages.pages[EVENTS]
    assert not reader.step()
    assert model.documents(kinds.SOURCES)["detectors"]["problem"] == f"cloud-0/recorder-0: {EVENTS}: nobody answers"
    there.clear()
    assert reader.step()
    assert not model.documents(kinds.RULES)


def test_recordings_come_from_detectors_and_stay_when_they_go(model: ReadModel) -> None:
    pages = Pages(**{EVENTS: given.edges("start"), RECORDINGS: given.recordings(given.BEGAN + given.SECOND, None)})
    there = [DETECTOR]
    reader = DetectorReader(model, pages, pages, lambda: there, lambda: 0.0)
    assert reader.step()
    ended, open_one = (model.documents(kinds.RECORDINGS)[f"cloud-0/encounter-{number}"] for number in (0, 1))
    assert (ended["at_work"], ended["ended_ms"] - ended["windows"][0]["began_ms"]) == (False, 1000)
    assert (open_one["at_work"], open_one["windows"][0]["event"]) == (True, given.EVENT)
    assert (open_one["received"], open_one["stored"], open_one["dropped"], open_one["gap_count"]) == (100, 97, 1, 1)
    assert open_one["gaps"][0]["why"] == "outbox full"
    assert [topic["first_ms"] is None for topic in open_one["topics"]] == [True, False]
    pages.pages[RECORDINGS] = None
    assert reader.step(), "a detector of an earlier version has no such page"
    there.clear()
    reader.step()
    assert model.documents(kinds.RECORDINGS)["cloud-0/encounter-1"]["at_work"] is False


def test_of_too_many_recordings_those_that_ended_go_first(model: ReadModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_module, "RECORDINGS_MAX", 2)
    page = given.recordings(None, given.BEGAN, given.BEGAN)
    model.put_recordings(recording_documents(page, "cloud-0", "cloud-0/recorder-0"))
    assert set(model.documents(kinds.RECORDINGS)) == {"cloud-0/encounter-0", "cloud-0/encounter-2"}


def test_a_pod_of_a_detector_that_is_ready_is_asked_for_its_pages() -> None:
    assert read_shown_pod(given.pod())["detector"] == DETECTOR
    assert read_shown_pod(given.pod(ready=False))["detector"].host == ""
    other = given.pod()
    other["metadata"]["labels"]["app.kubernetes.io/name"] = "mqtt-bridge"
    assert read_shown_pod(other)["detector"] is None


def test_what_a_container_fails_by_is_said() -> None:
    waiting = {"name": "main", "restartCount": 3, "state": {"waiting": {"reason": "ImagePullBackOff", "message": "no"}}}
    document = pod_document(given.pod(ready=False, containerStatuses=[waiting]))
    assert (document["trouble"], document["restarts"]) == ("container main: ImagePullBackOff: no", 3)


def test_an_agent_has_its_nodes_its_hold_and_since_when_it_is_silent() -> None:
    metadata = {
        "name": "vehicle-00",
        "labels": {"robotkube.io/agent": "vehicle-00", "robotkube.io/capability.lidar": "true"},
        "annotations": {"robotkube.io/hold": "driving", "robotkube.io/hold-until": "2026-11-21T10:00:00Z"},
        "creationTimestamp": "2026-11-21T09:00:00Z",
    }
    silent = {"type": "Ready", "status": "Unknown", "lastTransitionTime": given.TIME}
    node = read_node({"metadata": metadata, "status": {"conditions": [silent]}})
    declared = {"name": "vehicle-00", "namespace": "vehicle-00", "role": "vehicle", "records": False}
    agent = agent_document(declared, [node])
    assert (agent["ready"], agent["capabilities"], agent["hold"]["reason"]) == (False, ["lidar"], "driving")
    assert agent["silent_since_ms"] is not None
    assert agent_document(declared, [])["ready"] is False


def test_who_shares_a_node_is_named_with_it_and_nobody_else() -> None:
    host = NodeAgent("cloud-0", "cloud")
    guests = [NodeAgent(f"vehicle-0{number}", "vehicle", frozenset(), number) for number in (1, 2)]
    labels = {key: value for one in (host, *guests) for key, value in one.labels.items()}
    shared = read_nodes({"metadata": {"name": "worker-1", "labels": labels}})
    alone = read_nodes({"metadata": {"name": "worker-2", "labels": NodeAgent("vehicle-03", "vehicle").labels}})
    nobodys = read_nodes({"metadata": {"name": "worker-3", "labels": {}}})

    def others(name: str, *nodes: NodeState) -> list[list[str]]:
        agent = {"name": name, "namespace": name, "role": "vehicle", "records": False}
        return [one["shared_with"] for one in agent_document(agent, nodes)["nodes"]]

    every = (*alone, *nobodys, *shared)
    assert others("vehicle-01", *every) == [["cloud-0", "vehicle-02"]]
    assert others("cloud-0", *every) == [["vehicle-01", "vehicle-02"]]
    assert others("vehicle-03", *every) == [[]]
    unnamed = read_nodes({"metadata": {"name": "worker-4", "labels": guests[0].labels}})
    assert others("vehicle-01", *unnamed) == [[]], "a host without a name is nobody"


def test_strangers_by_what_they_are() -> None:
    stranger = {"kind": "Pod", "namespace": "cloud-0", "name": "x", "reason": "ForeignImage", "since": given.TIME}
    inspection = {
        "metadata": {"namespace": "robotkube", "name": "kubelet.cloud-0"},
        "status": {"strangers": [stranger]},
    }
    [(key, document)] = stranger_documents(inspection).items()
    assert key == "kubelet.cloud-0/Pod/cloud-0/x//ForeignImage"
    assert document["since_ms"] is not None


def test_listeners_hear_of_changes_alone(model: ReadModel) -> None:
    heard: list[int] = []
    model.listen(lambda: heard.append(model.version))
    model.put_source("broker", "", "", ())
    model.put_source("broker", "", "", ())
    assert heard == [1]
    assert {series.name for series in model.metrics()} >= {"robotkube_console_source_away"}
