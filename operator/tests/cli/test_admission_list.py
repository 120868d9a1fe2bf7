"""`robotkube registry admission` against a catalogue on a disk."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from robotkube.cli.main import main
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from tests.stages.registry.admission_examples import digest, image
from tests.stages.registry.signed_evidence import artefact, catalogue, entry, published, signing_key, trusting

REPOSITORY = "robotkube/catalogue.git"


@pytest.fixture
def arguments(tmp_path: Path) -> list[str]:
    (tmp_path / "password").write_text("word\n")
    subprocess.run(["git", "init", "-q", "--bare", "-b", "main", str(tmp_path / REPOSITORY)], check=True, timeout=30)
    given = {"keys": tmp_path / "keys", "forge-url": f"file://{tmp_path}", "password-file": tmp_path / "password"}
    return [
        "registry",
        "admission",
        *(word for name, value in given.items() for word in (f"--{name}", str(value))),
    ]


def push(folder: Path, files: dict[str, str]) -> None:
    work = folder / "work"
    subprocess.run(["git", "init", "-q", "-b", "main", str(work)], check=True, timeout=30)
    for path, text in files.items():
        (work / path).parent.mkdir(parents=True, exist_ok=True)
        (work / path).write_text(text)
    who = ["-c", "user.name=gate", "-c", "user.email=gate@example.org"]
    for words in (["add", "-A"], [*who, "commit", "-qm", "some"], ["push", "-q", str(folder / REPOSITORY), "main"]):
        subprocess.run(["git", "-C", str(work), *words], check=True, timeout=30)


def test_it_prints_what_a_trusted_key_signed_and_says_what_is_left_out(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    key = signing_key(tmp_path / "key")
    app = artefact()
    trusting(tmp_path / "keys", key)
    unsigned = entry(artefact("other"), images=(image(3),))
    push(tmp_path, catalogue(published(key, app, images=(image(1),)), unsigned))
    assert main([*arguments, "--output", "yaml"]) == 0
    printed = capsys.readouterr()
    document = read_mapping(printed.out, "output")
    assert (document["kind"], document["metadata"]["name"]) == ("ConfigMap", "admission-list")
    assert document["metadata"]["namespace"] == "robotkube"
    assert document["data"] == {
        f"image.{digest(1).removeprefix('sha256:')}": "",
        f"chart.app.{app.digest.removeprefix('sha256:')}": "",
    }
    assert "other@0.1.0@" in printed.err
    assert "is not listed: summary: there is none" in printed.err
    assert "robotkube: 1 charts, 1 images" in printed.err


def test_without_a_catalogue_there_is_no_list(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trusting(tmp_path / "keys", signing_key(tmp_path / "key"))
    assert main(arguments) == 2
    assert "has no main branch yet: publish a chart first" in capsys.readouterr().err
