"""Bills of materials: what is in the layers is in the bill, once, and the same image gives the same bytes."""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import InputError
from robotkube.registry.images.adapters import bills, normalising
from robotkube.registry.suites.core.image_checks import BILL_TYPE, bill_problems

pytestmark = pytest.mark.processes

STATUS = """Package: base-files
Status: install ok installed
Priority: required
Maintainer: Debian <maintainers@example.org>
Architecture: amd64
Version: 12.4
Depends: libc6 (>= 2.36)
Description: base system

Package: libc6
Status: install ok installed
Priority: optional
Maintainer: Debian <maintainers@example.org>
Architecture: amd64
Source: glibc
Version: 2.36-9
Description: C library
"""
SITE = "opt/robotkube/lib/python3.11/site-packages"
LOWER = {
    "var/lib/dpkg/status": STATUS.encode(),
    "var/lib/dpkg/arch-native": b"amd64\n",
    f"{SITE}/PyYAML-6.0.3.dist-info/METADATA": b"Metadata-Version: 2.1\nName: PyYAML\nVersion: 6.0.3\nLicense: MIT\n",
    f"{SITE}/gone-1.0.dist-info/METADATA": b"Metadata-Version: 2.1\nName: gone\nVersion: 1.0\n",
    f"{SITE}/PyYAML-6.0.3.dist-info/RECORD": b"yaml/__init__.py,,\n",
    "usr/local/bin/script": b"#!/bin/sh\n",
    "usr/bin/of-a-package": b"\x7fELF",
}
UPPER = {f"{SITE}/.wh.gone-1.0.dist-info": b"", "usr/local/bin/tool": b"\x7fELF-nothing-to-read"}


def layer(files: Mapping[str, bytes]) -> bytes:
    raw = io.BytesIO()
    with tarfile.open(fileobj=raw, mode="w") as tar:
        for path, content in files.items():
            info = tarfile.TarInfo(path)
            info.size = len(content)
            info.mode = 0o755 if "bin/" in path else 0o644
            tar.addfile(info, io.BytesIO(content))
    return raw.getvalue()


def archive_of(folder: Path, *layers: bytes) -> tuple[Path, str]:
    """An archive as the image builds write it, and the image's digest."""
    raw = folder / "raw"
    raw.mkdir(parents=True)

    def put(data: bytes) -> dict[str, Any]:
        digest = hashlib.sha256(data).hexdigest()
        (raw / digest).write_bytes(data)
        return {"digest": f"sha256:{digest}", "size": len(data)}

    settings = {"Labels": {bills.VERSION_LABEL: "0.1.0"}}
    config = put(json.dumps({"architecture": "amd64", "os": "linux", "config": settings}).encode())
    (raw / "manifest.json").write_text(json.dumps({"config": config, "layers": [put(one) for one in layers]}))
    image = normalising.normalise_image(raw, folder / "image.tar", "host/name")
    return folder / "image.tar", image.digest


@pytest.fixture
def image(tmp_path: Path) -> tuple[Path, str]:
    return archive_of(tmp_path / "image", layer(LOWER), layer(UPPER))


def components(data: bytes) -> dict[str, dict[str, Any]]:
    return {one.get("purl", one.get("bom-ref", one["name"])): one for one in json.loads(data)["components"]}


def test_packages_of_debian_and_python_and_programs_are_named(image: tuple[Path, str]) -> None:
    named = components(bills.make_bill(image[0], "name", image[1]))
    names = {purl.partition("?")[0] for purl in named}
    assert names == {
        "CDXRef-Debian",
        "pkg:deb/debian/base-files@12.4",
        "pkg:deb/debian/glibc@2.36-9",
        "pkg:deb/debian/libc6@2.36-9",
        "pkg:pypi/pyyaml@6.0.3",
        "program:/usr/local/bin/tool",
        "/usr/local/bin/tool",
        "/usr/bin/of-a-package",
    }
    tool = named["program:/usr/local/bin/tool"]
    assert (tool["name"], tool["version"]) == ("tool", "0.1.0")
    assert tool["hashes"][0]["content"] == hashlib.sha256(UPPER["usr/local/bin/tool"]).hexdigest()


def test_the_bill_describes_the_image_by_its_digest(image: tuple[Path, str]) -> None:
    data = bills.make_bill(image[0], "name", image[1])
    assert list(bill_problems(data, image[1])) == []
    assert list(bill_problems(data, "sha256:" + "0" * 64)) != []
    subject = json.loads(data)["metadata"]["component"]
    assert (subject["type"], subject["name"], subject["version"]) == ("container", "name", "0.1.0")


def test_the_same_image_gives_the_same_bytes_in_any_process(image: tuple[Path, str]) -> None:
    code = "import sys, pathlib; from robotkube.registry.images.adapters.bills import make_bill; "
    code += "sys.stdout.buffer.write(make_bill(pathlib.Path(sys.argv[1]), 'name', sys.argv[2]))"
    made = []
    for seed, zone in (("1", "UTC"), ("2", "Asia/Tokyo")):
        environment = {**os.environ, "PYTHONHASHSEED": seed, "TZ": zone, "LC_ALL": "C.UTF-8"}
        command = [sys.executable, "-c", code, str(image[0]), image[1]]
        made.append(subprocess.run(command, capture_output=True, check=True, timeout=120, env=environment).stdout)
    assert made[0] == made[1]
    assert b"timestamp" not in made[0]


def test_a_bill_is_made_once(image: tuple[Path, str]) -> None:
    path = bills.ensure_bill(image[0], "name", image[1])
    assert path.parent == image[0].parent
    path.write_bytes(b"kept")
    assert bills.ensure_bill(image[0], "name", image[1]).read_bytes() == b"kept"


class Recorder:
    """A registry that remembers what was attached."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, str, str, bytes]] = []

    def attach(
        self, repository: str, subject: str, artifact_type: str, data: bytes, annotations: Mapping[str, str]
    ) -> str:
        self.calls.append((repository, subject, artifact_type, data))
        assert set(annotations) == {"org.opencontainers.image.title"}
        return "sha256:attached"


def test_the_bill_beside_the_archive_is_attached_to_the_digest(image: tuple[Path, str], tmp_path: Path) -> None:
    registry = Recorder()
    data = bills.ensure_bill(image[0], "name", image[1]).read_bytes()
    assert bills.attach_bill(registry, "robotkube/name", image[1], image[0]) == "sha256:attached"
    assert registry.calls == [("robotkube/name", image[1], BILL_TYPE, data)]
    shutil.copyfile(image[0], tmp_path / "image.tar")
    with pytest.raises(InputError, match=r"bill-2\.json: missing; build the images again"):
        bills.attach_bill(registry, "robotkube/name", image[1], tmp_path / "image.tar")
