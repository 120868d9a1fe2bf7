"""Layers of images that were read already, kept on disk by their digests: charts with the same image share the work.

The folder belongs to this process's user alone. A file appears whole, and only after the layer's digest was checked.
"""

from __future__ import annotations

import dataclasses
import os
import stat
import tempfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

from robotkube.foundation.documents.core.digests import canonical_json
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.registry.suites.adapters.image_layers import read_layer
from robotkube.registry.suites.core.image_contents import Entry, LayerContents

FORMAT = "2"  # part of a file's name: raise it when something else is read of a layer
KEPT_MAX = 64
FILE_BYTES_MAX = 8 << 20  # of one layer's contents, compressed: larger ones are read again


class KeptLayers:
    """The port LayerReader. `folder` is made when it is missing; one that others can write is not used."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def contents(self, digest: str, blob: Callable[[], Iterator[bytes]]) -> LayerContents:
        """The contents of the layer `digest`, whose bytes `blob` gives when they are needed."""
        file = self._folder / f"{FORMAT}-{digest.replace(':', '-')}"
        known = self._read(file)
        if known is not None:
            return known
        layer = read_layer(blob())
        self._write(file, layer)
        return layer

    def _read(self, file: Path) -> LayerContents | None:
        try:
            if not self._is_ours():
                return None
            document = read_json(zlib.decompress(file.read_bytes()))
            entries = tuple(Entry(*values) for values in document["entries"])
            return LayerContents(entries, tuple(document["hidden"]), tuple(document["emptied"]))
        except (OSError, ValueError, TypeError, KeyError, zlib.error):
            return None  # not there, or of a run that was killed: it is read again

    def _write(self, file: Path, layer: LayerContents) -> None:
        """Keep it if that goes; the oldest make room."""
        document = {
            "entries": [dataclasses.astuple(entry) for entry in layer.entries],
            "hidden": layer.hidden,
            "emptied": layer.emptied,
        }
        data = zlib.compress(canonical_json(document), 1)
        if len(data) > FILE_BYTES_MAX:
            return
        try:
            self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if self._is_ours():
                with tempfile.NamedTemporaryFile(dir=self._folder, delete=False) as out:
                    out.write(data)
                Path(out.name).replace(file)
                self._forget()
        except OSError:
            return  # a full disk costs time, no result

    def _is_ours(self) -> bool:
        status = self._folder.lstat()
        return stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid() and not status.st_mode & 0o022

    def _forget(self) -> None:
        files = sorted(self._folder.iterdir(), key=lambda file: file.stat().st_mtime, reverse=True)
        for file in files[KEPT_MAX:]:
            file.unlink(missing_ok=True)
