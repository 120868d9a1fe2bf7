"""What the machine knows about package registries, lent to a build and left in no image.

pip's configuration (files and PIP_* variables), the certificates it trusts and, on Debian bookworm, APT's sources are
copied into one folder that is mounted over the build's file system. The paths at which something is mounted are the
placeholders that normalising takes out of the layers.
"""

from __future__ import annotations

import configparser
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from robotkube.registry.images.adapters.normalising import MADE_BY_BUILDER

MOUNTED = "/mnt/robotkube-build"
CERTIFICATES = f"{MOUNTED}/certificates.crt"
CERTIFICATE_VARIABLES = ("PIP_CERT", "SSL_CERT_FILE", "REQUESTS_CA_BUNDLE", "CURL_CA_BUNDLE")
HOST_CERTIFICATES = Path("/etc/ssl/certs/ca-certificates.crt")
APT_FILE, PIP_FILE = "etc/apt/apt.conf.d/zz-robotkube-build", "etc/pip.conf"


@dataclass(frozen=True)
class Lent:
    """What a build is lent of this machine: `volumes` as `source:target:ro` for the builder; `placeholders` are the
    targets without a leading slash."""

    volumes: tuple[str, ...]
    placeholders: frozenset[str]


def lend(folder: Path, environment: Mapping[str, str], home: Path, sources: Path | None) -> Lent:
    """Gather the machine's settings in `folder`; `sources` is a file or folder with APT sources, or None to use the
    image's own."""
    folder.mkdir(parents=True, exist_ok=True)
    certificates = _certificates(environment)
    if certificates:
        shutil.copyfile(certificates, folder / "certificates.crt")
    (folder / "pip.conf").write_text(_pip(environment, home, bool(certificates)), encoding="utf-8")
    (folder / "apt.conf").write_text(_apt(folder, sources, bool(certificates)), encoding="utf-8")
    local = _local_folders(environment)
    volumes = [f"{folder}:{MOUNTED}:ro", f"{folder}/pip.conf:/{PIP_FILE}:ro", f"{folder}/apt.conf:/{APT_FILE}:ro"]
    volumes += [f"{path}:{path}:ro" for path in local]
    mounted = {MOUNTED, *(str(path) for path in local)}
    points = {path.strip("/") for path in mounted} | {PIP_FILE, APT_FILE} | MADE_BY_BUILDER
    return Lent(tuple(volumes), frozenset(points))


def _certificates(environment: Mapping[str, str]) -> Path | None:
    named = [Path(environment[name]) for name in CERTIFICATE_VARIABLES if environment.get(name)]
    return next((path for path in [*named, HOST_CERTIFICATES] if path.is_file()), None)


def _pip(environment: Mapping[str, str], home: Path, certificates: bool) -> str:
    """All of pip's settings in one file: system, user, then PIP_* variables, the later the stronger."""
    merged: dict[str, str] = {}
    for path in (
        Path("/etc/pip.conf"),
        home / ".pip/pip.conf",
        home / ".config/pip/pip.conf",
        Path(environment.get("PIP_CONFIG_FILE", "")),
    ):
        parser = configparser.RawConfigParser()
        if path.is_file():
            parser.read(path, encoding="utf-8")
        for section in ("global", "install"):
            merged |= dict(parser[section]) if parser.has_section(section) else {}
    for name, value in environment.items():
        if name.startswith("PIP_") and name not in ("PIP_CONFIG_FILE", "PIP_CERT") and value:
            merged[name.removeprefix("PIP_").lower().replace("_", "-")] = value
    if certificates:
        merged["cert"] = CERTIFICATES
    return "[global]\n" + "".join(f"{key} = {value}\n".replace("\n ", "\n\t") for key, value in sorted(merged.items()))


def _apt(folder: Path, sources: Path | None, certificates: bool) -> str:
    lines = [f'Acquire::https::CaInfo "{CERTIFICATES}";'] if certificates else []
    if sources is None:
        return "\n".join(lines) + "\n"
    parts = folder / "sources.list.d"
    parts.mkdir(exist_ok=True)
    for path in [sources] if sources.is_file() else sorted(sources.iterdir()):
        if path.suffix in (".sources", ".list"):
            shutil.copyfile(path, parts / path.name)
    lines += [
        'Dir::Etc::sourcelist "/dev/null";',
        f'Dir::Etc::sourceparts "{MOUNTED}/sources.list.d";',
        'Acquire::Check-Valid-Until "false";',
    ]
    return "\n".join(lines) + "\n"


def _local_folders(environment: Mapping[str, str]) -> tuple[Path, ...]:
    """Folders of wheels that pip is told to look into."""
    return tuple(
        Path(text)
        for text in environment.get("PIP_FIND_LINKS", "").split()
        if text.startswith("/") and Path(text).is_dir()
    )


def debian_sources(release: Path = Path("/etc/os-release"), apt: Path = Path("/etc/apt")) -> Path | None:
    """The machine's APT sources if it is a Debian bookworm: the file or folder that lists them."""
    text = release.read_text(encoding="utf-8") if release.is_file() else ""
    if "VERSION_CODENAME=bookworm" not in text or "\nID=debian" not in f"\n{text}":
        return None
    lists = apt / "sources.list"
    if lists.is_file() and any(line.startswith("deb ") for line in lists.read_text(encoding="utf-8").splitlines()):
        return lists
    official = apt / "sources.list.d" / "debian.sources"
    return official if official.is_file() else None


def current_environment() -> tuple[Mapping[str, str], Path]:
    return dict(os.environ), Path.home()
