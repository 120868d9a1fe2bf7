"""Names of archives of images in a folder from which a runtime imports all that it finds."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable

from robotkube.foundation.documents.core.patterns import BUNDLE_VERSION
from robotkube.registry.bundles.core.contents import BundleContents

MARK_CHARACTERS = 12
_NAME = re.compile(rf"robotkube-{BUNDLE_VERSION.pattern}-[0-9a-f]{{{MARK_CHARACTERS}}}\.tar(?:\.part)?", re.ASCII)


def mark(references: Iterable[str]) -> str:
    """What tells images (by digest) from others, in a few characters."""
    return hashlib.sha256("\n".join(sorted(references)).encode()).hexdigest()[:MARK_CHARACTERS]


def archive_name(contents: BundleContents) -> str:
    """The name of the archive with a bundle's images: another one for other images, also of the same version."""
    return f"robotkube-{contents.version}-{mark(contents.references().values())}.tar"


def is_archive(name: str) -> bool:
    """Return whether a file has the name of such an archive, whole or half written."""
    return _NAME.fullmatch(name) is not None
