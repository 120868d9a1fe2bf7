"""The console over HTTP, on a model in memory: snapshots, changes, streams, chains, files, and who gets nothing."""

from __future__ import annotations

import asyncio
import gzip
import json
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft202012Validator
from starlette.responses import PlainTextResponse

from robotkube.delivery.console.adapters.cluster_documents import agent_document, pod_documents, release_documents
from robotkube.delivery.console.adapters.web import streams as streaming
from robotkube.delivery.console.adapters.web.application import Console, ConsoleSurroundings
from robotkube.delivery.console.adapters.web.guarding import REQUESTS, Guard
from robotkube.delivery.console.adapters.web.page_files import read_files
from robotkube.delivery.console.adapters.web.people import People
from robotkube.delivery.console.core import table as kinds
from robotkube.delivery.console.core.documents import (
    certificate_documents,
    rule_documents,
    stranger_documents,
    task_document,
    unchecked_documents,
)
from robotkube.delivery.console.core.links import BridgeReading, LinkRates
from robotkube.delivery.console.core.rate_limits import RateLimits, RequestRate
from robotkube.delivery.console.core.recordings import recording_documents
from robotkube.delivery.console.loops.model import ReadModel
from robotkube.errors import InputError
from tests.delivery.console import documents as given
from tests.delivery.console.people import PlatformInMemory
from tests.delivery.console.requests import Client
from tests.stages.paths import DOCS

CONTRACT = yaml.safe_load((DOCS / "reference" / "console-api.yaml").read_text())
NOW = 1_795_250_020_000


def filled() -> ReadModel:
    """A model with an item of each kind."""
    model = ReadModel("e", lambda: NOW)
    agent = {"name": "cloud-0", "namespace": "cloud-0", "role": "cloud", "records": True}
    model.put(kinds.AGENTS, "cloud-0", agent_document(agent, ()))
    pose = {"x": 1.0, "y": 2.0, "z": 0.0, "heading": None, "stamp_ms": NOW, "received_ms": NOW}
    model.put(kinds.POSES, "vehicle-00", pose)
    model.put_task(given.TASK, task_document(given.task()))
    model.put_plans(given.plans(given.withdrawal()), "manager")
    model.put_decisions(given.decisions(images="x is not covered"))
    model.replace(kinds.CERTIFICATES, certificate_documents(given.accounts()))
    model.replace(kinds.UNCHECKED, unchecked_documents(given.unchecked()))
    for key, release in release_documents([given.application()]).items():
        model.put_release(key, release)
    model.replace(kinds.PODS, pod_documents([given.pod()]))
    model.put_events(given.edges("start", "stop"), "cloud-0/detector")
    model.replace(kinds.RULES, rule_documents(given.RULES, given.RECORDER))
    model.put_catalogue("manager", given.CATALOGUE)
    model.put_recordings(recording_documents(given.recordings(given.BEGAN, None), "cloud-0", "cloud-0/recorder-0"))
    link = LinkRates().documents(given.BRIDGE, BridgeReading(NOW, {("out", "/pose"): {"messages_total": 1.0}}), ("no",))
    model.replace(kinds.LINKS, link)
    stranger = {"kind": "Pod", "namespace": "cloud-0", "name": "x", "reason": "ForeignImage"}
    inspection = {
        "metadata": {"namespace": "robotkube", "name": "kubelet.cloud-0"},
        "status": {"strangers": [stranger]},
    }
    model.replace(kinds.STRANGERS, stranger_documents(inspection))
    model.put_source("broker", "it is away", "Look at it.", (kinds.POSES,))
    return model


class Open:
    """A console that everybody reads, and a client of it."""

    def __init__(self, model: ReadModel, **around: Any) -> None:
        self.model = model
        self.console = Console(
            model, People(None), PlatformInMemory().asking, ConsoleSurroundings(hosts=["testserver"], **around)
        )
        self.client = Client(self.console.app)

    def get(self, path: str, **more: Any) -> Any:
        return self.client.get(path, **more)


@pytest.fixture
def console() -> Open:
    return Open(filled())


def assert_of_the_contract(document: object, schema: str) -> None:
    whole = {"$ref": f"#/components/schemas/{schema}", "components": CONTRACT["components"]}
    problems = [f"{'/'.join(map(str, e.path))}: {e.message}" for e in Draft202012Validator(whole).iter_errors(document)]
    assert not problems


def test_every_kind_is_as_the_contract_has_it(console: Open) -> None:
    snapshot = console.get("/api/snapshot").json()
    assert set(snapshot["items"]) == set(kinds.KINDS) == set(CONTRACT["components"]["schemas"]["Kind"]["enum"])
    assert_of_the_contract(snapshot, "Snapshot")
    assert_of_the_contract(console.get("/api/session").json(), "Session")
    assert_of_the_contract(console.get("/api/changes?after=e.0").json(), "Change")
    assert_of_the_contract(console.get("/api/changes?after=x").json(), "Problem")
    for kind in ("tasks", "agents", "catalogue"):
        assert console.get(f"/api/{kind}").json() == snapshot["items"][kind]


def test_every_path_of_the_contract_is_answered_and_no_other(console: Open) -> None:
    answered = {route.path.replace("{id:path}", "{id}") for route in console.console.app.routes}  # type: ignore[attr-defined]
    assert answered == {*CONTRACT["paths"], "/healthz", "/{path:path}"}


@pytest.mark.parametrize("kind", ["event", "task", "plan", "commit", "pod", "release", "recording"])
def test_why(console: Open, kind: str) -> None:
    wanted = {
        "event": given.EVENT, "task": given.TASK, "plan": given.PLAN, "commit": given.COMMIT,
        "pod": "cloud-0/recorder-0", "release": given.RECORDER,
        "recording": "cloud-0/encounter-1",
    }[kind]  # fmt: skip
    chain = console.get(f"/api/why/{kind}/{wanted}").json()
    assert_of_the_contract(chain, "Chain")
    assert {step["step"] for step in chain["steps"]} >= {"message", "event", "task", "plan", "commit", "end"}
    assert chain["title"] == "near: vehicle-00, vehicle-01 within 400 m"


@pytest.mark.parametrize("path", ["task/a/b", "nothing/a", f"task/{'a' * 700}", "secret/x"])
def test_why_of_what_is_not_known(console: Open, path: str) -> None:
    assert console.get(f"/api/why/{path}").status_code == 404


def test_polling_brings_what_a_stream_does(console: Open) -> None:
    after = console.get("/api/snapshot").json()["id"]
    assert console.get(f"/api/changes?after={after}").json()["set"] == {}
    console.model.put_task(given.TASK, None)
    change = console.get(f"/api/changes?after={after}").json()
    assert change["gone"] == {"tasks": [given.TASK]}
    assert list(change["set"]) == ["releases"]
    assert console.get("/api/changes?after=f.3").status_code == 410
    assert console.get("/api/changes").status_code == 400


def test_a_recording_has_a_layout_as_a_file(console: Open) -> None:
    answer = console.get("/api/recordings/cloud-0/encounter-1/layout")
    assert answer.headers["content-disposition"] == 'attachment; filename="encounter-1.layout.json"'
    assert list(answer.json()["configById"]["3D!space"]["topics"]) == ["/cloud", "/vehicles/vehicle_00/pose"]
    refused = console.get("/api/recordings/cloud-0/encounter-9/layout")
    assert (refused.status_code, refused.json()["title"]) == (404, "Not known")
    assert "robotkube recording export" in refused.json()["detail"]


def test_an_agent_writes_no_header_of_an_answer(console: Open) -> None:
    recordings = given.recordings(None)
    recordings["recordings"][0]["recording"] = 'a"\r\nSet-Cookie: b'
    console.model.put_recordings(recording_documents(recordings, "cloud-0", "cloud-0/recorder-0"))
    answer = console.get("/api/recordings/cloud-0/a%22%0D%0ASet-Cookie%3A%20b/layout")
    assert answer.headers["content-disposition"] == 'attachment; filename="a___Set-Cookie__b.layout.json"'
    assert "set-cookie" not in answer.headers


async def next_event(events: AsyncIterator[str]) -> dict[str, Any]:
    """The next event that is no heartbeat."""
    async for text in events:
        fields = dict(line.split(": ", 1) for line in text.strip().splitlines() if not line.startswith(":") and line)
        if fields["event"] != "heartbeat":
            return {**fields, "data": json.loads(fields["data"])}
    return {}


def test_a_stream_begins_with_padding_and_a_heartbeat_and_tells_what_changes(console: Open) -> None:
    async def read() -> None:
        version = console.model.version
        events = console.console.streams.events(version - 1, "me", lambda: True)
        first = await anext(events)
        assert first.startswith(": ....")
        assert "event: heartbeat" in first
        missed = await next_event(events)
        assert missed["id"] == f"e.{version}"
        waiting = asyncio.ensure_future(next_event(events))
        await asyncio.sleep(0)
        await asyncio.to_thread(console.model.put_source, "broker", "", "", ())
        event = await asyncio.wait_for(waiting, 5)
        assert_of_the_contract(event["data"], "Change")
        assert event["data"]["set"]["sources"]["broker"]["ok"] is True
        assert event["id"] == f"e.{version + 1}"
        assert console.console.streams.wakeups.count == 1
        await events.aclose()  # type: ignore[attr-defined]
        assert console.console.streams.wakeups.count == 0

    asyncio.run(read())


def test_a_stream_beats_while_nothing_changes(console: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streaming, "HEARTBEAT_SECONDS", 0.01)

    async def read() -> None:
        events = console.console.streams.events(console.model.version, "me", lambda: True)
        await anext(events)
        assert "event: heartbeat" in await asyncio.wait_for(anext(events), 5)
        await events.aclose()  # type: ignore[attr-defined]

    asyncio.run(read())


def test_a_stream_ends_when_it_may_no_longer_be_read_and_when_the_process_ends(console: Open) -> None:
    async def count(allowed: bool) -> int:
        events = console.console.streams.events(console.model.version, "me", lambda: allowed)
        return len([text async for text in events])

    assert asyncio.run(count(allowed=False)) == 1
    console.console.streams.stop()
    assert asyncio.run(count(allowed=True)) == 1


@pytest.mark.parametrize("after", ["f.1", "e.99999", "x"])
def test_who_cannot_be_told_is_sent_to_a_snapshot(console: Open, after: str) -> None:
    answer = console.get(f"/api/events?after={after}")
    assert answer.headers["content-type"] == "text/event-stream; charset=utf-8"
    assert (answer.headers["x-accel-buffering"], answer.headers["cache-control"]) == ("no", "no-store, no-transform")
    assert "content-encoding" not in answer.headers
    assert answer.text.rstrip().splitlines()[-2] == "event: resync"


def test_the_header_of_a_browser_that_comes_back_counts_before_the_query(console: Open) -> None:
    console.console.streams.stopping = False
    answer = console.get("/api/events?after=e.1", headers={"Last-Event-ID": "f.1"})
    assert "event: resync" in answer.text


def test_a_source_opens_so_many_streams(console: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streaming, "STREAMS_OF_A_SOURCE_MAX", 0)
    assert console.get("/api/events?after=e.0").status_code == 429


@pytest.fixture
def page(tmp_path: Path) -> Path:
    (tmp_path / "assets").mkdir()
    (tmp_path / "index.html").write_text("<!doctype html><title>Console</title>" + " " * 2000)
    (tmp_path / "assets" / "page-1a2b.js").write_text("export {};\n" * 300)
    return tmp_path


def test_files_of_the_page(page: Path) -> None:
    console = Open(filled(), files=read_files(page))
    index = console.get("/")
    assert (index.status_code, index.headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert index.headers["cache-control"] == "no-cache"
    assert console.get("/index.html").text == index.text
    assert console.get("/", headers={"If-None-Match": index.headers["etag"]}).status_code == 304
    script = console.get("/assets/page-1a2b.js")
    assert (script.headers["content-type"], script.headers["content-encoding"]) == (
        "text/javascript; charset=utf-8",
        "gzip",
    )
    assert "immutable" in script.headers["cache-control"]
    plain = console.get("/assets/page-1a2b.js", headers={"Accept-Encoding": "identity"})
    assert "content-encoding" not in plain.headers
    assert plain.text == script.text


@pytest.mark.parametrize("path", ["/../settings.py", "/%2e%2e/x", "/assets", "/nothing"])
def test_nothing_but_the_pages_files(page: Path, path: str) -> None:
    assert Open(filled(), files=read_files(page)).get(path).status_code == 404


def test_a_folder_without_a_page_is_refused_and_no_folder_is_said(tmp_path: Path, console: Open) -> None:
    with pytest.raises(InputError, match=r"has no index\.html"):
        read_files(tmp_path)
    assert "not part of this image" in console.get("/").json()["detail"]


def test_every_answer_bounds_what_a_browser_does_with_it(console: Open) -> None:
    for path in ("/", "/api/snapshot", "/healthz", "/api/why/task/x", "/auth/login"):
        headers = console.get(path).headers
        policy = dict(part.split(" ", 1) for part in headers["content-security-policy"].split("; "))
        assert (policy["default-src"], policy["frame-ancestors"], policy["script-src"]) == (
            "'none'",
            "'none'",
            "'self'",
        )
        assert (headers["x-content-type-options"], headers["x-frame-options"]) == ("nosniff", "DENY")
        assert "strict-transport-security" not in headers
    encrypted = Open(filled(), encrypted=True)
    assert "strict-transport-security" in encrypted.get("/").headers


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("evil.example", 421),
        ("", 421),
        ("testserver", 200),
        ("TESTSERVER:80", 200),
        ("10.0.0.7:8080", 200),
        ("[::1]:8080", 200),
        ("[::1", 421),
        ("[::1]evil.example", 421),
        ("testserver:80@evil.example", 421),
        ("10.0.0.7:8080/assets/#", 421),
    ],
)
def test_names_that_it_does_not_go_by_get_nothing(console: Open, host: str, status: int) -> None:
    assert console.get("/api/snapshot", headers={"Host": host}).status_code == status
    assert console.get("/nowhere", headers={"Host": host}).status_code == (404 if status == 200 else status)


def test_one_source_asks_at_most_so_often() -> None:
    moments = [1000.0]
    guard = Guard(PlainTextResponse(""), ["testserver"], False, lambda status: None, lambda: moments[-1])
    client = Client(guard)
    answers = [client.get("/") for _ in range(int(REQUESTS.burst) + 1)]
    assert [answer.status_code for answer in answers] == [200] * int(REQUESTS.burst) + [429]
    assert int(answers[-1].headers["retry-after"]) == 1
    moments.append(1001.0)
    answers = [client.get("/") for _ in range(int(REQUESTS.per_second) + 1)]
    assert [answer.status_code for answer in answers] == [200] * int(REQUESTS.per_second) + [429]


def test_a_bucket_fills_again_and_of_too_many_sources_the_oldest_is_forgotten() -> None:
    limits = RateLimits(RequestRate(burst=1, per_second=2), sources_max=1)
    assert limits.wait_seconds("a", 10.0) == 0
    assert limits.wait_seconds("a", 10.0) == pytest.approx(0.5)
    assert limits.wait_seconds("a", 10.5) == 0
    assert limits.wait_seconds("b", 10.5) == 0
    assert limits.wait_seconds("a", 10.5) == 0


def test_what_only_reads_takes_nothing(console: Open) -> None:
    for path in ("/api/snapshot", "/api/agents", "/"):
        for method in ("POST", "PUT", "DELETE", "PATCH"):
            answer = console.client.request(method, path)
            assert (answer.status_code, answer.headers["allow"]) == (405, "GET, HEAD")


@pytest.mark.parametrize("said", ['{"m":NaN}', '{"m":-Infinity}', '{"m":1e999}', '{"\\ud800":1}', '{"m":"\\udfff"}'])
def test_what_an_agent_says_keeps_nobody_from_reading(console: Open, said: str) -> None:
    """A detector is a pod of an agent: its page may have what is no JSON for a browser, or no text at all."""
    [edge] = given.edges("start")["events"]
    console.model.put_events({"events": [{**edge, "id": "odd", "detail": json.loads(said)}]}, "vehicle-00/detector")
    for path in ("/api/snapshot", "/api/changes?after=e.0", "/api/why/event/odd"):
        answer = console.get(path)
        assert answer.status_code == 200
        json.loads(answer.text, parse_constant=pytest.fail)
    assert "odd" in console.get("/api/snapshot").json()["items"]["events"]


def test_a_large_snapshot_is_compressed(console: Open) -> None:
    for number in range(100):
        console.model.put(kinds.POSES, f"vehicle-{number}", {"x": number})
    answer = console.get("/api/snapshot")
    assert answer.headers["content-encoding"] == "gzip"
    assert len(gzip.compress(answer.content)) < len(answer.content)
