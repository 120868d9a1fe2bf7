"""The registry's client against a registry that lies, never ends, or is written by others at the same time."""

from __future__ import annotations

import gzip
import json
import threading
import urllib.parse
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.core.packing import PackedChart, pack_chart
from robotkube.registry.charts.core.referrers import ARTEFACT_BYTES_MAX, ARTEFACTS_MAX, ATTACHED_BYTES_MAX, fallback_tag

METADATA = {"apiVersion": "v2", "name": "app", "version": "0.1.0"}
CHART = pack_chart("app", METADATA, {"Chart.yaml": json.dumps(METADATA).encode()})
STAGING = "staging/app"
KIND = "application/vnd.in-toto+json"
PIECE = b"x" * (1 << 20)


class FakeRegistry:
    """Manifests and blobs in memory. `content` is path below /v2/ -> body; `endless` the path of an answer without end;
    `lost`: how many of the next writes of an index are taken and forgotten."""

    def __init__(self) -> None:
        self.content: dict[str, bytes] = {}
        self.headers: dict[str, str] = {}
        self.endless = ""
        self.lost = 0
        self.writes: list[str] = []
        self.before_write: Callable[[str], None] = lambda path: None
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_HEAD(self) -> None:
                self._answer(200 if self._path() in outer.content else 404, b"")

            def do_GET(self) -> None:
                path = self._path()
                if path == outer.endless:
                    return self._without_end()
                return self._answer(200 if path in outer.content else 404, outer.content.get(path, b""))

            def do_POST(self) -> None:
                self._answer(202, b"", {"Location": f"/v2/{self._path()}session"})

            def do_PUT(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                query = urllib.parse.parse_qs(urllib.parse.urlsplit(self.path).query)
                path = self._path().replace("uploads/session", query.get("digest", [""])[0])
                outer.put(path, body)
                self._answer(201, b"")

            def _path(self) -> str:
                return urllib.parse.urlsplit(self.path).path.removeprefix("/v2/")

            def _answer(self, code: int, body: bytes, headers: dict[str, str] | None = None) -> None:
                self.send_response(code)
                for name, value in {"Content-Length": str(len(body)), **outer.headers, **(headers or {})}.items():
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(body)

            def _without_end(self) -> None:
                self.send_response(200)
                self.end_headers()
                try:
                    while True:
                        self.wfile.write(PIECE)
                except OSError:  # the client had enough
                    self.close_connection = True

            def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"

    def put(self, path: str, body: bytes) -> None:
        self.before_write(path)
        self.writes.append(path)
        if "/manifests/sha256-" in path and self.lost:
            self.lost -= 1
            return
        self.content[path] = body

    def hold(self, repository: str, chart: PackedChart = CHART) -> None:
        self.content[f"{repository}/manifests/{chart.digest}"] = chart.manifest
        for blob in (chart.config, chart.archive):
            self.content[f"{repository}/blobs/{sha256(blob)}"] = blob

    def stop(self) -> None:
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture
def fake() -> Iterator[FakeRegistry]:
    started = FakeRegistry()
    started.hold(STAGING)
    yield started
    started.stop()


@pytest.fixture
def registry(fake: FakeRegistry) -> Iterator[OciRegistry]:
    with OciRegistry(fake.url, "gate", "password") as client:
        yield client


INDEX = f"{STAGING}/manifests/{fallback_tag(CHART.digest)}"


def attach(registry: OciRegistry, name: str) -> str:
    return registry.attach(STAGING, CHART.digest, KIND, name.encode(), {"name": name})


def names(registry: OciRegistry) -> list[str]:
    return [attachment.annotations["name"] for attachment in registry.attachments(STAGING, CHART.digest)]


def test_an_honest_registry_gives_the_chart(registry: OciRegistry) -> None:
    assert registry.pull_chart(STAGING, CHART.digest).manifest == CHART.manifest


def test_other_bytes_than_the_digest_are_not_taken(fake: FakeRegistry, registry: OciRegistry) -> None:
    other = pack_chart("app", METADATA, {"Chart.yaml": json.dumps(METADATA).encode(), "values.yaml": b"evil: true\n"})
    fake.content[f"{STAGING}/blobs/{sha256(CHART.archive)}"] = other.archive
    with pytest.raises(InputError, match=f"blob {sha256(CHART.archive)} of {STAGING} "):
        registry.pull_chart(STAGING, CHART.digest)
    fake.content[f"{STAGING}/manifests/{CHART.digest}"] = other.manifest
    with pytest.raises(InputError, match=f"{CHART.digest} is {other.digest}; it cannot be trusted"):
        registry.pull_chart(STAGING, CHART.digest)


@pytest.mark.parametrize("kind", ["manifests", "blobs"])
def test_an_answer_without_end_is_cut_off(fake: FakeRegistry, registry: OciRegistry, kind: str) -> None:
    fake.endless = f"{STAGING}/{kind}/{CHART.digest if kind == 'manifests' else sha256(CHART.archive)}"
    with pytest.raises(InputError, match=r"is longer than \d+ bytes; it is not read"):
        registry.pull_chart(STAGING, CHART.digest)


def test_a_compressed_answer_is_not_unpacked(fake: FakeRegistry, registry: OciRegistry) -> None:
    fake.content[f"{STAGING}/manifests/{CHART.digest}"] = gzip.compress(b"\0" * (8 << 20))
    fake.headers["Content-Encoding"] = "gzip"
    with pytest.raises(InputError, match="cannot be trusted"):
        registry.pull_chart(STAGING, CHART.digest)


@pytest.mark.parametrize(
    ("index", "expected"),
    [
        (b"{", "not readable as JSON"),
        (b"[" * 100_000, "not readable as JSON"),
        (b"{}", f"no index of at most {ARTEFACTS_MAX} artefacts"),
        (b'{"manifests": [{}]}', "not named by media type and sha256 digest"),
        (canonical_json({"manifests": [{"digest": "x"}] * (ARTEFACTS_MAX + 1)}), f"at most {ARTEFACTS_MAX} artefacts"),
    ],
    ids=["cut off", "deep", "empty", "no digest", "too many"],
)
def test_an_index_of_another_form_is_refused(
    fake: FakeRegistry, registry: OciRegistry, index: bytes, expected: str
) -> None:
    fake.content[INDEX] = index
    with pytest.raises(InputError, match=expected):
        registry.attachments(STAGING, CHART.digest)


def test_an_artefact_about_another_chart_is_refused(fake: FakeRegistry, registry: OciRegistry) -> None:
    other = pack_chart("app", METADATA, {"Chart.yaml": json.dumps(METADATA).encode(), "values.yaml": b"a: 1\n"})
    fake.hold(STAGING, other)
    attach(registry, "static")
    fake.content[f"{STAGING}/manifests/{fallback_tag(other.digest)}"] = fake.content[INDEX]
    with pytest.raises(InputError, match=f"it is not attached to {other.digest}"):
        registry.attachments(STAGING, other.digest)


def test_an_index_that_names_what_is_gone_is_refused(fake: FakeRegistry, registry: OciRegistry) -> None:
    digest = attach(registry, "static")
    del fake.content[f"{STAGING}/manifests/{digest}"]
    with pytest.raises(InputError, match=f"{STAGING} lists {digest} but does not have it"):
        registry.attachments(STAGING, CHART.digest)


def test_what_is_attached_already_is_not_written_again(fake: FakeRegistry, registry: OciRegistry) -> None:
    attach(registry, "static")
    written = list(fake.writes)
    attach(registry, "static")
    assert fake.writes == written


def test_a_lost_write_is_done_again(fake: FakeRegistry, registry: OciRegistry) -> None:
    attach(registry, "static")
    fake.lost = 2
    attach(registry, "images")
    assert names(registry) == ["static", "images"]


def test_a_writer_elsewhere_loses_nothing_of_ours(fake: FakeRegistry, registry: OciRegistry) -> None:
    """Another writer, without our lock, puts its own index after ours was read: ours comes back, and its line stays."""
    attach(registry, "theirs")
    theirs = fake.content[INDEX]
    del fake.content[INDEX]
    overwritten = []

    def overwrite(path: str) -> None:
        if path == INDEX and len(overwritten) < 2:
            overwritten.append(fake.content.get(INDEX))
            fake.content[INDEX] = theirs

    fake.before_write = overwrite
    fake.lost = 1
    attach(registry, "ours")
    assert names(registry) == ["theirs", "ours"]


def test_a_list_that_never_stays_is_given_up(fake: FakeRegistry, registry: OciRegistry) -> None:
    fake.lost = 1000
    with pytest.raises(UnavailableError, match="others kept changing it; 5 tries"):
        attach(registry, "static")
    assert fake.lost == 995


def test_a_subject_has_at_most_so_many(fake: FakeRegistry, registry: OciRegistry) -> None:
    attach(registry, "static")
    index = json.loads(fake.content[INDEX])
    line = index["manifests"][0]
    others = [line | {"digest": sha256(str(number).encode())} for number in range(ARTEFACTS_MAX - 1)]
    fake.content[INDEX] = canonical_json(index | {"manifests": [line, *others]})
    with pytest.raises(InputError, match=f"more than {ARTEFACTS_MAX} artefacts would be attached"):
        attach(registry, "one more")


def test_attachments_are_bounded_together(registry: OciRegistry) -> None:
    for number in range(ATTACHED_BYTES_MAX // ARTEFACT_BYTES_MAX):
        data = bytes([number]) * ARTEFACT_BYTES_MAX
        registry.attach(STAGING, CHART.digest, KIND, data, {"name": str(number)})
    assert len(registry.attachments(STAGING, CHART.digest)) == ATTACHED_BYTES_MAX // ARTEFACT_BYTES_MAX
    attach(registry, "one more")
    with pytest.raises(InputError, match=f"more than {ATTACHED_BYTES_MAX} bytes are attached"):
        registry.attachments(STAGING, CHART.digest)


def test_evidence_is_there_before_the_chart(fake: FakeRegistry, registry: OciRegistry) -> None:
    digest = attach(registry, "static")
    fake.writes.clear()
    registry.copy_chart(STAGING, "verified/app", CHART.digest, "0.1.0", [digest])
    manifests = [path for path in fake.writes if "/manifests/" in path]
    expected = [digest, fallback_tag(CHART.digest), "0.1.0"]
    assert manifests == [f"verified/app/manifests/{reference}" for reference in expected]
    fake.writes.clear()
    registry.copy_chart(STAGING, "verified/app", CHART.digest, "0.1.0", [digest])
    assert fake.writes == []
