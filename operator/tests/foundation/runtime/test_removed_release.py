"""A process whose release was removed while its node was cut off does nothing more once it hears of it."""

from __future__ import annotations

import faulthandler
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

from robotkube.foundation.kubernetes.adapters.http_client import ApiServer, ConfigMapWatch
from robotkube.foundation.runtime.config_watch import until_removed
from robotkube.foundation.runtime.loops.fencing import Fencing
from robotkube.foundation.runtime.process import Process
from robotkube.testing.api_server import ApiServerInMemory
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

SCRIPT = """
from robotkube.foundation.runtime.config_watch import until_removed
from robotkube.foundation.runtime.process import run
from robotkube.foundation.runtime.loops.fencing import Fencing

def body(process):
    changed = until_removed(process, Fencing(), lambda data: print("settings", data, flush=True))
    changed({"a": "1"})
    changed(None)
    assert process.stopping.wait(10)
    print("returned", flush=True)

run("worker", body, grace_seconds=30.0)
"""


@pytest.fixture(autouse=True)
def nobody_is_ended_after_the_grace_time() -> Iterator[None]:
    yield
    faulthandler.cancel_dump_traceback_later()


def test_settings_that_were_there_and_are_gone_end_the_process_after_the_node_is_back() -> None:
    process = Process("worker", 60.0)
    applied = list[object]()
    with ApiServerInMemory() as before:
        port = int(before.url.rpartition(":")[2])
        before.put_config_map("edge-0", "recorder", {"config.yaml": "a: 1"})
        watch = ConfigMapWatch(
            ApiServer(before.url), "edge-0", "recorder", until_removed(process, Fencing(), applied.append)
        )
        watch.start()
        until(lambda: applied)
    until(lambda: watch.complaint is not None)  # cut off
    assert not process.stopping.is_set()
    with ApiServerInMemory(port=port) as after:
        after.put_config_map("edge-0", "another", {})
        until(process.stopping.is_set)
        watch.stop()
    assert process.removed.is_set()
    assert applied == [{"config.yaml": "a: 1"}]


def test_settings_that_were_never_there_end_nothing() -> None:
    process = Process("worker", 60.0)
    until_removed(process, Fencing(), lambda data: None)(None)
    assert not process.stopping.is_set()


def test_it_stays_idle_until_it_is_told_to_end() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", SCRIPT], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert [process.stdout.readline() for _ in range(2)] == ["settings {'a': '1'}\n", "returned\n"]
        assert '"event": "removed"' in process.stderr.readline()
        assert '"event": "ended"' in process.stderr.readline()
        assert process.poll() is None  # else the kubelet would start it again
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
