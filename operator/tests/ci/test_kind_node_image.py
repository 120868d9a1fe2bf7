"""The image of kind's nodes: versions, archives, which engine gets it, and what is said when it cannot be made."""

from __future__ import annotations

import gzip
import hashlib
import json
import re
import sys
import tarfile
from pathlib import Path

import pytest

from ci import toolchain
from ci.errors import SetUpError
from ci.kind_node_image import __main__ as command
from ci.kind_node_image import engines, naming
from ci.kind_node_image.archives import MadeImage, layer, stored, write
from ci.kind_node_image.component_images import sandbox_image
from tests.stages.paths import REPOSITORY

pytestmark = pytest.mark.toolchain

KUBERNETES = re.compile(r"^\s*(k8s\.io/\S+) (?:=> k8s\.io/\S+ )?(v\S+)$", re.MULTILINE)


def of_kubernetes(module: Path) -> dict[str, str]:
    """Kubernetes' modules in a go.mod, as replaced at its end."""
    return dict(KUBERNETES.findall((module / "go.mod").read_text(encoding="utf-8").replace("require k8s.io", "k8s.io")))


def test_kubeadm_is_of_the_tool_chains_kubernetes() -> None:
    ours, theirs = (of_kubernetes(REPOSITORY / "ci" / name) for name in ("kind_node_image/kubeadm", "toolchain"))
    assert ours["k8s.io/kubernetes"] == naming.kubernetes_version()
    assert {name for name in ours.keys() & theirs if ours[name] != theirs[name]} == set()


def test_its_name_says_kubernetes_version_and_what_it_is_made_of(monkeypatch: pytest.MonkeyPatch) -> None:
    name = naming.reference()
    assert re.fullmatch(rf"localhost/robotkube-kind-node:{re.escape(naming.kubernetes_version())}-[0-9a-f]{{12}}", name)
    monkeypatch.setattr(toolchain, "key", lambda: "another")
    assert naming.reference().partition("-node:")[0] == name.partition("-node:")[0]
    assert naming.reference() != name


def test_the_tool_chain_does_not_depend_on_it() -> None:
    assert [path for path in toolchain.building.inputs() if "kind" in str(path.relative_to(REPOSITORY))] == []


def test_an_archive_has_a_shared_layer_once_and_digests_of_what_is_in_it(tmp_path: Path) -> None:
    folder = tmp_path / "content"
    (folder / "bin").mkdir(parents=True)
    (folder / "bin" / "program").write_bytes(b"#!/bin/sh\n")
    shared, again = (layer(folder, tmp_path / name) for name in ("one.gz", "again.gz"))
    assert shared.file.read_bytes() == again.file.read_bytes()
    (folder / "bin" / "program").write_bytes(b"another")
    other = layer(folder, tmp_path / "other.gz")
    images = [
        MadeImage(("localhost/one:1", "localhost/two:1"), (shared,), {"Env": ["A=B"]}),
        MadeImage(("localhost/three:1",), (shared, other), {}),
    ]
    write(tmp_path / "archive.tar", images)
    with tarfile.open(tmp_path / "archive.tar") as archive:
        files = {name: archive.extractfile(name).read() for name in archive.getnames()}
    assert len(files) == 2 + 2 + 1
    one, two = json.loads(files["manifest.json"])
    assert (one["RepoTags"], two["RepoTags"]) == (["localhost/one:1", "localhost/two:1"], ["localhost/three:1"])
    assert two["Layers"][:1] == one["Layers"]
    for entry in (one, two):
        assert hashlib.sha256(files[entry["Config"]]).hexdigest() == entry["Config"].removesuffix(".json")
        digests = [f"sha256:{hashlib.sha256(gzip.decompress(files[name])).hexdigest()}" for name in entry["Layers"]]
        assert json.loads(files[entry["Config"]])["rootfs"]["diff_ids"] == digests
    assert json.loads(files[one["Config"]])["config"] == {"Env": ["A=B"]}


def test_a_layer_that_cannot_be_written_says_why(tmp_path: Path) -> None:
    with pytest.raises(SetUpError, match=r"tar -C .*: tar: .*nowhere: Cannot open: No such file"):
        layer(tmp_path / "nowhere", tmp_path / "layer.gz")
    with pytest.raises(SetUpError, match="tar -c absent: tar: absent: Cannot stat"):
        stored(["tar", "-c", "absent"], tmp_path / "layer.tar", compressed=False)


def test_the_image_of_sandboxes_is_the_one_that_kind_names() -> None:
    assert sandbox_image('[plugins]\n  sandbox_image = "registry.k8s.io/pause:3.10"\n') == "registry.k8s.io/pause:3.10"
    with pytest.raises(SetUpError, match="name no sandbox_image: this version of kind is not known here"):
        sandbox_image("[plugins]\n")


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only folder of programs."""
    folder = tmp_path / "programs"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.delenv(engines.CHOICE, raising=False)
    return folder


def answering(folder: Path, name: str, answer: str) -> None:
    (folder / name).write_text(f"#!{sys.executable}\nprint({answer!r})\n", encoding="utf-8")
    (folder / name).chmod(0o755)


def test_the_engine_is_the_one_that_kind_finds(programs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert engines.found() == ""
    assert not engines.has(engines.found(), "localhost/any:1")
    answering(programs, "podman", "podman version 4.3.1")
    assert engines.found() == "podman"
    answering(programs, "docker", "podman version 4.3.1")  # podman's stand-in for docker: kind takes podman itself
    assert engines.found() == "podman"
    answering(programs, "docker", "Docker version 20.10.24+dfsg1, build 297e128")
    assert engines.found() == "docker"
    monkeypatch.setenv(engines.CHOICE, "podman")
    assert engines.found() == "podman"
    monkeypatch.setenv(engines.CHOICE, "nerdctl")
    assert engines.found() == ""


def test_an_engine_that_does_not_run_is_said_before_anything_is_built(
    programs: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    program = programs / "docker"
    lines = ["import sys", "if sys.argv[1] == '-v':", "    sys.exit(print('Docker version 29.0.1'))"]
    lines += ["sys.exit('Cannot connect to the Docker daemon. Is the docker daemon running?')"]
    program.write_text("\n".join([f"#!{sys.executable}", *lines, ""]), encoding="utf-8")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "argv", ["kind_node_image"])
    assert command.main() == 3
    assert "docker is there and cannot be used: Cannot connect to the Docker daemon" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ([], 3, "kind finds neither Docker nor podman here: install one of them .* make kind-node-image ARCHIVE=FILE"),
        (["--archive", "nowhere/image.tar"], 1, "nowhere/image.tar: there is no folder nowhere; make it"),
    ],
)
def test_what_is_lacking_is_said_before_anything_is_built(
    words: list[str],
    code: int,
    said: str,
    programs: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["kind_node_image", *words])
    assert command.main() == code
    assert re.search(said, capsys.readouterr().err)
