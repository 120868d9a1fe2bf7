"""What the preflight reads besides the API server: the chart, values, Helm's revisions, and registries."""

from __future__ import annotations

import base64
import gzip
import json
import ssl
import tarfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.preflight.adapters.chart_sources import read_chart, read_values
from robotkube.delivery.preflight.adapters.helm_releases import last_revision
from robotkube.delivery.preflight.adapters.registry_answers import RegistryQuestions
from robotkube.delivery.preflight.core.releases import HelmRevision
from robotkube.delivery.preflight.core.values import completed, merged, without_value
from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.issuing import issue, new_authority
from robotkube.foundation.documents.adapters.json_schema import violations
from tests.stages.handshakes import server_context, written
from tests.stages.paths import CHARTS

CHART = CHARTS / "robotkube"


def test_the_chart_as_a_folder_with_what_its_links_lead_to(tmp_path: Path) -> None:
    chart = read_chart(CHART)
    assert chart.metadata["name"] == "robotkube"
    assert any(name.startswith("files/catalogue/policies/") for name in chart.files)
    assert (chart.defaults["storage"], chart.schema["additionalProperties"]) == ({"className": ""}, False)
    archive = tmp_path / "robotkube-0.1.0.tgz"
    with tarfile.open(archive, "w:gz", dereference=True) as packed:
        packed.add(CHART, arcname="robotkube")
    assert read_chart(archive).files["Chart.yaml"] == chart.files["Chart.yaml"]


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("", "", "there is no such chart; name its folder or archive with --chart"),
        ("x.tgz", "text", "no archive of a chart"),
        ("Chart.yaml", "name: mqtt-bridge", "is chart mqtt-bridge; name that of the platform, robotkube, with --chart"),
        ("README.md", "text", "holds no Chart.yaml"),
        ("Chart.yaml", "a: {", "line 1: not readable as YAML"),
    ],
)
def test_what_is_no_chart(tmp_path: Path, name: str, text: str, words: str) -> None:
    (tmp_path / (name or "other")).write_text(text)
    path = tmp_path / "nowhere" if not name else tmp_path / name if name.endswith(".tgz") else tmp_path
    with pytest.raises(InputError, match=words):
        read_chart(path)


def test_values_of_several_files(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("one: &list [1]\nbelow: {a: 1, b: 2}\nsame: *list\n")
    (tmp_path / "b.yaml").write_text("below: {b: 3}\none: [2]\n")
    (tmp_path / "empty.yaml").write_text("# nothing\n")
    files = [tmp_path / f"{name}.yaml" for name in ("a", "b", "empty")]
    assert read_values(files) == {"one": [2], "below": {"a": 1, "b": 3}, "same": [1]}
    with pytest.raises(InputError, match="No such file or directory; name a file of values with --values"):
        read_values([tmp_path / "c.yaml"])
    (tmp_path / "list.yaml").write_text("[1]")
    with pytest.raises(InputError, match="not a map of keys"):
        read_values([tmp_path / "list.yaml"])


def test_defaults_below_values() -> None:
    assert completed({"a": {"x": 1, "y": 2}, "b": 1}, {"a": {"y": None, "z": 3}, "b": [1]}) == {
        "a": {"x": 1, "z": 3},
        "b": [1],
    }
    assert merged({"a": {"x": 1}}, {"a": None}) == {"a": None}
    upon = merged({"a": {"x": 1, "y": [1]}, "b": 1}, {"a": {"y": [2]}, "c": 3})
    assert upon == {"a": {"x": 1, "y": [2]}, "b": 1, "c": 3}


def test_words_of_the_schema_do_not_repeat_a_value() -> None:
    settings = {"secrets": {"seed": ["hunter2"]}}
    schema = {"properties": {"secrets": {"properties": {"seed": {"type": "string"}}}}}
    [(path, words)] = violations(schema, settings)
    assert without_value(words, settings, path) == "this value is not of type 'string'"


def revision(number: int, status: str, **more: Any) -> dict[str, Any]:
    document = {
        "version": number,
        "info": {"status": status},
        "chart": {"metadata": {"version": "0.1.0"}},
        "config": {"secrets": {"seed": "hunter2"}},
        **more,
    }
    text = base64.b64encode(base64.b64encode(gzip.compress(json.dumps(document).encode()))).decode()
    metadata = {"name": f"sh.helm.release.v1.robotkube.v{number}", "labels": {"version": str(number)}}
    return {"metadata": metadata, "data": {"release": text}}


def test_the_last_revision_of_a_release() -> None:
    last = last_revision([revision(9, "superseded"), revision(10, "deployed")])
    assert last == HelmRevision("0.1.0", "deployed", 10, {"secrets": {"seed": "hunter2"}})
    assert "hunter2" not in repr(last)
    assert last_revision([]) is None


@pytest.mark.parametrize("data", [{}, {"release": "?"}, {"release": base64.b64encode(b"eHg=").decode()}, None])
def test_a_revision_that_is_none(data: Any) -> None:
    with pytest.raises(InputError, match="holds no revision of Helm that is understood"):
        last_revision([{**revision(1, "deployed"), "data": data}])


@contextmanager
def registry(
    status: int, challenge: str, context: ssl.SSLContext | None = None, api: str = "registry/2.0"
) -> Iterator[str]:
    """The host and port of a server that answers /v2/ so."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(status if self.path == "/v2/" else 500)
            self.send_header("WWW-Authenticate", challenge)
            self.send_header("Docker-Distribution-Api-Version", api)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *arguments: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    if context is not None:
        server.socket = context.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield f"127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def test_a_registry_is_believed_by_its_authority(tmp_path: Path) -> None:
    authority = new_authority("registry", time.time())
    context = server_context(tmp_path, issue(authority, ["127.0.0.1"], time.time(), 3600))
    with registry(401, 'Bearer realm="https://me:secret@auth.example/token"', context) as host:
        answer = RegistryQuestions(written(tmp_path / "authority", authority)).ask(host)
        assert (answer.status, answer.challenge) == (401, 'Bearer realm="https://auth.example/token"')
        assert "certificate verify failed" in RegistryQuestions().ask(host).refused


def test_a_registry_inside_of_the_cluster_is_asked_in_clear_text() -> None:
    with registry(401, 'Basic realm="forge"') as host:
        assert RegistryQuestions().ask_service(host).status == 401
        assert RegistryQuestions().ask(host).refused, "others by HTTPS alone"
    assert "is not reached from here" in RegistryQuestions().ask_service(host).silent
    with registry(403, "", api="") as stranger:
        assert "is not reached from here" in RegistryQuestions().ask_service(stranger).silent, "another's address"
    assert "Connection refused" in RegistryQuestions().ask(host).refused


def test_an_authority_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "ca.pem").write_text("text")
    for name in ("ca.pem", "nowhere.pem"):
        with pytest.raises(InputError, match=f"{name}: no certificate of an authority as PEM"):
            RegistryQuestions(tmp_path / name)
