"""The files of the page, read once at the start and kept as they are and compressed, each with a tag of its content."""

from __future__ import annotations

import gzip
import hashlib
import logging
import mimetypes
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response

from robotkube.errors import InputError

INDEX = "index.html"
HASHED = "/assets/"  # whose names change with their content
COMPRESSED = ("text/", "application/javascript", "application/json", "application/manifest", "image/svg")
FILES_BYTES_MAX = 20 * 1024 * 1024

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PageFile:
    """A file: its type, content and tag; `compressed` is empty where that is of no use."""

    kind: str
    content: bytes
    compressed: bytes
    tag: str


def read_files(folder: Path | None) -> dict[str, PageFile]:
    """The files below a folder, by path; none when there is no folder, InputError when there is no page in it."""
    if folder is None or not folder.is_dir():
        log.warning("the page is not there: what it would show is answered without one folder=%s", folder)
        return {}
    files = dict(_files(folder))
    if f"/{INDEX}" not in files:
        raise InputError(f"page: {folder} has no {INDEX}; build the page, or take the key page out of the settings")
    return {**files, "/": files[f"/{INDEX}"]}


def _files(folder: Path) -> Iterator[tuple[str, PageFile]]:
    size = 0
    for path in sorted(folder.rglob("*")):
        if not path.is_file():
            continue
        content = path.read_bytes()
        size += len(content)
        if size > FILES_BYTES_MAX:
            raise InputError(f"page: {folder} has more than {FILES_BYTES_MAX} bytes; is it the page's own folder?")
        kind = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
        kind = "text/javascript" if path.suffix in (".js", ".mjs") else kind
        compressed = gzip.compress(content, 9, mtime=0) if kind.startswith(COMPRESSED) else b""
        compressed = compressed if len(compressed) < len(content) else b""
        tag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
        yield f"/{path.relative_to(folder).as_posix()}", PageFile(_with_charset(kind), content, compressed, tag)


def _with_charset(kind: str) -> str:
    return f"{kind}; charset=utf-8" if kind.startswith("text/") else kind


def file_response(file: PageFile, path: str, request: Request) -> Response:
    """The answer with a file, or that the browser has it already."""
    forever = path.startswith(HASHED)
    headers = {
        "ETag": file.tag,
        "Cache-Control": "public, max-age=31536000, immutable" if forever else "no-cache",
        "Vary": "Accept-Encoding",
        "Content-Type": file.kind,
    }
    if file.tag in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers)
    if file.compressed and "gzip" in request.headers.get("accept-encoding", ""):
        return Response(file.compressed, headers={**headers, "Content-Encoding": "gzip"})
    return Response(file.content, headers=headers)
