"""The queue of the suite-runner: once per key, in order, a test namespace for those that need one, bounds, errors."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest

from robotkube.errors import UnavailableError
from robotkube.foundation.runtime.adapters.prometheus_series import series_text
from robotkube.registry.evidence.core.statements import SuiteResult
from robotkube.registry.suites.core.requests import SuiteProgress, SuiteRequest
from robotkube.registry.suites.loops import queue as suite_runner
from robotkube.registry.suites.loops.queue import SuiteQueue
from robotkube.testing.suites import MemoryExecutor, MemoryNamespaceKeeper, failed, make_request, passed
from tests.stages.waiting import until

Start = Callable[..., SuiteQueue]


@pytest.fixture
def start() -> Iterator[Start]:
    queues = []

    def begin(executor: MemoryExecutor, *keepers: MemoryNamespaceKeeper) -> SuiteQueue:
        queue = SuiteQueue(executor, keepers, lambda rule: rule.name == "install")
        queue.start()
        queues.append(queue)
        return queue

    yield begin
    for queue in queues:
        queue.stop()
    assert not [thread for thread in threading.enumerate() if "_work" in thread.name]


def another(request: SuiteRequest, number: int) -> SuiteRequest:
    return replace(request, artefact=replace(request.artefact, digest=f"sha256:{number:064x}"))


def finished(queue: SuiteQueue, request: SuiteRequest) -> SuiteResult:
    until(lambda: queue.put(request).finished, "run finished")
    result = queue.put(request).result
    assert result is not None
    return result


def test_a_run_is_done_once_however_often_it_is_asked_for(start: Start) -> None:
    executor = MemoryExecutor()
    keeper = MemoryNamespaceKeeper()
    queue = start(executor, keeper)
    request = make_request()
    assert queue.put(request).status in ("queued", "running")
    until(lambda: queue.put(request).status == "running", "running")
    executor.go.set()
    assert finished(queue, request).outcome == "passed"
    assert queue.put(replace(request, attempt="later")) == SuiteProgress("finished", passed(request))
    assert executor.executed == [("install", keeper.name)]
    until(lambda: keeper.emptied == 2, "emptied before and after")
    assert 'robotkube_suite_runs_total{outcome="passed",suite="install"} 1.0' in series_text(queue.metrics())


def test_what_did_not_pass_is_run_again_for_another_attempt_only(start: Start) -> None:
    executor = MemoryExecutor(failed)
    executor.go.set()
    queue = start(executor, MemoryNamespaceKeeper())
    request = make_request()
    assert finished(queue, request).outcome == "failed"
    assert queue.put(request).finished
    executor.result = passed
    assert not queue.put(replace(request, attempt="a2")).finished
    assert finished(queue, replace(request, attempt="a2")).outcome == "passed"
    assert len(executor.executed) == 2


def test_suites_without_a_namespace_do_not_wait_for_one(start: Start) -> None:
    executor = MemoryExecutor()
    executor.go.set()
    keeper = MemoryNamespaceKeeper(troubles=[UnavailableError("stuck pod")] * 1000)
    queue = start(executor, keeper)
    assert finished(queue, make_request("static")).outcome == "passed"
    until(lambda: "stuck pod" in queue.put(make_request()).reason, "the reason is reported")
    assert "robotkube_suite_namespaces_not_ready 1.0" in series_text(queue.metrics())
    assert queue.reasons_not_ready() == []
    assert executor.executed == [("static", "")]


def test_a_namespace_is_used_only_after_it_could_be_emptied(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(suite_runner, "EMPTY_PAUSE_SECONDS_FIRST", 0.01)
    executor = MemoryExecutor()
    keeper = MemoryNamespaceKeeper(troubles=[UnavailableError("busy"), KeyError("odd")])
    executor.go.set()
    assert finished(start(executor, keeper), make_request()).outcome == "passed"
    assert keeper.emptied >= 1
    assert keeper.troubles == []


def test_two_namespaces_work_at_the_same_time(start: Start) -> None:
    executor = MemoryExecutor()
    queue = start(executor, MemoryNamespaceKeeper("robotkube-suite-0"), MemoryNamespaceKeeper("robotkube-suite-1"))
    requests = [another(make_request(), number) for number in range(3)]
    for request in requests:
        queue.put(request)
    until(lambda: len(executor.executed) == 2, "two run")
    assert {namespace for _, namespace in executor.executed} == {"robotkube-suite-0", "robotkube-suite-1"}
    waiting = queue.put(requests[2])
    assert waiting.status == "queued"
    assert waiting.reason
    executor.go.set()
    assert all(finished(queue, request).outcome == "passed" for request in requests)


def test_without_namespaces_it_is_reported_what_a_run_waits_for(start: Start) -> None:
    assert "without a pool" in start(MemoryExecutor()).put(make_request()).reason


def test_the_queue_and_the_memory_are_bounded(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(suite_runner, "QUEUE_MAX", 3)
    monkeypatch.setattr(suite_runner, "FINISHED_MAX", 2)
    executor = MemoryExecutor()
    queue = start(executor, MemoryNamespaceKeeper())
    first = make_request()
    queue.put(first)
    until(lambda: queue.put(first).status == "running", "running")
    requests = [another(first, number) for number in range(3)]
    for request in requests:
        assert queue.put(request).status == "queued"
    with pytest.raises(UnavailableError, match="3 runs wait already"):
        queue.put(another(first, 9))
    executor.go.set()
    until(lambda: queue.put(requests[2]).finished, "all done")
    assert not queue.put(first).finished, "the oldest result was forgotten"


def test_a_run_that_cannot_be_done_is_unfinished(start: Start) -> None:
    def crash(request: SuiteRequest) -> SuiteResult:
        raise UnavailableError("the suite did not end within its 30 s and was ended")

    executor = MemoryExecutor(crash)
    executor.go.set()
    result = finished(start(executor, MemoryNamespaceKeeper()), make_request())
    assert result.outcome == "unfinished"
    assert "did not end within its 30 s" in result.checks[0].found
    assert not result.checks[0].passed
