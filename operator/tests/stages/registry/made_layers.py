"""Layers of container images as builders write them, made in memory."""

from __future__ import annotations

import gzip
import hashlib
import io
import tarfile
from collections.abc import Callable, Mapping

import zstandard

Content = bytes | tuple[str, str] | None
"""Bytes of a file, ("symlink" or "hardlink", target), or None for a folder."""

ELF = b"\x7fELF"
STATUS = """Package: libc6
Status: install ok installed
Priority: optional
Maintainer: Debian <maintainers@example.org>
Architecture: amd64
Source: glibc
Version: 2.36-9+deb12u1
Description: C library

Package: gone
Status: deinstall ok config-files
Architecture: amd64
Version: 1.0
Description: removed
"""
SITE = "opt/app/lib/python3.11/site-packages"
FILES: dict[str, Content] = {
    "var/lib/dpkg/status": STATUS.encode(),
    "var/lib/dpkg/arch-native": b"amd64\n",
    f"{SITE}/PyYAML-6.0.3.dist-info/METADATA": b"Metadata-Version: 2.1\nName: PyYAML\nVersion: 6.0.3\n\nText\n",
    f"{SITE}/PyYAML-6.0.3.dist-info/RECORD": b"yaml/__init__.py,,\n",
    "usr": None,
    "usr/lib/libx.so.1": ELF + b"library",
    "usr/lib/libx.so": ("symlink", "libx.so.1"),
    "usr/bin/tool": ELF + b"program",
    "usr/bin/same-tool": ("hardlink", "usr/bin/tool"),
    "usr/bin/script": b"#!/bin/sh\n",
    "lib": ("symlink", "usr/lib"),
}
SKIPPED_FRAME = b"\x50\x2a\x4d\x18\x02\0\0\0ab"
COMPRESSIONS: dict[str, Callable[[bytes], bytes]] = {
    "none": lambda data: data,
    "gzip": lambda data: gzip.compress(data, mtime=0),
    "gzip members": lambda data: gzip.compress(data[:700], mtime=0) + gzip.compress(data[700:], mtime=0),
    "zstd": zstandard.compress,
    "zstd frames": lambda data: SKIPPED_FRAME + zstandard.compress(data[:9]) + zstandard.compress(data[9:]),
}


def made_layer(files: Mapping[str, Content], prefix: str = "") -> bytes:
    """A layer with these entries, in this order."""
    raw = io.BytesIO()
    with tarfile.open(fileobj=raw, mode="w") as tar:
        for path, content in files.items():
            info = tarfile.TarInfo(prefix + path)
            info.mode = 0o755
            if content is None:
                info.type = tarfile.DIRTYPE
            elif isinstance(content, tuple):
                info.type = tarfile.SYMTYPE if content[0] == "symlink" else tarfile.LNKTYPE
                info.linkname = content[1]
            else:
                info.size = len(content)
            tar.addfile(info, io.BytesIO(content) if isinstance(content, bytes) else None)
    return raw.getvalue()


def digest_of(data: bytes) -> str:
    """As manifests name a blob."""
    return "sha256:" + hashlib.sha256(data).hexdigest()


def hex_of(data: bytes) -> str:
    """SHA-256 as bills have it."""
    return hashlib.sha256(data).hexdigest()
