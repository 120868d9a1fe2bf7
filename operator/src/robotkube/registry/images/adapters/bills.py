"""Writes the bill of materials of an image (CycloneDX, JSON) and attaches it to the image in the registry.

An image's layers, compressed or not, are looked through for what its packages leave behind: dpkg's status (debsbom
reads it), metadata of Python distributions (cyclonedx-py reads it), programs in `/`, `/usr/local/bin` and `/opt/*/bin`,
of which Go's say by `go version -m` what they were built from, and ELF files, each by path and hash. That is what the
suite `images` compares. The same image gives the same bytes: no times, no random numbers.
"""

from __future__ import annotations

import json
import mmap
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import uuid
import venv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import IO, Any, Protocol

from robotkube.errors import InputError
from robotkube.registry.images.adapters.buildah import BuildError
from robotkube.registry.images.adapters.normalising import EPOCH_TEXT, canonical_json
from robotkube.registry.suites.adapters.image_layers import ELF, KeptContents, read_layer
from robotkube.registry.suites.core.image_checks import BILL_TYPE
from robotkube.registry.suites.core.image_contents import Entry, contents_of

FORMAT = "2"  # part of the file's name: raise it when other bytes are written for the same image
FILE = f"bill-{FORMAT}.json"
SPECIFICATION = "1.6"
TOOL_SECONDS_MAX = 120
KEPT_MAX = 16  # parsed lists of packages: images on the same base share theirs
DPKG = "var/lib/dpkg/status"
DPKG_FILES = frozenset({DPKG, "var/lib/dpkg/arch-native", "var/lib/apt/extended_states"})
DISTRIBUTION = re.compile(r"(?:.*/)?([^/]+\.dist-info)/(METADATA|direct_url\.json)")
PROGRAM = re.compile(r"[^/]+|usr/local/bin/[^/]+|opt/[^/]+/bin/[^/]+")
GO_BUILD = b"\xff Go buildinf:"
VERSION_LABEL = "org.opencontainers.image.version"
NO_SERIAL_NUMBER = str(uuid.UUID(int=0))

Component = dict[str, Any]


class Attaching(Protocol):
    """The registry, as far as bills need it."""

    def attach(
        self, repository: str, subject: str, artifact_type: str, data: bytes, annotations: Mapping[str, str]
    ) -> str:
        """Attach `data` to the manifest `subject`."""
        ...


def attach_bill(registry: Attaching, repository: str, digest: str, archive: Path) -> str:
    """Attach the bill that lies beside `archive` to the image `digest`, which is in the registry; the same again
    changes nothing. Returns the digest of the attached artefact."""
    path = archive.with_name(FILE)
    if not path.is_file():
        raise InputError(f"{path}: missing; build the images again: make images")
    return attach_document(registry, repository, digest, path.read_bytes())


def attach_document(registry: Attaching, repository: str, digest: str, bill: bytes) -> str:
    """Attach `bill` to the image `digest`; the digest of the attached artefact."""
    return registry.attach(repository, digest, BILL_TYPE, bill, bill_annotations(repository.rpartition("/")[2]))


def bill_annotations(image: str) -> dict[str, str]:
    """What the artefact of a bill says about itself: the same for the same image wherever it is."""
    return {"org.opencontainers.image.title": f"bill of materials of {image}"}


def ensure_bill(archive: Path, name: str, digest: str, ground: Path | None = None) -> Path:
    """The bill beside `archive`, made when it is not there; `ground`: the archive that has its other layers."""
    path = archive.with_name(FILE)
    if not path.is_file():
        part = path.with_suffix(".part")
        part.write_bytes(make_bill(archive, name, digest, ground))
        part.replace(path)
    return path


def make_bill(archive: Path, name: str, digest: str, ground: Path | None = None) -> bytes:
    """The bill of the image `digest`, called `name`, that `archive` (an OCI layout in a tar) holds; layers that are not
    in it are in that of `ground`."""
    with ExitStack() as opened:
        folder = opened.enter_context(tempfile.TemporaryDirectory(prefix="robotkube-bill-"))
        archives = [archive, *([ground] if ground else [])]
        image = _Image([opened.enter_context(tarfile.open(path, "r:")) for path in archives], digest)
        files = image.read(Path(folder))
        lists = [_debian(files), _python(files), _programs(files, image.version), _elf_files(files)]
    return canonical_json(_document(name, image.version, digest, [one for one in lists if one]))


@dataclass(frozen=True)
class _ImageFiles:
    """Files of an image by path without a leading slash; those that are read lie in `folder`, named by their
    SHA-256."""

    folder: Path
    entries: Mapping[str, Entry]

    @property
    def paths(self) -> frozenset[str]:
        """Files that can be read."""
        return frozenset(path for path, entry in self.entries.items() if self._place(entry).is_file())

    def place(self, path: str) -> Path:
        return self._place(self.entries[path])

    def read(self, path: str) -> bytes:
        return self.place(path).read_bytes() if path in self.entries else b""

    def _place(self, entry: Entry) -> Path:
        return self.folder / (entry.sha256 or "not-kept")


class _Image:
    """An image inside OCI layouts, one or several; `version` is that of its label."""

    def __init__(self, layouts: Sequence[tarfile.TarFile], digest: str) -> None:
        self._layouts = layouts
        self._manifest = json.loads(self._blob(digest).read())
        labels = json.loads(self._blob(self._manifest["config"]["digest"]).read())["config"].get("Labels") or {}
        self.version = labels.get(VERSION_LABEL, "")

    def _blob(self, digest: str) -> IO[bytes]:
        path = "blobs/" + digest.replace(":", "/")
        for layout in self._layouts:
            content = layout.extractfile(path) if path in layout.getnames() else None
            if content:
                return content
        raise BuildError(f"{self._layouts[0].name!r}: no blob {digest}; build the image again")

    def read(self, folder: Path) -> _ImageFiles:
        """What the image's layers leave; `folder` gets the files that tools read."""
        kept = KeptContents(_is_read, folder)
        layers = [read_layer(_pieces(self._blob(layer["digest"])), kept) for layer in self._manifest["layers"]]
        return _ImageFiles(folder, {path[1:]: entry for path, entry in contents_of(layers).files.items()})


def _is_read(path: str, head: bytes) -> bool:
    """Return whether a tool reads the file of that path and first bytes."""
    if path in DPKG_FILES or DISTRIBUTION.fullmatch(path):
        return True
    return head == ELF and PROGRAM.fullmatch(path) is not None


def _pieces(content: IO[bytes]) -> Iterator[bytes]:
    while piece := content.read(1 << 20):
        yield piece


@dataclass(frozen=True)
class _Listed:
    """Components that one tool lists."""

    components: tuple[Component, ...]
    dependencies: tuple[Component, ...] = ()
    tools: tuple[Component, ...] = ()


def _debian(files: _ImageFiles) -> _Listed | None:
    if DPKG not in files.paths:
        return None
    return _debian_of(tuple((path, files.read(path)) for path in sorted(DPKG_FILES & files.paths)))


@lru_cache(KEPT_MAX)
def _debian_of(files: tuple[tuple[str, bytes], ...]) -> _Listed:
    with tempfile.TemporaryDirectory(prefix="robotkube-bill-") as folder:
        for path, data in files:
            (Path(folder) / path).parent.mkdir(parents=True, exist_ok=True)
            (Path(folder) / path).write_bytes(data)
        fixed = ["--timestamp", EPOCH_TEXT.removesuffix("Z"), "--cdx-serialnumber", NO_SERIAL_NUMBER]
        words = ["-m", "debsbom.cli", "generate", "--sbom-type", "cdx", "--root", folder, "--out", "-", *fixed]
        return _listed(_run([sys.executable, *words, "--cdx-schema-version", SPECIFICATION]))


def _python(files: _ImageFiles) -> _Listed | None:
    """cyclonedx-py reads an environment, so the metadata are put into an empty one."""
    metadata = [(path, match) for path in sorted(files.paths) if (match := DISTRIBUTION.fullmatch(path))]
    if not metadata:
        return None
    with tempfile.TemporaryDirectory(prefix="robotkube-bill-") as folder:
        venv.create(folder, symlinks=True, with_pip=False)
        packages = next(Path(folder).glob("lib/python*/site-packages"))
        for path, match in metadata:
            (packages / match[1]).mkdir(exist_ok=True)
            (packages / match[1] / match[2]).write_bytes(files.read(path))
        words = ["-m", "cyclonedx_py", "environment", "--output-reproducible", "--no-validate", "--sv", SPECIFICATION]
        return _listed(_run([sys.executable, *words, "--of", "JSON", "-o", "-", f"{folder}/bin/python"]))


def _listed(text: str) -> _Listed:
    bill = json.loads(text)
    system = [bill["metadata"]["component"]] if "component" in bill["metadata"] else []
    return _Listed(
        tuple(system + bill.get("components", [])),
        tuple(bill.get("dependencies", [])),
        tuple(bill["metadata"].get("tools", {}).get("components", [])),
    )


def _programs(files: _ImageFiles, version: str) -> _Listed | None:
    programs = sorted(path for path in files.paths if PROGRAM.fullmatch(path) and files.entries[path].is_elf)
    if not programs:
        return None
    components = [component for path in programs for component in _program(files.place(path), path, version)]
    return _Listed(tuple({one["bom-ref"]: one for one in components}.values()))


def _elf_files(files: _ImageFiles) -> _Listed:
    """Every ELF file, in the image's packages or not."""
    return _Listed(
        tuple(
            {"type": "file", "name": f"/{path}", "hashes": [{"alg": "SHA-256", "content": entry.sha256}]}
            for path, entry in files.entries.items()
            if entry.is_elf
        )
    )


def _program(file: Path, path: str, version: str) -> Iterator[Component]:
    """The program itself, whose SHA-256 is the name of `file`, and the Go modules it was built from."""
    with file.open("rb") as content, mmap.mmap(content.fileno(), 0, access=mmap.ACCESS_READ) as data:
        of_go = data.find(GO_BUILD) >= 0
    yield {
        "type": "application",
        "bom-ref": f"program:/{path}",
        "name": path.rpartition("/")[2],
        "version": version,
        "hashes": [{"alg": "SHA-256", "content": file.name}],
    }
    for module, release in _modules(file) if of_go else ():
        purl = f"pkg:golang/{module}@{release}"
        yield {"type": "library", "bom-ref": purl, "name": module, "version": release, "purl": purl}


def _modules(file: Path) -> Iterator[tuple[str, str]]:
    """Go modules in a program with their versions, after replacements."""
    modules: list[tuple[str, str]] = []
    for line in _run(["go", "version", "-m", str(file)]).splitlines():
        words = line.split("\t")
        if len(words) < 4 or words[1] not in ("mod", "dep", "=>"):
            continue
        if words[1] == "=>":
            modules.pop()
        modules.append((words[2], words[3]))
    yield from sorted(set(modules))


def _run(command: Sequence[str]) -> str:
    """Standard output of a tool, run without this process's search path, which would count as the image's."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment |= {"GOTOOLCHAIN": "local"}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=TOOL_SECONDS_MAX, check=False, env=environment
        )
    except FileNotFoundError as error:
        raise InputError(f"there is no program {command[0]}, which bills of materials need: install it") from error
    if "No module named" in done.stderr:
        raise InputError(f"{done.stderr.strip()}; bills of materials need it: pip install 'robotkube[images]'")
    if done.returncode:
        raise BuildError(f"{' '.join(command[:4])} ended with code {done.returncode}: {done.stderr.strip()[-800:]}")
    return done.stdout


def _document(name: str, version: str, digest: str, lists: Sequence[_Listed]) -> dict[str, Any]:
    number = digest.removeprefix("sha256:")
    image = {
        "type": "container",
        "bom-ref": f"pkg:oci/{name}@sha256%3A{number}",
        "name": name,
        "version": version,
        "purl": f"pkg:oci/{name}@sha256%3A{number}",
        "hashes": [{"alg": "SHA-256", "content": number}],
    }
    return {
        "$schema": f"http://cyclonedx.org/schema/bom-{SPECIFICATION}.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": SPECIFICATION,
        "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, digest)}",
        "version": 1,
        "metadata": {"component": image, "tools": {"components": _sorted(one.tools for one in lists)}},
        "components": _sorted(one.components for one in lists),
        "dependencies": _sorted(one.dependencies for one in lists),
    }


def _sorted(lists: Iterable[Sequence[Component]]) -> list[Component]:
    """All of them, in an order that depends on nothing but their contents."""
    return sorted((one for each in lists for one in each), key=canonical_json)
