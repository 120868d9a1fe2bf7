"""The registry's client says who it is as the registry wants: with nothing, with the account, or by a token for the
scope that is needed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.core.challenges import Challenge, chosen, read_challenges, scope_of
from robotkube.registry.charts.core.packing import pack_chart
from tests.stages.registry.asking_registry import PASSWORD, USER, AskingRegistry, running
from tests.stages.registry.made_archives import write_archive

CHART = pack_chart("app", {"name": "app", "version": "0.1.0"}, {"Chart.yaml": b"name: app\nversion: 0.1.0\n"})
DIGEST = CHART.digest


@contextmanager
def client(asking: AskingRegistry, user: str = USER, password: str = PASSWORD) -> Iterator[OciRegistry]:
    with running(asking), OciRegistry(asking.url, user, password) as registry:
        yield registry


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        (
            'Bearer realm="https://ghcr.io/token",service="ghcr.io",scope="repository:user/image:pull"',
            [
                (
                    "bearer",
                    {"realm": "https://ghcr.io/token", "service": "ghcr.io", "scope": "repository:user/image:pull"},
                )
            ],
        ),
        (
            'Bearer realm="https://gitlab.example/jwt/auth", service="container_registry", error="invalid_token"',
            [
                (
                    "bearer",
                    {
                        "realm": "https://gitlab.example/jwt/auth",
                        "service": "container_registry",
                        "error": "invalid_token",
                    },
                )
            ],
        ),
        (
            'Basic realm="a \\"quoted\\", name", Bearer realm=plain,service=x',
            [("basic", {"realm": 'a "quoted", name'}), ("bearer", {"realm": "plain", "service": "x"})],
        ),
        ("Negotiate", [("negotiate", {})]),
        ('Bearer realm="never ended', [("bearer", {})]),
        ('="', []),
        ("", []),
    ],
)
def test_challenges_are_read(header: str, expected: list[tuple[str, dict[str, str]]]) -> None:
    challenges = [(challenge.scheme, dict(challenge.parameters)) for challenge in read_challenges([header])]
    assert [(scheme, parameters) for scheme, parameters in challenges][: len(expected)] == expected


def test_the_account_itself_is_shown_where_that_is_offered() -> None:
    both = [Challenge("bearer"), Challenge("basic")]
    assert chosen(both, has_account=True) == Challenge("basic")
    assert chosen(both, has_account=False) == Challenge("bearer")
    assert chosen([Challenge("basic")], has_account=False) is None
    assert chosen([Challenge("negotiate")], has_account=True) is None


def test_what_a_request_needs() -> None:
    assert scope_of("GET", "/v2/a/b/manifests/1") == "repository:a/b:pull"
    assert scope_of("HEAD", "/v2/a/blobs/sha256:x") == "repository:a:pull"
    assert scope_of("POST", "/v2/a/blobs/uploads/") == "repository:a:pull,push"
    assert scope_of("DELETE", "/v2/a/manifests/1") == "repository:a:delete"
    assert scope_of("GET", "/v2/") == ""


def test_a_token_is_got_once_for_each_scope() -> None:
    asking = AskingRegistry()
    with client(asking) as registry:
        assert registry.push_chart("robots", CHART) == DIGEST
        assert registry.pull_chart("robots/app", DIGEST).archive == CHART.archive
        registry.push_chart("robots", CHART)
    assert [question["scope"] for question in asking.asked] == [
        ["repository:robots/app:pull"],
        ["repository:robots/app:pull,push"],
    ]
    assert all(question["service"] == ["registry"] for question in asking.asked)
    assert asking.refused == 2, "each scope is asked for once, and no request more"
    assert {scheme for _, _, scheme in asking.seen} == {"", "Bearer"}, "the account is shown to who gives tokens alone"


def test_layers_are_streamed_with_a_token(tmp_path: Path) -> None:
    asking = AskingRegistry()
    digest = write_archive(tmp_path / "image.tar", [b"layer" * 500_000])
    with client(asking) as registry:
        assert registry.push_image("robots/image", tmp_path / "image.tar") == digest
    assert len(asking.blobs) == 2


def test_a_token_that_ends_is_replaced_before(tmp_path: Path) -> None:
    asking = AskingRegistry(seconds=5)
    digest = write_archive(tmp_path / "image.tar", [b"layer" * 500_000])
    with client(asking) as registry:
        registry.push_image("robots/image", tmp_path / "image.tar")
        assert registry.manifest_digest("robots/image", digest) == digest
    assert asking.refused == 2, "later requests come with a token that is new"


def test_a_token_that_ended_early_is_replaced_after() -> None:
    asking = AskingRegistry(seconds=None)
    with client(asking) as registry:
        registry.push_chart("robots", CHART)
        asking.forget_tokens()
        assert registry.manifest_digest("robots/app", "0.1.0") == DIGEST


def test_the_forge_takes_the_account_itself() -> None:
    asking = AskingRegistry(basic=True)
    with client(asking) as registry:
        registry.push_chart("robots", CHART)
    assert (asking.asked, asking.refused) == ([], 1)


def test_nobody_gets_a_token_where_that_is_enough() -> None:
    asking = AskingRegistry(anonymous=True)
    with client(asking, user="", password="") as registry:
        assert registry.manifest_digest("robots/app", DIGEST) is None


def test_a_registry_that_does_not_ask_is_shown_nothing() -> None:
    asking = AskingRegistry(tokens=False)
    with client(asking) as registry:
        registry.push_chart("robots", CHART)
    assert {scheme for _, _, scheme in asking.seen} == {""}


def test_a_wrong_account_is_named() -> None:
    for asking in (AskingRegistry(), AskingRegistry(tokens=False, basic=True)):
        with client(asking, password="other") as registry, pytest.raises(InputError, match="account robot"):  # noqa: S106
            registry.manifest_digest("robots/app", DIGEST)
        assert asking.refused <= 2, "it is not tried again and again"


def test_the_account_is_not_shown_to_what_is_no_address() -> None:
    for realm in ("ftp://127.0.0.1/token", "not an address", "https://"):
        asking = AskingRegistry(realm=realm)
        with client(asking) as registry, pytest.raises(InputError, match="which is no address of http or https"):
            registry.manifest_digest("robots/app", DIGEST)


def test_who_gives_tokens_is_away() -> None:
    asking = AskingRegistry(realm="http://127.0.0.1:9/token")
    with client(asking) as registry, pytest.raises(UnavailableError, match=r"127\.0\.0\.1:9/token"):
        registry.manifest_digest("robots/app", DIGEST)
