"""The settings of a service that somebody else wrote: its file at the start, then every change of its ConfigMap."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer, ConfigMapData, ConfigMapWatch, split_name
from robotkube.foundation.runtime.loops.settings_report import SettingsReport
from robotkube.foundation.runtime.process import PodSettings, read_text, write_line

KEY = "config.yaml"

Apply = Callable[[Mapping[str, Any]], object]


class WatchedSettings:
    """The settings of one service. `apply` gets them as a mapping: the first at once, an exception of which is the
    caller's, and changed ones in `apply_changes`, on the caller's thread. Without ROBOTKUBE_CONFIGMAP nothing changes.

        settings = WatchedSettings(open_topics)
        while running:
            settings.apply_changes()
            ...

    A service whose entry says `settings: watched` is ready while `complaint` is None, and not otherwise.
    """

    def __init__(self, apply: Apply, environment: Mapping[str, str] = os.environ) -> None:
        pod = PodSettings.from_environment(environment)
        self._apply = apply
        self._report = SettingsReport()
        self._changes: deque[str] = deque(maxlen=1)
        text = read_text(pod.config_file, "the settings")
        self._report.given(text)
        apply(read_mapping(text, str(pod.config_file)))
        self._report.taken(text)
        self._watch: ConfigMapWatch | None = None
        if pod.config_map is not None:
            place = split_name(pod.config_map)
            self._watch = ConfigMapWatch(ApiServer.from_environment(environment), *place, self._note, _interrupted)
            self._watch.start()

    @property
    def complaint(self) -> str | None:
        """The reason why the newest settings are not at work, or None."""
        return self._report.complaint

    def apply_changes(self) -> None:
        """Apply the newest settings when they changed; refused ones leave what was there, and are a complaint."""
        while self._changes:
            text = self._changes.popleft()
            if text == self._report.at_work:
                continue
            try:
                self._apply(read_mapping(text, KEY))
            except Exception as error:  # of a program that is not ours: whatever it is, these are not at work
                why = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
                self._report.refused(text, why)
                write_line({"event": "settings refused", "error": why})
            else:
                self._report.taken(text)

    def close(self) -> None:
        """End the watch; returns at once."""
        if self._watch is not None:
            self._watch.stop()

    def _note(self, data: ConfigMapData | None) -> None:
        if data is not None and KEY in data:
            self._report.given(data[KEY])
            self._changes.append(data[KEY])


def _interrupted(sentence: str) -> None:
    write_line({"event": "watch interrupted", "error": sentence})
