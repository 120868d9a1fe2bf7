"""Whatever a source answers or raises when a run has ended, there is a report: it names what could not be read, and no
expectation that needs it holds."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from robotkube.foundation.documents.core.digests import sha256
from scenarios.runner import running
from scenarios.runner.inputs import STORY, Plan, ReleasedChart, RunInputs
from scenarios.runner.judging import expectations
from scenarios.runner.judging.encounters import encounters
from scenarios.runner.observing import collecting
from scenarios.runner.playing import acting
from scenarios.runner.reporting import page, report
from scenarios.runner.waiting import RunError
from tests.stages.registry.signed_evidence import Signing, artefact, signing_key

DETECTOR = SimpleNamespace(
    metadata=SimpleNamespace(
        name="d-1", labels={"app.kubernetes.io/instance": "event-detector"}, deletion_timestamp=None
    )
)


class OwnError(Exception):
    """Of a library that nobody thought of."""


def broken(*_: Any, **__: Any) -> Any:
    raise OwnError("out of order")


class Answers:
    """The services of a run that went well; `documents` are what its pods and the manager answer."""

    def __init__(self, known: RunInputs) -> None:
        counters = known.input_after
        assert counters is not None
        self.documents: dict[str, Any] = {
            "events": {"events": [vars(edge) for edge in known.edges]},
            "plans": {"plans": [vars(plan) for plan in known.plans]},
            "input": {"started": counters.started, "topics": {t: _count(c) for t, c in counters.topics.items()}},
        }

    def pods(self, _namespace: str) -> list[Any]:
        return [DETECTOR]

    def pod_json(self, _namespace: str, _pod: str, path: str) -> Any:
        return json.loads(json.dumps(self.documents[path]))

    def service_json(self, _service: str, path: str, _port: int) -> Any:
        return json.loads(json.dumps(self.documents[path]))


def _count(count: Any) -> dict[str, Any]:
    pairs = {name: sorted(getattr(count, name).items()) for name in ("seconds", "ages_ms")}
    quantiles = [[second, *both] for second, both in sorted(count.age_quantiles_ms.items())]
    return {"received": count.received, "dropped": count.dropped, **pairs, "age_quantiles_ms": quantiles}


@pytest.fixture
def going(run: Any, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A run that has ended well; recordings and ledgers are those of the healthy run."""
    done = run.inputs()
    known = run.known
    monkeypatch.setattr(collecting, "stored", lambda *_: (done.recordings, done.stored, done.gaps))
    monkeypatch.setattr(collecting, "ledgers", lambda *_: done.ledgers)
    monkeypatch.setattr(running.evidence, "released", lambda _: known.released)
    monkeypatch.setattr(running, "_summaries", lambda going, _: going.catalogue.fetch() or known.summaries)
    monkeypatch.setattr(running, "specification_digests", lambda _: known.releases_after)
    forge = SimpleNamespace(
        fetch=lambda: "f" * 40,
        pull_requests=lambda: known.pull_requests,
        commits=lambda: known.commits,
        releases=dict,
        releases_since=lambda _: iter(()),
        history=lambda _: known.history,
    )
    stage = SimpleNamespace(
        name="run-1",
        scenario=run.scenario,
        access=Answers(known),
        provider="embedded",
        volumes=None,
        nodes={node.name: node.name for node in run.scenario.nodes},
        deployment=forge,
        catalogue=SimpleNamespace(fetch=lambda: "", files=lambda _: {}),
        observer=SimpleNamespace(stop=lambda: replace(known.broker, until=2 * known.broker.until)),
        sampler=SimpleNamespace(stop=lambda _: {}, cores=lambda _: known.cores),
        pods=SimpleNamespace(stop=lambda: None, pods=lambda: known.pods, labels={}),
        tasks=SimpleNamespace(stop=lambda: None, lives=lambda: known.tasks),
        actor=SimpleNamespace(done=[]),
        cables=SimpleNamespace(begin=lambda: None, finish=lambda: known.cables, warnings=[]),
        set_up_seconds={},
        started=known.started,
        ended=known.ended,
        broke_off=False,
        input_before=known.input_before,
        releases_before=known.releases_before,
        main_before="",
        plans_before=(),
        warnings=[],
    )
    stage.warn = stage.warnings.append
    monkeypatch.setattr(running.time, "time_ns", lambda: known.ended)
    return stage


def judged(going: SimpleNamespace) -> report.Report:
    done = report.report(going.scenario, running.collect(going))
    assert page.page(done)
    return done


def failed(done: report.Report) -> set[str]:
    return {row.name for row in done.table if not row.passed}


def test_a_run_that_went_well_is_collected_whole(going: SimpleNamespace) -> None:
    done = judged(going)
    assert done.document["warnings"] == []
    assert (failed(done), done.passed) == (set(), True)


@pytest.mark.parametrize(
    ("part", "name", "said", "without"),
    [
        ("access", "pod_json", "event detector's events", {"encounters", "pose_hz_min", "lost"}),
        ("access", "service_json", "manager's plans", {"audit_complete", "stop_to_removed_seconds"}),
        ("observer", "stop", "observer of the broker", {"point_clouds_at_broker_before_event"}),
        ("sampler", "stop", "CPU time", set()),
        ("sampler", "cores", "CPU time by second", set()),
        ("cables", "finish", "network", set()),
        ("pods", "stop", "watch of the pods", {"stop_to_removed_seconds"}),
        ("pods", "pods", "pods", {"stop_to_removed_seconds"}),
        ("tasks", "lives", "tasks", set()),
        ("deployment", "fetch", "deployment repository", {"audit_complete", "releases_after_equal_before"}),
        ("deployment", "pull_requests", "pull requests", {"audit_complete"}),
        ("deployment", "commits", "commits", {"audit_complete"}),
        ("deployment", "releases", "releases", {"releases_after_equal_before"}),
        ("deployment", "releases_since", "releases of the run", {"releases_had_evidence"}),
        ("deployment", "history", "main's history", set()),
        ("catalogue", "fetch", "evidence in the catalogue", {"releases_had_evidence"}),
    ],
)
def test_a_source_that_raises_costs_its_own_expectations(
    going: SimpleNamespace, part: str, name: str, said: str, without: set[str]
) -> None:
    setattr(getattr(going, part), name, broken)
    done = judged(going)
    assert f"{said}: OwnError: out of order" in done.document["warnings"]
    assert failed(done) >= without
    assert done.passed is not bool(without)


def test_evidence_is_verified_with_the_platform_s_keys(
    going: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trusted, foreign = signing_key(tmp_path / "trusted"), signing_key(tmp_path / "foreign")
    monkeypatch.undo()
    going.access.configmap = lambda namespace, name: {("robotkube", "evidence-keys"): {"gate.pem": trusted.public_key}}[
        namespace, name
    ]
    for key, warnings in ((trusted, 0), (foreign, 1)):
        envelope = Signing(key).sign(artefact())["summary"]
        going.catalogue.files = lambda _, data=envelope: {"evidence/app/x/summary.json": data}
        one = ReleasedChart("app", "0.1.0", artefact().digest, sha256(envelope), "a/app")
        going.warnings.clear()
        summaries = running._summaries(going, [one])
        assert (summaries[one.evidence] == one.digest, len(going.warnings)) == (warnings == 0, warnings)


def test_a_database_that_does_not_answer_costs_what_is_recorded(
    going: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(collecting, "stored", broken)
    done = judged(going)
    assert done.document["warnings"] == ["recordings: OwnError: out of order"]
    assert failed(done) >= {"lost", "duplicates", "payloads_equal", "poses_recorded_share"}


def change(going: SimpleNamespace, number: int, **values: Any) -> str:
    """Another form of one plan; its name."""
    plan = dict(going.access.documents["plans"]["plans"][number])
    going.access.documents["plans"]["plans"][number] = plan | values
    return str(plan["plan"])


def test_a_plan_without_a_start_time_is_a_plan(going: SimpleNamespace) -> None:
    """A manager that finds it on main when it begins does not know its times."""
    change(going, 0, started=None)
    del going.access.documents["plans"]["plans"][1]["started"]
    done = judged(going)
    assert (done.passed, done.document["warnings"]) == (True, [])
    assert [plan.started for plan in done.inputs.plans][:2] == [None, None]


@pytest.mark.parametrize(
    "values",
    [{"started": "soon"}, {"started": 1.5}, {"started": True}, {"started": []}, {"merged": "x"}, {"tasks": 5}],
    ids=repr,
)
def test_a_plan_that_cannot_be_read_is_named_and_the_others_are_kept(
    going: SimpleNamespace, values: Mapping[str, Any]
) -> None:
    name = change(going, 1, **values)
    done = judged(going)
    [warning] = done.document["warnings"]
    assert warning.startswith(f"plan {name}: ")
    assert len(done.inputs.plans) == len(going.access.documents["plans"]["plans"]) - 1
    assert failed(done) >= {"audit_complete"}


@pytest.mark.parametrize("item", [None, 7, [], {}, {"plan": 3}])
def test_what_is_no_plan_at_all_is_named_by_its_beginning(going: SimpleNamespace, item: Any) -> None:
    going.access.documents["plans"]["plans"].append(item)
    done = judged(going)
    [warning] = done.document["warnings"]
    assert warning.startswith(f"plan {3 if item == {'plan': 3} else item}: ")


@pytest.mark.parametrize("values", [{"time": None}, {"time": "x"}, {"stamp": 1.5}, {"done": "x"}, {"agents": None}])
def test_an_event_that_cannot_be_read_is_named(going: SimpleNamespace, values: Mapping[str, Any]) -> None:
    event = going.access.documents["events"]["events"][0]
    going.access.documents["events"]["events"][0] = dict(event) | values
    done = judged(going)
    assert any(text.startswith(f"event {event['id']}: ") for text in done.document["warnings"])
    assert "encounters" in failed(done)


@pytest.mark.parametrize(
    ("error", "ended"), [(RunError("in vain"), True), (KeyError("x"), False), (OwnError("no"), False)], ids=repr
)
def test_a_story_that_breaks_off_is_reported_and_fails(
    going: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, error: Exception, ended: bool
) -> None:
    """What was waited for in vain is judged by the expectations, as it always was."""

    def perform(_: Any) -> None:
        raise error

    going.actor.perform, going.scenario = perform, replace(going.scenario, steps=())
    for name in ("prepare", "play"):
        monkeypatch.setattr(running, name, lambda *_: None)
    for part in (going.pods, going.tasks, going.observer, going.sampler):
        part.start = lambda: None
    done = running.execute(going, {})
    assert done.passed is ended
    assert any(str(error) in text for text in done.document["warnings"])
    assert ("story_came_to_its_end" in failed(done)) is not ended


def test_every_measure_names_the_fields_that_it_is_computed_from(run: Any) -> None:
    inputs = run.inputs()
    met = encounters(run.scenario, inputs)
    known = {field.name for field in fields(RunInputs)}
    assert set(expectations.NEEDS) == set(expectations.MEASURES)
    for name, measure in expectations.MEASURES.items():
        read_fields: set[str] = set()
        measure(run.scenario, Watched(inputs, read_fields), met)  # type: ignore[arg-type]
        assert read_fields - {"started", "ended", "releases_before"} <= expectations.NEEDS[name] <= known, name


class Watched:
    """The inputs, and which of their fields somebody reads."""

    def __init__(self, inputs: RunInputs, read_fields: set[str]) -> None:
        self._inputs, self._read_fields = inputs, read_fields

    def __getattr__(self, name: str) -> Any:
        self._read_fields.add(name)
        return getattr(self._inputs, name)


def test_the_later_answer_of_a_restarted_manager_completes_the_earlier(going: SimpleNamespace) -> None:
    plans: list[dict[str, Any]] = going.access.documents["plans"]["plans"]
    going.plans_before = tuple(Plan(**plan) for plan in plans)
    for plan in plans:
        plan.update(started=None, proposed=None)
    assert judged(going).inputs.plans == acting.merge_plans((), going.plans_before)
    assert STORY not in judged(going).inputs.missing
