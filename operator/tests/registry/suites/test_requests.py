"""JSON forms of requests and progress: the way there and back, and every refusal."""

import json
from dataclasses import replace
from typing import Any

import pytest

from robotkube.errors import DocumentError
from robotkube.registry.evidence.core.statements import Artefact, Check, SuiteResult
from robotkube.registry.suites.core.requests import (
    CHECKS_MAX,
    TEXT_CHARACTERS_MAX,
    Replaced,
    SuiteProgress,
    progress_document,
    read_progress,
    read_request,
    request_document,
    tidy,
)
from robotkube.testing.suites import DIGEST, ENTRY, failed, make_request

IMAGE = "forge.example:3000/team/suite@sha256:" + "0" * 64


def test_a_request_there_and_back() -> None:
    old = Replaced(Artefact("greeter", "0.1.0", DIGEST, "linux/amd64"), "verified/greeter", ENTRY)
    request = replace(
        make_request(image=IMAGE, command=("look", "-v"), installs=True, soak_seconds=10, memory_growth_percent=7),
        replaced=old,
    )
    assert read_request(json.loads(json.dumps(request_document(request)))) == request
    assert read_request(request_document(make_request())) == make_request()


def test_the_key_is_of_digest_policy_suite_and_version_only() -> None:
    request = make_request()
    assert len(request.key) == 32
    assert replace(request, attempt="other", entry={}, repository="staging/other").key == request.key
    others = [
        replace(request, policy_digest=DIGEST),
        replace(request, artefact=replace(request.artefact, digest="sha256:" + "1" * 64)),
        replace(request, rule=replace(request.rule, name="static")),
        replace(request, rule=replace(request.rule, version="2")),
    ]
    assert len({request.key, *(other.key for other in others)}) == 5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"entry": []}, "entry: must be a mapping"),
        ({"more": 1}, "more: unknown key"),
        ({"policy": "sha256:1"}, "policy: 'sha256:1' must match"),
        ({"repository": "staging"}, "repository: 'staging' must match"),
        ({"artefact": {"chart": "x"}}, r"artefact\.digest: missing"),
        ({"rule": {"name": "install", "version": "1", "seconds": True}}, r"rule\.seconds: must be a number"),
        ({"rule": {"name": "x", "version": "1", "seconds": 9, "image": "latest"}}, r"rule\.image: 'latest' must match"),
        ({"rule": {"name": "x", "version": "1", "seconds": 9, "command": [1]}}, r"rule\.command: must be a list"),
        (
            {"rule": {"name": "x", "version": "1", "seconds": 9, "installs": 1}},
            r"rule\.installs: must be true or false",
        ),
        ({"replaced": {}}, r"replaced\.entry: missing"),
    ],
)
def test_requests_that_are_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(DocumentError, match=words):
        read_request({**request_document(make_request()), **change})


@pytest.mark.parametrize("document", [None, [], "x", 1, {}, {"artefact": None}])
def test_anything_else_is_a_clear_refusal(document: Any) -> None:
    with pytest.raises(DocumentError):
        read_request(document)
    with pytest.raises(DocumentError):
        read_progress(document)


def test_progress_there_and_back() -> None:
    for progress in (
        SuiteProgress("queued", reason="2 runs wait before it"),
        SuiteProgress("finished", failed(make_request())),
    ):
        assert read_progress(json.loads(json.dumps(progress_document(progress)))) == progress


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"status": "done"}, "status: must be one of"),
        ({"result": None}, "result: must be there when"),
        ({"status": "running"}, "result: must be there when, and only when"),
    ],
)
def test_progress_that_is_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(DocumentError, match=words):
        read_progress({**progress_document(SuiteProgress("finished", failed(make_request()))), **change})


@pytest.mark.parametrize(
    ("checks", "words"),
    [
        ([{"name": "a", "passed": 1}], r"checks\[0\]\.passed: must be true or false"),
        ([{"name": "", "passed": True}], r"checks\[0\]\.name: must have"),
        ([{"name": "a", "passed": True}] * 2, "two checks named 'a'"),
        ([{"name": "a", "passed": True, "why": ""}], r"checks\[0\]\.why: unknown key"),
        ([{"name": str(i), "passed": True} for i in range(CHECKS_MAX + 1)], "more than"),
        ({}, "must be a list"),
    ],
)
def test_checks_that_are_refused(checks: Any, words: str) -> None:
    document = progress_document(SuiteProgress("finished", failed(make_request())))
    with pytest.raises(DocumentError, match=words):
        read_progress({**document, "result": {**document["result"], "checks": checks}})


def test_what_a_suite_says_is_made_to_fit() -> None:
    long = "x" * (TEXT_CHARACTERS_MAX + 1)
    fitting = tidy([Check("same\nname", True), Check("same name", False, long, "fix"), Check("", True)])
    assert [check.name for check in fitting] == ["same name", "same name (2)", "check"]
    assert len(fitting[1].found) <= TEXT_CHARACTERS_MAX
    result = SuiteResult("install", "1", "failed", fitting, 1.0)
    progress = SuiteProgress("finished", result)
    assert read_progress(json.loads(json.dumps(progress_document(progress)))) == progress
