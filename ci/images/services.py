"""The images of the application services: what `ros` has, with only those modules of the package that the service's
process imports, and its command.

A service's layer is cut out of the last layer of `ros`; all other layers are those of `ros`, byte by byte. Therefore a
changed module gives a new digest to the services that import it, and to no other.
"""

from __future__ import annotations

import hashlib
import tarfile
import tomllib
from base64 import urlsafe_b64encode
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import PurePosixPath
from typing import IO

from ci.images.catalogue import TOP
from ci.images.closures import closure
from ci.images.contexts import Copied, files_of
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.registry.images.adapters.buildah import BuildError
from robotkube.registry.images.adapters.normalising import EPOCH_SECONDS, Hashing

GROUND = "ros"  # the image that services are cut from
SOURCES = TOP / "operator" / "src"
PACKAGE = "robotkube"
PREFIX = "opt/robotkube"
LIBRARY = f"{PREFIX}/lib/python3.11/site-packages"
CACHED = "__pycache__"


@dataclass(frozen=True)
class Service:
    """A service with an image of its own: `name` is that of image and chart, `command` its console script, `more`
    others that its chart's entry starts, `offered` the modules that others import in its process."""

    name: str
    command: str
    more: tuple[str, ...] = ()
    offered: tuple[str, ...] = ()

    @property
    def commands(self) -> tuple[str, ...]:
        """All console scripts of the image."""
        return (self.command, *self.more)

    @property
    def version(self) -> str:
        """What its chart says the program's version is."""
        path = TOP / "charts" / "apps" / self.name / "Chart.yaml"
        return str(read_mapping(path.read_text(encoding="utf-8"), str(path))["appVersion"])


SERVICES = (
    Service("bag-player", "robotkube-player", more=("robotkube-sample-bag",)),  # what suites give it to play
    Service("event-detector", "robotkube-event-detector", offered=(f"{PACKAGE}.plugins",)),
    Service("mqtt-bridge", "robotkube-bridge"),
    Service("object-detection", "robotkube-object-detection"),
    Service("object-tracking", "robotkube-object-tracking"),
)
SERVICE_NAMES = frozenset(service.name for service in SERVICES)


def read_sources() -> dict[str, bytes]:
    """The package's files, as images get them: path from where imports begin -> content."""
    return {target: path.read_bytes() for path, target, _ in files_of(Copied(SOURCES / PACKAGE, PACKAGE))}


def entry_points() -> Mapping[str, str]:
    """Command -> `module:function`, of all commands of the package."""
    text = (TOP / "operator" / "pyproject.toml").read_text(encoding="utf-8")
    return dict(tomllib.loads(text)["project"]["scripts"])


def modules_of(service: Service, sources: Mapping[str, bytes], commands: Mapping[str, str]) -> frozenset[str]:
    """The paths of `sources` that the service's image has."""
    return closure(sources, [*(start.partition(":")[0] for _, start in starts(service, commands)), *service.offered])


def starts(service: Service, commands: Mapping[str, str]) -> tuple[tuple[str, str], ...]:
    """The commands of the image, each with its `module:function`."""
    unknown = sorted(set(service.commands) - commands.keys())
    if unknown:
        raise BuildError(f"image {service.name}: operator/pyproject.toml has no command {', '.join(unknown)}")
    return tuple((command, commands[command]) for command in service.commands)


def cut_layer(
    service: Service, files: frozenset[str], started: Sequence[tuple[str, str]], ground: IO[bytes], target: Hashing
) -> None:
    """Write the service's layer to `target`: of the layer `ground`, `files` of the package with their byte code and the
    service's commands; and what a package manager would know of it (`started`: commands with `module:function`)."""
    with tarfile.open(fileobj=ground, mode="r:") as source:
        members = {member.name: member for member in source}
        chosen = _chosen(members, files, {f"{PREFIX}/bin/{command}" for command, _ in started})
        contents = {name: _read(source, members[name]) for name in chosen if members[name].isreg()}
    missing = {f"{LIBRARY}/{path}" for path in files} - contents.keys()
    if missing:
        raise BuildError(f"image {service.name}: {GROUND} has no {min(missing)}; build both again: make images")
    contents |= _metadata(service, started, contents)
    with tarfile.open(fileobj=target, mode="w", format=tarfile.PAX_FORMAT) as out:  # type: ignore[call-overload]
        for name in sorted({*contents, *_parents(contents)}):
            out.addfile(_entry(name, contents.get(name), members.get(name)), BytesIO(contents.get(name, b"")))


def _chosen(members: Mapping[str, tarfile.TarInfo], files: frozenset[str], commands: set[str]) -> Iterator[str]:
    """The names of a layer's files that a service needs."""
    for name in members:
        path = PurePosixPath(name)
        if path.parent.name == CACHED:
            path = path.parent.parent / f"{path.name.partition('.')[0]}.py"
        if name in commands or (path.is_relative_to(LIBRARY) and str(path.relative_to(LIBRARY)) in files):
            yield name


def _read(source: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    content = source.extractfile(member)
    return content.read() if content else b""


def _parents(names: Mapping[str, bytes]) -> set[str]:
    return {str(folder) for name in names for folder in PurePosixPath(name).parents if folder.name}


def _entry(name: str, content: bytes | None, member: tarfile.TarInfo | None) -> tarfile.TarInfo:
    """A file, or a folder when there is no content; with the mode it has in the layer it comes from."""
    entry = tarfile.TarInfo(name)
    entry.type = tarfile.DIRTYPE if content is None else tarfile.REGTYPE
    entry.size = len(content or b"")
    entry.mtime = EPOCH_SECONDS
    entry.mode = member.mode if member else 0o755 if content is None else 0o644
    return entry


def _metadata(service: Service, started: Sequence[tuple[str, str]], contents: Mapping[str, bytes]) -> dict[str, bytes]:
    """The service as a Python distribution: bills of materials and package tools read it."""
    folder = f"{LIBRARY}/{PACKAGE}_{service.name.replace('-', '_')}-{service.version}.dist-info"
    about = f"Metadata-Version: 2.4\nName: {PACKAGE}-{service.name}\nVersion: {service.version}\n"
    scripts = "".join(f"{command} = {start}\n" for command, start in started)
    written = {
        f"{folder}/METADATA": f"{about}Summary: {service.name} of RobotKube\nLicense-Expression: Apache-2.0\n".encode(),
        f"{folder}/entry_points.txt": f"[console_scripts]\n{scripts}".encode(),
    }
    rows = [_row(name, data) for name, data in sorted({**contents, **written}.items())]
    record = "\n".join([*rows, f"{_relative(f'{folder}/RECORD')},,", ""])
    return {**written, f"{folder}/RECORD": record.encode()}


def _row(name: str, data: bytes) -> str:
    digest = urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
    return f"{_relative(name)},sha256={digest},{len(data)}"


def _relative(name: str) -> str:
    """A path of the layer as a distribution records it: from its library's folder, commands too."""
    inside = name.removeprefix(f"{LIBRARY}/")
    return inside if inside != name else f"../../../{name.removeprefix(f'{PREFIX}/')}"
