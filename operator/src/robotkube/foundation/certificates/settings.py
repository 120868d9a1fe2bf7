"""How a server proves who it is, in the settings of a process of the platform (docs/reference/settings.md)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import join
from robotkube.foundation.runtime import settings_file as files


def read_server_verification(reader: Reader, value: Any, path: str, host: str) -> ServerVerification | None:
    """How the server at `host` proves who it is: `value` names the file of those that may have signed for it. None
    without such a key: the connection is in clear text."""
    if value is None:
        return None
    return ServerVerification(Path(reader.word(value, path, files.PATH)), host)


def read_authorities(reader: Reader, values: Mapping[str, Any], path: str) -> Path | None:
    """The file of those that may have signed for a server besides the usual ones: the key `authorities` of `values`,
    which stand at `path`; of the whole document, for the other processes of the platform. None without it."""
    if values.get("authorities") is None:
        return None
    return Path(reader.word(values["authorities"], join(path, "authorities"), files.PATH))
