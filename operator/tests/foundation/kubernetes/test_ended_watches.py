"""A watch that nobody needs any more says nothing of what its server does afterwards."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from robotkube.foundation.kubernetes.adapters.client import ResourceWatch, api_client
from tests.stages.kubernetes.served_objects import FORBIDDEN, serving
from tests.stages.waiting import until

PATH, COMPLAINT = "/api/v1/pods", "watch interrupted"
WAIT_SECONDS_MAX = 30


@pytest.mark.parametrize("ends", [True, False])
def test_a_failure_after_the_end_is_nobodys_business(
    ends: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    asked, goes_on = threading.Event(), threading.Event()

    def answer(path: str, query: Mapping[str, list[str]]) -> Mapping[str, Any]:
        if "watch" not in query:
            return {"metadata": {"resourceVersion": "1"}, "items": []}
        asked.set()
        goes_on.wait(WAIT_SECONDS_MAX)
        return FORBIDDEN

    with serving(answer, tmp_path) as kubeconfig:
        watch = ResourceWatch(api_client(str(kubeconfig)), PATH, "", dict, lambda *change: None)
        before = set(threading.enumerate())
        watch.start()
        (thread,) = (one for one in set(threading.enumerate()) - before if one.name == f"watch {PATH}")
        assert asked.wait(WAIT_SECONDS_MAX)
        if ends:
            watch.stop()
        goes_on.set()
        if not ends:
            until(lambda: COMPLAINT in caplog.text, "it complains")
        watch.stop()
        thread.join(WAIT_SECONDS_MAX)
        assert not thread.is_alive()
    assert (COMPLAINT in caplog.text) is not ends
    assert bool(watch.complaint) is not ends
