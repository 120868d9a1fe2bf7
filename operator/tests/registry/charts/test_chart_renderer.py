"""The renderer that stays: it renders what helm renders, and outlives every chart."""

import json
import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.errors import InputError, UnavailableError
from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.charts.adapters.chart_renderer import ChartRenderer
from robotkube.registry.charts.adapters.helm import HelmProgram
from robotkube.registry.charts.core.pod_images import pod_images
from robotkube.registry.charts.core.unpacking import unpack_chart
from tests.stages.forge.real_charts import chart_with_image_value
from tests.stages.paths import CHARTS
from tests.stages.programs import program
from tests.stages.registry import chart_images

pytestmark = pytest.mark.toolchain

PROFILES = Path(__file__).parents[2] / "charts" / "profiles"
IMAGE = "forge:3000/robotkube/ros@sha256:" + "1" * 64
FOREIGN = "docker.io/library/busybox@sha256:" + "2" * 64
NAMES = ("mqtt-bridge", "event-detector", "bag-player", "object-detection", "object-tracking")
METADATA = b"apiVersion: v2\nname: app\nversion: 0.1.0\n"


@pytest.fixture(scope="module")
def renderer() -> Iterator[ChartRenderer]:
    running = ChartRenderer(program("chart-renderer"))
    yield running
    running.close()


def chart(template: str, **files: str) -> dict[str, bytes]:
    more = {path.replace("__", "/"): text.encode() for path, text in files.items()}
    return {"Chart.yaml": METADATA, "templates/pod.yaml": template.encode(), **more}


def packed(folder: Path) -> dict[str, bytes]:
    archive = pack(folder, chart_images.all_as(IMAGE))
    return dict(unpack_chart(folder.name, archive.manifest, archive.config, archive.archive).files)


@pytest.mark.parametrize("name", NAMES)
def test_it_renders_what_helm_renders(renderer: ChartRenderer, name: str, tmp_path: Path) -> None:
    files = packed(CHARTS / "apps" / name)
    values = yaml.safe_load((PROFILES / f"{name}.yaml").read_text())
    values = {**values, "global": {"plan": "20261121-100000-000001"}}
    by_helm = HelmProgram(program("helm"), tmp_path).render(files, values, "one", "vehicle-00")
    by_renderer = renderer.render(files, values, "one", "vehicle-00")
    assert sorted(by_renderer, key=json.dumps) == sorted(by_helm, key=json.dumps)
    assert by_renderer
    assert len(pod_images(by_renderer)) == 1


def test_an_image_in_values_is_what_would_run(renderer: ChartRenderer, tmp_path: Path) -> None:
    files = packed(chart_with_image_value(tmp_path))
    values = {"placement": {"agent": "vehicle-00"}}
    assert pod_images(renderer.render(files, values, "one", "vehicle-00")) == (IMAGE,)
    values = {**values, "image": {"reference": FOREIGN}}
    assert pod_images(renderer.render(files, values, "one", "vehicle-00")) == (FOREIGN,)


@pytest.mark.parametrize("name", NAMES)
def test_no_value_of_a_chart_of_ours_names_an_image(renderer: ChartRenderer, name: str) -> None:
    values = {**yaml.safe_load((PROFILES / f"{name}.yaml").read_text()), "image": {"reference": FOREIGN}}
    assert pod_images(renderer.render(packed(CHARTS / "apps" / name), values, "one", "vehicle-00")) == (IMAGE,)


HOSTILE: dict[str, tuple[dict[str, bytes], str]] = {
    "a template without an end": (
        chart("{{ range until 100000000 }}{{ . }}{{ end }}"),
        "was not rendered within 2 s of a processor",
    ),
    "a template that fails": (chart('{{ fail "no" }}'), "the chart cannot be rendered: execution error"),
    "a key that stands twice": (
        chart(f"kind: Pod\nspec:\n  containers:\n  - image: {IMAGE}\n    image: {FOREIGN}\n"),
        'key "image" already set in map',
    ),
    "no chart": ({"README.md": b"x"}, "Chart.yaml file is missing"),
    "no YAML": (chart("kind: [Pod"), "the chart cannot be rendered: app/templates/pod.yaml"),
    "too much": (chart('a: {{ repeat 3000000 "x" }}'), "renders to more than 2097152 bytes"),
    "too deep": (
        chart('a: {{ repeat 3000 "[" }}{{ repeat 3000 "]" }}'),
        "the chart cannot be rendered: its objects are nested deeper than 100 levels; write it flatter",
    ),
    "something after the end of a document": (
        chart("kind: A\n...\nkind: B\n"),
        "app/templates/pod.yaml: something follows the end of a document (...); begin the next one with ---",
    ),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_it_outlives(what: str) -> None:
    running = ChartRenderer(program("chart-renderer"), seconds=2)
    files, words = HOSTILE[what]
    try:
        good = chart("kind: Pod\nmetadata: {name: {{ .Release.Name }}}\n")
        assert running.render(good, {}, "one", "n") == [{"kind": "Pod", "metadata": {"name": "one"}}]
        with pytest.raises(InputError) as refused:
            running.render(files, {}, "one", "n")
        assert words in str(refused.value)
        assert running.render(good, {}, "two", "n") == [{"kind": "Pod", "metadata": {"name": "two"}}]
    finally:
        running.close()


def test_a_chart_reads_nothing_of_the_machine(renderer: ChartRenderer) -> None:
    template = (
        'file: {{ .Files.Get "/etc/passwd" | quote }}\nabove: {{ .Files.Get "../../etc/passwd" | quote }}\n'
        'cluster: {{ lookup "v1" "Secret" "a" "b" | toJson }}\nname: {{ getHostByName "localhost" | quote }}\n'
    )
    assert renderer.render(chart(template), {}, "one", "n") == [{"file": "", "above": "", "cluster": {}, "name": ""}]


def test_definitions_hooks_and_every_document_of_a_file_are_objects(renderer: ChartRenderer) -> None:
    two = "kind: A\n---\n# nothing\n---\nkind: B\nmetadata: {annotations: {helm.sh/hook: pre-install}}\n"
    objects = renderer.render(chart(two, crds__c="kind: C", templates__NOTES="x"), {}, "one", "n")
    assert [item["kind"] for item in objects if "kind" in item] == ["A", "B"]
    objects = renderer.render({**chart(two), "crds/c.yaml": b"kind: C\n", "templates/NOTES.txt": b"x"}, {}, "one", "n")
    assert sorted(item["kind"] for item in objects) == ["A", "B", "C"]


def test_no_name_of_a_file_hides_an_object_that_would_be_applied(renderer: ChartRenderer, tmp_path: Path) -> None:
    """helm takes a leading underscore for a partial in templates/ alone, and for notes whatever ends as they do."""
    pod = f"kind: Pod\nspec: {{containers: [{{image: {FOREIGN}}}]}}\n".encode()
    files = {
        **chart("kind: A\n"),
        "crds/_pod.yaml": pod,
        "templates/_pod.yaml": pod,
        "templates/more-NOTES.txt": b"kind: Note",
    }
    objects = renderer.render(files, {}, "one", "n")
    assert pod_images(objects) == (FOREIGN,)
    assert sorted(objects, key=json.dumps) == sorted(
        HelmProgram(program("helm"), tmp_path).render(files, {}, "one", "n"), key=json.dumps
    )


def status(renderer: ChartRenderer) -> dict[str, str]:
    process: Any = renderer._process
    lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
    return {key: value.strip() for key, _, value in (line.partition(":") for line in lines)}


def test_its_process_has_given_its_rights_up(renderer: ChartRenderer) -> None:
    renderer.render(chart("kind: A"), {}, "one", "n")
    rights = status(renderer)
    assert (rights["NoNewPrivs"], rights["Seccomp"]) == ("1", "2")
    assert int(rights["Seccomp_filters"]) == 2  # no sockets, by the sandbox; nothing to open at all, by itself


def test_without_its_program_nothing_is_blamed_on_a_chart(tmp_path: Path) -> None:
    missing = ChartRenderer(str(tmp_path / "chart-renderer"))
    with pytest.raises(UnavailableError, match=r"charts cannot be rendered: .*cannot be started"):
        missing.render(chart("kind: A"), {}, "one", "n")


ENDLESS = "{{ range until 100000 }}{{ range until 100000 }}{{ end }}{{ end }}"
"""Of little memory, and of hours."""


def test_a_chart_is_refused_for_what_it_takes_of_a_processor() -> None:
    running = ChartRenderer(program("chart-renderer"), seconds=1)
    try:
        running.render(chart("kind: A"), {}, "one", "n")
        process: Any = running._process
        with pytest.raises(InputError, match="was not rendered within 1 s of a processor"):
            running.render(chart(ENDLESS), {}, "one", "n")
        assert process.returncode == -signal.SIGKILL, "it did not end by itself, as for want of memory"
    finally:
        running.close()


def test_of_the_clock_a_chart_may_take_more_than_of_a_processor(tmp_path: Path) -> None:
    """On a machine that does other things a process waits: nothing is blamed on the chart."""
    running = ChartRenderer(program("chart-renderer"), seconds=0.5)
    try:
        running.render(chart("kind: A"), {}, "one", "n")
        process: Any = running._process
        os.kill(process.pid, signal.SIGSTOP)
        going_on = threading.Timer(1.5, os.kill, (process.pid, signal.SIGCONT))
        going_on.start()
        assert running.render(chart("kind: B"), {}, "one", "n") == [{"kind": "B"}]
        going_on.join()
        assert running._process is process
    finally:
        running.close()


def test_without_an_answer_nothing_is_blamed_on_a_chart(tmp_path: Path) -> None:
    silent = tmp_path / "chart-renderer"
    silent.write_text("#!/bin/sh\nexec /bin/sleep 600\n")
    silent.chmod(0o755)
    running = ChartRenderer(str(silent), clock_seconds=0.5)
    with pytest.raises(UnavailableError, match=r"a chart could not be rendered within 0\.5 s; try again later"):
        running.render(chart("kind: A"), {}, "one", "n")
    assert running._process is None


def test_a_process_that_was_killed_is_replaced(renderer: ChartRenderer) -> None:
    renderer.render(chart("kind: A"), {}, "one", "n")
    process: Any = renderer._process
    os.kill(process.pid, 9)
    process.wait(10)
    assert renderer.render(chart("kind: B"), {}, "one", "n") == [{"kind": "B"}]
