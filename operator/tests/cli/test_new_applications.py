"""`robotkube registry new`: what it writes is in order as it is, and what cannot be written leaves nothing behind."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from robotkube.cli.main import main
from robotkube.registry.catalogue.core.links.chains import SERVICES_MAX
from tests.stages.registry.own_image_sources import with_example
from tests.stages.registry.publications import write_sources

SERVICES = ("order", "plan", "drive")
SECONDS_MAX = 60
New = Callable[..., tuple[int, str]]


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """A folder with the application `delivery` of three services."""
    write_sources(tmp_path, "delivery", "--services", ",".join(SERVICES))
    return tmp_path


@pytest.fixture
def new(sources: Path, capsys: pytest.CaptureFixture[str]) -> New:
    """Runs the command in the folder; exit code and stderr."""
    where = ["--charts", str(sources / "charts" / "apps"), "--registry", str(sources / "registry")]

    def _new(*words: str) -> tuple[int, str]:
        capsys.readouterr()
        return main(["registry", "new", *words, *where]), capsys.readouterr().err

    return _new


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def test_each_service_has_a_chart_a_program_a_dockerfile_and_tests(sources: Path) -> None:
    for service in SERVICES:
        chart = sources / "charts" / "apps" / f"delivery-{service}"
        made = {"Chart.yaml", "Dockerfile", "files/node.py", "files/answers.py", f"tests/test_delivery_{service}.py"}
        assert made <= files(chart)
        assert (sources / "registry" / "charts" / f"delivery-{service}" / "0.1.0.yaml").is_file()
    assert "__" not in (sources / "registry" / "applications" / "delivery.yaml").read_text()


def test_the_example_in_the_dockerfile_is_root_for_run_and_not_at_the_end(sources: Path) -> None:
    lines = with_example((sources / "charts" / "apps" / "delivery-plan" / "Dockerfile").read_text()).splitlines()
    words = [line.split()[0] for line in lines if line and not line.startswith("#")]
    assert [word for word in words if word in ("USER", "RUN")] == ["USER", "RUN", "USER"]
    assert [line for line in lines if line.startswith("USER ")] == ["USER 0:0", "USER 10001:10001"]


def test_the_services_are_a_chain_from_the_input_to_the_output(sources: Path) -> None:
    spec = yaml.safe_load((sources / "registry" / "applications" / "delivery.yaml").read_text())["spec"]
    topics = [(one["values"]["relay"]["input"], one["values"]["relay"]["output"]) for one in spec["services"]]
    assert topics == [
        ("{{ parameters.input }}", "/delivery/order"),
        ("/delivery/order", "/delivery/plan"),
        ("/delivery/plan", "{{ parameters.output }}"),
    ]
    assert [(link["from"]["service"], link["to"]["service"]) for link in spec["links"]] == [
        ("order", "plan"),
        ("plan", "drive"),
    ]


def test_what_it_writes_has_no_mistakes(sources: Path, capsys: pytest.CaptureFixture[str]) -> None:
    where = ["--charts", str(sources / "charts" / "apps"), "--registry", str(sources / "registry")]
    assert main(["registry", "validate", *where]) == 0, capsys.readouterr().out


def test_its_tests_pass_together(sources: Path) -> None:
    (sources / "pytest.ini").write_text("[pytest]\nfilterwarnings = error\n")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "charts/apps"]
    done = subprocess.run(command, cwd=sources, capture_output=True, text=True, timeout=SECONDS_MAX, check=False)
    assert done.returncode == 0, done.stdout
    assert "12 passed" in done.stdout


def test_its_tests_fail_when_the_program_does_something_else(sources: Path) -> None:
    chart = sources / "charts" / "apps" / "delivery-plan"
    answers = chart / "files" / "answers.py"
    answers.write_text(answers.read_text().replace("return text", "return None"))
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "charts/apps"]
    done = subprocess.run(command, cwd=sources, capture_output=True, text=True, timeout=SECONDS_MAX, check=False)
    assert done.returncode == 1
    assert "3 failed, 9 passed" in done.stdout
    assert "test_delivery_plan.py" in done.stdout


def test_one_service_needs_no_link(new: New, sources: Path) -> None:
    assert new("single", "--services", "a") == (0, "")
    spec = yaml.safe_load((sources / "registry" / "applications" / "single.yaml").read_text())["spec"]
    assert "links" not in spec
    assert (sources / "charts" / "apps" / "single-a").is_dir()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["Other", "--services", "a"], "NAME 'Other': use 2 to 30 lower-case letters"),
        (["other", "--services", ""], "--services: service '': use lower-case letters"),
        (["other", "--services", "a,,b"], "--services: service '': use lower-case letters"),
        (["other", "--services", "a,b,a"], "--services: service 'a' stands twice; give each a name of its own"),
        (["other", "--services", "a,B"], "--services: service 'B': use lower-case letters"),
        (["other", "--services", "a,1b"], "--services: service '1b': use lower-case letters"),
        (["other", "--services", "a,b_c"], "--services: service 'b_c': use lower-case letters"),
        (["other", "--services", "a,../b"], "--services: service '../b': use lower-case letters"),
        (["other", "--services", "a,b-"], "--services: service 'b-': use lower-case letters"),
        (["other", "--services", "a," + "b" * 25], "which may have 30 characters; shorten one of the names"),
        (["other", "--services", ",".join(f"s{i}" for i in range(SERVICES_MAX + 1))], "9 services; give 1 to 8"),
        (["other", "--services", "a", "--provides", "No Word"], "--provides 'No Word': use words"),
    ],
)
def test_a_wrong_name_is_refused_and_nothing_is_written(new: New, sources: Path, words: list[str], said: str) -> None:
    before = files(sources)
    code, error = new(*words)
    assert (code, said in error) == (2, True), error
    assert files(sources) == before


def test_everything_wrong_is_said_at_once(new: New) -> None:
    code, error = new("other", "--services", "A,b,b", "--provides", "-x y")
    assert code == 2
    assert all(part in error for part in ("service 'A'", "service 'b' stands twice", "--provides '-x y'"))


@pytest.mark.parametrize(
    "place", ["charts/apps/other-b", "registry/charts/other-b", "registry/applications/other.yaml"]
)
def test_what_is_there_is_left_as_it_is(new: New, sources: Path, place: str) -> None:
    (sources / place).mkdir()
    before = files(sources)
    code, error = new("other", "--services", "a,b")
    assert (code, f"{sources / place}: there already; choose another name" in error) == (1, True), error
    assert files(sources) == before


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (OSError(28, "No space left on device", "values.yaml"), 2, "values.yaml: No space left on device; nothing was"),
        (KeyboardInterrupt(), 1, ""),
    ],
)
def test_a_write_that_ends_half_way_leaves_nothing(
    new: New, sources: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int, said: str
) -> None:
    before = files(sources)
    written = Path.write_text

    def write_text(path: Path, *more: object, **options: object) -> int:
        if path.match("other-b/values.yaml"):
            raise error
        return written(path, *more, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(Path, "write_text", write_text)
    got, words = new("other", "--services", "a,b")
    assert (got, said in words) == (code, True), words
    assert files(sources) == before


def test_a_dry_run_says_the_files_and_writes_none(new: New, sources: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = files(sources)
    assert new("other", "--services", "a,b", "--dry-run")[0] == 0
    assert files(sources) == before
