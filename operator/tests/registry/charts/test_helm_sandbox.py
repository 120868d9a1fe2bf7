"""Charts that nobody trusts, rendered by the real helm: no network, no files of the machine, no end without a bound."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.charts.adapters.helm import SANDBOX, HelmProgram
from robotkube.registry.charts.core.unpacking import unpack_chart
from tests.stages.paths import REPOSITORY
from tests.stages.programs import program

pytestmark = pytest.mark.toolchain

CHARTS = REPOSITORY / "charts" / "apps"
CHART = b"apiVersion: v2\nname: x\nversion: 0.1.0\n"
CONFIG_MAP = "apiVersion: v1\nkind: ConfigMap\nmetadata: {name: {{ .Release.Name }}}\ndata: {a: {{ %s | quote }}}\n"


@pytest.fixture
def helm(tmp_path: Path) -> HelmProgram:
    return HelmProgram(program("helm"), tmp_path)


def chart(template: str, **files: str) -> dict[str, bytes]:
    content = {"Chart.yaml": CHART, "templates/a.yaml": template.encode()}
    return content | {name.replace("__", "."): text.encode() for name, text in files.items()}


def rendered(helm: HelmProgram, expression: str, values: Mapping[str, Any] | None = None) -> str:
    [item] = helm.render(chart(CONFIG_MAP % expression), values or {}, "one", "suite")
    return str(item["data"]["a"])


def test_a_chart_of_the_platform_is_rendered(helm: HelmProgram) -> None:
    packed = pack(CHARTS / "mqtt-bridge", {"mqtt-bridge": "forge/robotkube/mqtt-bridge@sha256:" + "0" * 64})
    files = unpack_chart("mqtt-bridge", packed.manifest, packed.config, packed.archive).files
    agent = {"placement": {"agent": "vehicle-00"}}
    objects = helm.render(files, agent, "mqtt-bridge", "robotkube-suite-0")
    assert sorted(item["kind"] for item in objects) == ["ConfigMap", "Deployment"]
    with pytest.raises(InputError, match=r"helm template: (.|\n)*placement"):
        helm.render(files, {"placement": {"agent": 5}}, "mqtt-bridge", "robotkube-suite-0")


def test_values_release_and_namespace_arrive(helm: HelmProgram) -> None:
    assert rendered(helm, ".Values.a.b", {"a": {"b": "{{ no template }}"}}) == "{{ no template }}"
    assert rendered(helm, "printf `%s/%s` .Release.Namespace .Release.Name") == "suite/one"


def test_nothing_of_the_machine_is_seen(helm: HelmProgram) -> None:
    assert rendered(helm, '.Files.Get "/etc/passwd"') == ""
    assert rendered(helm, '.Files.Get "../values.json"') == ""
    assert rendered(helm, 'lookup "v1" "Secret" "robotkube" "gate-key" | toJson') == "{}"
    assert rendered(helm, 'getHostByName "localhost"') == ""
    with pytest.raises(InputError, match='function "env" not defined'):
        rendered(helm, 'env "HOME"')


@pytest.mark.parametrize(
    ("schema", "words"),
    [
        ('{"$ref": "http://127.0.0.1:1/x.json"}', r"\$ref 'http://127.0.0.1:1/x.json' leads outside the file"),
        ('{"properties": {"a": {"$ref": "file:///etc/passwd"}}}', "leads outside the file"),
        ('{"allOf": [{"$dynamicRef": "other.json"}]}', "leads outside the file"),
        ('{"$schema": "http://127.0.0.1:1/meta"}', "leads outside the file"),
        ("[" * 100_000, "no JSON"),
        ("{" + '"a": {' * 100 + "}" * 101, "nested deeper"),
    ],
)
def test_schemas_that_lead_elsewhere_are_refused(helm: HelmProgram, schema: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        helm.render(chart("", values__schema__json=schema), {}, "one", "suite")


@pytest.mark.parametrize("path", ["../x", "/etc/x", "templates/../../x", ""])
def test_paths_that_lead_elsewhere_are_refused(helm: HelmProgram, path: str) -> None:
    with pytest.raises(InputError, match="not a path inside a chart"):
        helm.render({"Chart.yaml": CHART, path: b""}, {}, "one", "suite")


@pytest.mark.parametrize(
    ("template", "words"),
    [
        ("{{ range until 200000000 }}{{ . }}{{ end }}", "out of memory|memory or time was not enough|renders to more"),
        ('{{ define "a" }}{{ include "a" . }}{{ end }}{{ include "a" . }}', "helm template"),
        ('{{ repeat 3000000 "x" | printf "a: %s" }}', "renders to more than"),
        ("a: &b [1]\nc: *b\n", "anchors and aliases"),
        ("- a\n- b\n", "every YAML document must be a mapping|helm template"),
        ("a: 1\na: 2\n", "stands twice"),
    ],
)
def test_templates_without_measure(template: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words):
        HelmProgram(program("helm"), tmp_path, seconds=5).render(chart(template), {}, "one", "suite")


def test_too_many_files(helm: HelmProgram) -> None:
    with pytest.raises(InputError, match="more than 1000 files"):
        helm.render({"Chart.yaml": CHART, **{str(number): b"" for number in range(1001)}}, {}, "one", "suite")


def test_a_missing_program_is_not_the_charts_fault(tmp_path: Path) -> None:
    files = chart("")
    with pytest.raises(UnavailableError, match="nowhere"):
        HelmProgram("/nowhere/helm", tmp_path).render(files, {}, "one", "suite")


def test_a_chart_is_refused_for_what_it_takes_of_a_processor(tmp_path: Path) -> None:
    endless = "{{ range until 100000 }}{{ range until 100000 }}{{ end }}{{ end }}"
    with pytest.raises(
        InputError, match=r"ended with -9 \(memory or time was not enough\); make its templates simpler"
    ):
        HelmProgram(program("helm"), tmp_path, seconds=2).render(chart(endless), {}, "one", "suite")


def test_a_program_that_does_not_end_is_not_the_charts_fault(tmp_path: Path) -> None:
    silent = tmp_path / "helm"
    silent.write_text("#!/bin/sh\nexec /bin/sleep 600\n")
    silent.chmod(0o755)
    with pytest.raises(UnavailableError, match=r"could not be rendered within 0\.5 s; try again later"):
        HelmProgram(str(silent), tmp_path, clock_seconds=0.5).render(chart(""), {}, "one", "suite")


def confined(*command: str) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-I", "-S", str(SANDBOX), "5", str(512 << 20), str(1 << 20), *command]
    return subprocess.run(words, capture_output=True, text=True, timeout=20, check=False)


@pytest.mark.parametrize("family", ["AF_INET", "AF_INET6", "AF_UNIX", "AF_NETLINK"])
def test_the_program_has_no_sockets(family: str) -> None:
    done = confined(sys.executable, "-c", f"import socket; socket.socket(socket.{family})")
    assert "PermissionError" in done.stderr
    assert confined(sys.executable, "-c", "print('runs')").stdout == "runs\n"


def test_helm_itself_reaches_nobody(tmp_path: Path) -> None:
    """The same schema that is refused before helm starts, given to helm: it cannot ask."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.2)
        folder = tmp_path / "chart"
        folder.mkdir()
        (folder / "Chart.yaml").write_bytes(CHART)
        port = server.getsockname()[1]
        (folder / "values.schema.json").write_text(f'{{"$ref": "http://127.0.0.1:{port}/x.json"}}')
        done = confined(program("helm"), "template", "one", str(folder))
        assert "operation not permitted" in done.stderr
        with pytest.raises(TimeoutError):
            server.accept()


def test_what_the_program_may_take() -> None:
    assert confined(sys.executable, "-c", "bytes(1 << 30)").returncode != 0
    assert confined(sys.executable, "-c", "open('/dev/null').close()").returncode == 0
    assert (
        "File too large"
        in confined(
            sys.executable,
            "-c",
            "import tempfile; f = tempfile.TemporaryFile(buffering=0); f.write(bytes(2 << 20)); f.write(b'x')",
        ).stderr
    )
