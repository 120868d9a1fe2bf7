"""Images of services: only what their processes import, on layers that all of them share, and a change in one service
leaves the digests of the others as they are."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
import subprocess
import sys
import tarfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml

from ci.images import cutting
from ci.images.built import REPOSITORY
from ci.images.catalogue import BY_NAME
from ci.images.services import (
    LIBRARY,
    PREFIX,
    SERVICES,
    Service,
    entry_points,
    modules_of,
    read_sources,
    starts,
)
from robotkube.registry.images.adapters import bills, normalising
from robotkube.registry.images.adapters.buildah import BuildError
from tests.stages.paths import CHARTS, REGISTRY

COMMANDS = entry_points()
MANAGER = "robotkube/delivery/manager/__main__.py"  # no service imports it
NAMES = [service.name for service in SERVICES]
STARTED = (("run", "m:f"),)
BELOW = ({"etc/debian_version": b"12\n"}, {f"{LIBRARY}/rclpy/__init__.py": b"ROS\n"})


@cache
def needed() -> Mapping[str, frozenset[str]]:
    """Service -> the modules that its image has."""
    everything = read_sources()
    return {service.name: modules_of(service, everything, COMMANDS) for service in SERVICES}


@cache
def sources() -> Mapping[str, bytes]:
    """What any service's image has, and one module that none has."""
    everything = read_sources()
    return {path: everything[path] for path in sorted({MANAGER, *frozenset().union(*needed().values())})}


def layer(files: Mapping[str, bytes]) -> bytes:
    raw = io.BytesIO()
    with tarfile.open(fileobj=raw, mode="w") as tar:
        for path, content in files.items():
            info = tarfile.TarInfo(path)
            info.size = len(content)
            info.mode = 0o755 if "/bin/" in path else 0o644
            tar.addfile(info, io.BytesIO(content))
    return raw.getvalue()


def ground_of(folder: Path, files: Mapping[str, bytes]) -> cutting.Ground:
    """An archive like that of `ros`, with few bytes below the package."""
    folder.mkdir()
    commands = {f"{PREFIX}/bin/{name}": f"start {module}\n".encode() for name, module in COMMANDS.items()}
    package = {f"{LIBRARY}/{path}": content for path, content in files.items()}
    package |= {cached(path): b"code of " + text for path, text in files.items() if path.endswith(".py")}

    def put(data: bytes) -> dict[str, Any]:
        digest = hashlib.sha256(data).hexdigest()
        (folder / digest).write_bytes(data)
        return {"digest": f"sha256:{digest}", "size": len(data)}

    settings = {"Env": ["A=1"], "User": "10001:10001", "Cmd": ["python3"], "Labels": {cutting.TITLE: "robotkube ros"}}
    config = put(json.dumps({"architecture": "amd64", "os": "linux", "config": settings}).encode())
    layers = [put(layer(one)) for one in (*BELOW, {**package, **commands})]
    (folder / "manifest.json").write_text(json.dumps({"config": config, "layers": layers}))
    normalising.normalise_image(folder, folder / "image.tar", f"{REPOSITORY}/ros")
    return cutting.read_ground(folder / "image.tar")


def cached(path: str) -> str:
    parent, _, name = path.rpartition("/")
    return f"{LIBRARY}/{parent}/__pycache__/{name.removesuffix('.py')}.cpython-311.pyc"


def cut(folder: Path, service: Service, ground: cutting.Ground, package: Mapping[str, bytes]) -> tuple[Path, Any]:
    files = modules_of(service, package, COMMANDS)
    archive = folder / service.name / "image.tar"
    started = starts(service, COMMANDS)
    name = f"{REPOSITORY}/{service.name}"
    return archive, cutting.write_cut(service, ground, started, files, archive, name)


def cut_all(folder: Path, files: Mapping[str, bytes]) -> dict[str, str]:
    """The digest of each service's image."""
    ground = ground_of(folder, files)
    return {service.name: cut(folder, service, ground, files)[1].digest for service in SERVICES}


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return cut_all(tmp_path_factory.mktemp("images") / "before", sources())


def of_one(name: str) -> list[str]:
    """Modules that one service alone imports."""
    others = frozenset().union(*(files for other, files in needed().items() if other != name))
    return sorted(needed()[name] - others)


@pytest.mark.parametrize("name", NAMES)
def test_a_change_in_one_service_changes_the_digest_of_its_image_alone(
    name: str, before: dict[str, str], tmp_path: Path
) -> None:
    path = of_one(name)[-1]
    after = cut_all(tmp_path / "after", {**sources(), path: sources()[path] + b"\n"})
    assert [one for one in NAMES if after[one] != before[one]] == [name]


def test_what_no_service_imports_changes_no_digest_and_what_all_import_changes_all(
    before: dict[str, str], tmp_path: Path
) -> None:
    shared = "robotkube/foundation/runtime/process.py"
    assert cut_all(tmp_path / "none", {**sources(), MANAGER: b""}) == before
    after = cut_all(tmp_path / "all", {**sources(), shared: sources()[shared] + b"\n"})
    assert [name for name in NAMES if after[name] == before[name]] == []


def test_what_makes_each_service_is_its_own() -> None:
    assert "robotkube/robots/perception/core/detection.py" in of_one("object-detection")
    assert "robotkube/robots/perception/core/tracking.py" in of_one("object-tracking")
    assert "robotkube/robots/bridge/loops/bridge.py" in of_one("mqtt-bridge")
    assert "robotkube/robots/bags/loops/player.py" in of_one("bag-player")
    assert "robotkube/robots/detector/loops/detector.py" in of_one("event-detector")


def test_the_key_follows_what_the_image_is_made_of(tmp_path: Path) -> None:
    ground = ground_of(tmp_path / "ros", sources())
    service = SERVICES[0]
    files = {path: sources()[path] for path in modules_of(service, sources(), COMMANDS)}
    key = cutting.key_of_cut(service, ground, STARTED, files)
    assert cutting.key_of_cut(service, ground, STARTED, dict(reversed(files.items()))) == key
    below = cutting.Ground(ground.archive, {**ground.manifest, "layers": ground.manifest["layers"][1:]}, ground.config)
    others = [
        cutting.key_of_cut(SERVICES[1], ground, STARTED, files),
        cutting.key_of_cut(service, below, STARTED, files),
        cutting.key_of_cut(service, ground, (("run", "m:g"),), files),
        cutting.key_of_cut(service, ground, STARTED, {**files, "robotkube/__init__.py": b"other"}),
        cutting.key_of_cut(service, ground, STARTED, files, "more"),
    ]
    assert len({key, *others}) == 6


def test_the_layer_has_the_modules_their_byte_code_and_the_command_and_says_so(tmp_path: Path) -> None:
    ground = ground_of(tmp_path / "ros", sources())
    service = next(one for one in SERVICES if one.name == "object-tracking")
    archive, image = cut(tmp_path, service, ground, sources())
    with tarfile.open(archive) as layout:
        own = layout.extractfile("blobs/" + image.layers[-1].digest.replace(":", "/"))
        with tarfile.open(fileobj=own) as tar:
            entries = {entry.name: entry for entry in tar}
            contents = {n: tar.extractfile(e).read() for n, e in entries.items() if e.isreg()}  # type: ignore[union-attr]
    modules = modules_of(service, sources(), COMMANDS)
    program, folder = f"{PREFIX}/bin/{service.command}", f"{LIBRARY}/robotkube_object_tracking-0.2.0.dist-info"
    written = {f"{folder}/{name}" for name in ("METADATA", "RECORD", "entry_points.txt")}
    code = {cached(path) for path in modules if path.endswith(".py")}
    assert contents.keys() == {*(f"{LIBRARY}/{path}" for path in modules), *code, program, *written}
    assert (entries[program].mode, {entry.uid for entry in entries.values()}) == (0o755, {0})
    assert {entry.mtime for entry in entries.values()} == {normalising.EPOCH_SECONDS}
    rows = dict(row.rsplit(",", 2)[:2] for row in contents[f"{folder}/RECORD"].decode().splitlines())
    assert len(rows) == len(contents)
    digest = base64.urlsafe_b64encode(hashlib.sha256(contents[program]).digest()).rstrip(b"=").decode()
    assert rows[f"../../../bin/{service.command}"] == f"sha256={digest}"
    assert f"{service.command} = {COMMANDS[service.command]}" in contents[f"{folder}/entry_points.txt"].decode()


def test_the_configuration_is_that_of_the_ground_with_a_name_and_version_of_its_own(tmp_path: Path) -> None:
    ground = ground_of(tmp_path / "ros", sources())
    service = next(one for one in SERVICES if one.name == "bag-player")
    archive, image = cut(tmp_path, service, ground, sources())
    with tarfile.open(archive) as layout:
        blobs = {name.rpartition("/")[2] for name in layout.getnames() if name.startswith("blobs/")}
        manifest = json.loads(layout.extractfile(f"blobs/{image.digest.replace(':', '/')}").read())  # type: ignore[union-attr]
        path = f"blobs/{manifest['config']['digest'].replace(':', '/')}"
        config = json.loads(layout.extractfile(path).read())  # type: ignore[union-attr]
    assert [entry["digest"] for entry in manifest["layers"]][:-1] == [entry["digest"] for entry in ground.shared]
    assert config["rootfs"]["diff_ids"] == [entry["digest"] for entry in manifest["layers"]]
    assert len(config["history"]) == len(manifest["layers"])
    labels = {cutting.TITLE: "robotkube bag-player", cutting.VERSION: "0.1.0"}
    assert config["config"] == {**ground.config["config"], "Labels": labels, "Cmd": ["robotkube-player"]}
    own = (image.digest, manifest["config"]["digest"], image.layers[-1].digest)
    assert blobs == {digest.removeprefix("sha256:") for digest in own}, "the other layers are in the ground's archive"


def test_a_ground_of_other_sources_is_refused(tmp_path: Path) -> None:
    older = {path: content for path, content in sources().items() if not path.endswith("bags/loops/player.py")}
    ground = ground_of(tmp_path / "ros", older)
    with pytest.raises(BuildError, match=r"image bag-player: ros has no .*player\.py; build both again: make images"):
        cut(tmp_path, SERVICES[0], ground, sources())


def test_every_chart_of_a_service_has_an_image() -> None:
    charts = {path.name for path in (CHARTS / "apps").iterdir() if (path / "values.yaml").exists()}
    assert {service.name for service in SERVICES} == charts
    assert not charts & BY_NAME.keys()


@pytest.mark.parametrize("service", SERVICES, ids=NAMES)
def test_the_commands_of_a_chart_and_of_its_entry_are_in_its_image(service: Service) -> None:
    version = yaml.safe_load((CHARTS / "apps" / service.name / "Chart.yaml").read_text())["version"]
    files = [*(CHARTS / "apps" / service.name / "templates").iterdir()]
    files += [REGISTRY / "charts" / service.name / f"{version}.yaml"]
    words = {word for path in files for word in re.findall(r"\brobotkube-[a-z-]+", path.read_text())}
    assert words & COMMANDS.keys() == set(service.commands)


@pytest.mark.processes
@pytest.mark.parametrize("service", SERVICES, ids=NAMES)
def test_a_service_imports_nothing_that_its_image_has_not(service: Service, tmp_path: Path) -> None:
    """All its modules are imported where no other module of the package is."""
    files = modules_of(service, sources(), COMMANDS)
    for path in files:
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(sources()[path])
    modules = [
        path.removesuffix(".py").replace("/", ".").removesuffix(".__init__") for path in files if path[-3:] == ".py"
    ]
    program = (
        "import importlib, pathlib, sys\n"
        "sys.path[:] = [sys.argv[1], *(p for p in sys.path if not (pathlib.Path(p) / 'robotkube').exists())]\n"
        "sys.meta_path[:] = [f for f in sys.meta_path if 'editable' not in str(f).lower()]\n"
        "for name in sys.argv[2:]:\n    importlib.import_module(name)\n"
        "import robotkube\nprint(robotkube.__file__)\n"
    )
    command = [sys.executable, "-P", "-c", program, str(tmp_path), *sorted(modules)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, f"{tmp_path}/robotkube/__init__.py\n"), done.stderr[-2000:]


@pytest.mark.processes
def test_each_image_has_a_bill_of_its_own(tmp_path: Path) -> None:
    ground = ground_of(tmp_path / "ros", sources())
    for service in SERVICES[:2]:
        archive, image = cut(tmp_path, service, ground, sources())
        bill = json.loads(bills.make_bill(archive, service.name, image.digest, ground.archive))
        about = bill["metadata"]["component"]
        assert (about["name"], about["version"]) == (service.name, service.version)
        assert [one["name"] for one in bill["components"]] == [f"robotkube-{service.name}"]
    with pytest.raises(BuildError, match="no blob sha256:"):
        bills.make_bill(archive, service.name, image.digest)
