"""Settings of a bridge that change: it is not ready until the newest are at work."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from robotkube.foundation.runtime.loops.fencing import Fencing
from robotkube.foundation.runtime.process import Process
from robotkube.robots.bridge.__main__ import SettingsWatch
from robotkube.testing.api_server import ApiServerInMemory
from tests.stages.bridge.in_memory import CLOUD, POSE, BridgeStage
from tests.stages.waiting import until


@pytest.fixture
def api(monkeypatch: pytest.MonkeyPatch) -> Iterator[ApiServerInMemory]:
    with ApiServerInMemory() as server:
        monkeypatch.setenv("ROBOTKUBE_API_SERVER", server.url)
        yield server


def text(*out: object) -> str:
    return json.dumps({"agent": "vehicle-00", "out": list(out), "in": []})


def test_a_bridge_is_not_ready_while_it_refuses_its_newest_settings(api: ApiServerInMemory) -> None:
    stage = BridgeStage()
    settings = SettingsWatch(stage.bridge, Process("mqtt-bridge", 1.0), Fencing())
    settings.begin(text(POSE), "config.yaml")
    stage.connect()
    assert settings.complaint is None

    def change(to: str) -> None:
        api.put_config_map("a", "bridge", {"config.yaml": to})

    change(text(POSE))
    watch = settings.watch("a/bridge")
    change(text({"name": "no topic"}))
    until(lambda: settings.complaint == "changed settings are not at work yet")
    settings.apply_changes()
    complaint = str(settings.complaint)
    assert complaint.startswith("the newest settings are refused, the ones before are at work: ConfigMap a/bridge, key")
    assert "robotkube_settings_refused 1\n" in settings.metrics()
    assert [end.topic for end in stage.network.made if not end.closed] == [POSE["name"]]

    change(text(POSE))
    until(lambda: settings.complaint is None)
    change(text(CLOUD))
    until(lambda: settings.complaint is not None)
    settings.apply_changes()
    stage.connect()
    assert settings.complaint is None
    assert [end.topic for end in stage.network.made if not end.closed] == [CLOUD["name"]]
    watch.stop()
