"""The journal of merges that have no note yet: one file each, in the gate's own folder."""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from robotkube.delivery.deployment.core.merge_records import MergeRecord
from robotkube.errors import InputError
from robotkube.foundation.documents.core.json_codec import read_json

log = logging.getLogger(__name__)


class FileJournal:
    """The port MergeJournal in `folder`. A file that cannot be read is named in the log and left out."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def keep(self, record: MergeRecord) -> None:
        """Write the record's file, in one piece."""
        path = self._path(record.commit)
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            part = path.with_suffix(".part")
            part.write_text(json.dumps(asdict(record), sort_keys=True), encoding="utf-8")
            part.replace(path)
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}; merges cannot be announced, so nothing is merged") from error

    def forget(self, commit: str) -> None:
        """Remove the record's file."""
        self._path(commit).unlink(missing_ok=True)

    def records(self) -> Sequence[MergeRecord]:
        """The records of all files."""
        return [record for path in sorted(self._folder.glob("*.json")) if (record := _read(path)) is not None]

    def _path(self, commit: str) -> Path:
        return self._folder / f"{commit}.json"


def _read(path: Path) -> MergeRecord | None:
    try:
        document = read_json(path.read_text(encoding="utf-8"))
        return MergeRecord(**{**document, "approvals": tuple(document["approvals"])})
    except (OSError, ValueError, TypeError, KeyError) as error:
        log.error("record unreadable path=%s reason=%s", path, error)
        return None
