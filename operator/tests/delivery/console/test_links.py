"""Links out of the metrics of bridges: a rate needs two readings, and what is not known is not told as well."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from robotkube.delivery.console.adapters.cluster_watches import read_shown_pod
from robotkube.delivery.console.core import table as kinds
from robotkube.delivery.console.core.links import (
    LINKS_MAX,
    SENTENCE_CHARACTERS_MAX,
    SENTENCES_MAX,
    LinkRates,
    read_metrics,
)
from robotkube.delivery.console.loops.link_reading import NOT_READY, LinkReader
from robotkube.delivery.console.loops.model import ReadModel
from robotkube.delivery.console.ports import BridgePod
from robotkube.errors import UnavailableError
from robotkube.robots.bridge.loops.metrics import BridgeState, metric_lines
from tests.delivery.console import documents as given

METRICS = "http://10.0.0.8:8081/metrics"
NOT_CARRIED = "http://10.0.0.8:8081/not_carried"
SENTENCE = "topic /x is not carried: there is no type x/msg/X"
POSE = f"{given.BRIDGE}/out/pose"


def page(messages: int, taken: int = 0, refused: int = 0) -> str:
    return f"""robotkube_bridge_messages_total{{direction="out",topic="/pose"}} {messages}
robotkube_bridge_matched_sources{{topic="/pose"}} 1
robotkube_bridge_messages_total{{direction="in",topic="/list"}} {taken}
robotkube_bridge_matched_sinks{{topic="/list"}} 0
robotkube_bridge_latency_seconds{{topic="/list"}} 0.034000
robotkube_bridge_connected{{channel="telemetry"}} 1
robotkube_bridge_topics_refused {refused}
"""


class Bridges:
    """A bridge in memory, read by a console every five seconds."""

    def __init__(self) -> None:
        self.now_ms = 0
        self.model = ReadModel("e", lambda: self.now_ms)
        self.pages: dict[str, Any] = {METRICS: page(0), NOT_CARRIED: [SENTENCE]}
        self.there = [BridgePod("vehicle-00/mqtt-bridge-0", given.BRIDGE, "10.0.0.8")]
        self.reader = LinkReader(self.model, self, lambda: self.there)

    def text(self, url: str) -> str:
        if url not in self.pages:
            raise UnavailableError(f"{url}: nobody answers")
        return str(self.pages[url])

    def sentences(self, url: str) -> Sequence[str]:
        sentences: Sequence[str] = self.pages[url]
        return sentences

    def get(self, url: str) -> Mapping[str, Any]:
        raise NotImplementedError

    def read(self, text: str | None = None) -> Mapping[str, Mapping[str, Any]]:
        """The links, five seconds later."""
        self.now_ms += 5000
        if text is not None:
            self.pages[METRICS] = text
        self.reader.step()
        return self.model.documents(kinds.LINKS)


def test_a_rate_needs_two_readings_and_steady_links_have_steady_documents() -> None:
    bridges = Bridges()
    first = bridges.read(page(1000))
    assert (first[POSE]["rate_hz"], first[POSE]["matched"], first[POSE]["silent_since_ms"]) == (None, 1, None)
    assert bridges.read(page(1500))[POSE]["rate_hz"] == 100
    version = bridges.model.version
    assert bridges.read(page(2001))[POSE] == {
        "release": given.BRIDGE, "agent": "vehicle-00", "direction": "out", "topic": "/pose", "rate_hz": 100,
        "over_seconds": 5, "silent_since_ms": None, "latency_ms": None, "matched": 1, "problem": "",
    }  # fmt: skip
    assert bridges.model.version == version


def test_a_silent_link_says_since_when_it_is() -> None:
    bridges = Bridges()
    bridges.read(page(10))
    bridges.read(page(20))
    for _ in range(3):
        link = bridges.read(page(20))[POSE]
        assert (link["rate_hz"], link["silent_since_ms"]) == (0, 10_000)
    assert bridges.read(page(25))[POSE]["silent_since_ms"] is None


def test_what_comes_in_has_its_latency_and_who_receives_it() -> None:
    link = Bridges().read()[f"{given.BRIDGE}/in/list"]
    assert (link["direction"], link["latency_ms"], link["matched"]) == ("in", 34, 0)


def test_a_bridge_that_began_anew_or_is_away_has_no_rates() -> None:
    bridges = Bridges()
    bridges.read(page(1000))
    bridges.read(page(1500))
    assert bridges.read(page(3))[POSE]["rate_hz"] is None
    del bridges.pages[METRICS]
    link = bridges.read()[POSE]
    assert (link["rate_hz"], link["problem"]) == (None, f"{METRICS}: nobody answers")
    source = bridges.model.documents(kinds.SOURCES)["bridges"]
    assert (source["ok"], source["carries"]) == (False, ["links"])
    bridges.there = [BridgePod("vehicle-00/mqtt-bridge-0", given.BRIDGE, "")]
    assert bridges.read()[POSE]["problem"] == NOT_READY
    assert bridges.model.documents(kinds.SOURCES)["bridges"]["ok"] is True, "a pod that is not ready is no lost source"
    bridges.there = []
    assert bridges.read() == {}


def test_what_is_not_carried_is_said() -> None:
    bridges = Bridges()
    refused = bridges.read(page(0, refused=1))[f"{given.BRIDGE}/refused/0"]
    assert (refused["topic"], refused["problem"]) == ("", SENTENCE)
    assert f"{given.BRIDGE}/refused/0" not in bridges.read(page(0))


def test_a_page_of_something_else_is_a_problem() -> None:
    with pytest.raises(ValueError, match="no metrics of a bridge"):
        read_metrics("robotkube_detector_ready 1\n", 0)
    bridges = Bridges()
    bridges.read("<html>")
    assert "no metrics of a bridge" in bridges.model.documents(kinds.SOURCES)["bridges"]["problem"]


def test_a_bridge_that_tells_without_end_or_of_no_numbers_keeps_nobody_from_reading() -> None:
    bridges = Bridges()
    many = (f'robotkube_bridge_messages_total{{direction="in",topic="/{n}"}} 1\n' for n in range(2000))
    links = bridges.read(page(0) + "".join(many))
    assert len(links) == LINKS_MAX
    bridges.pages[NOT_CARRIED] = ["x" * 5000] * 500
    troubled = [link for link in bridges.read(page(0, refused=1)).values() if link["problem"]]
    assert (len(troubled), len(troubled[0]["problem"])) == (SENTENCES_MAX, SENTENCE_CHARACTERS_MAX)
    bridges.read(page(0).replace("topics_refused 0", "topics_refused 1e999"))
    assert "infinity" in bridges.model.documents(kinds.SOURCES)["bridges"]["problem"]


def test_what_a_bridge_writes_is_what_is_read() -> None:
    """The names of metrics are those of the bridge's own code."""
    lines = "".join(f"robotkube_bridge_{line}\n" for line in metric_lines(BridgeState([], [], [])))
    reading = read_metrics(f"{lines}robotkube_bridge_topics_refused 2\n", 7)
    assert (reading.refused, LinkRates().documents("a/b", reading)) == (2, {})


def test_a_pod_of_a_bridge_is_asked_while_it_is_ready() -> None:
    pod = given.pod()
    pod["metadata"]["labels"]["app.kubernetes.io/name"] = "mqtt-bridge"
    assert read_shown_pod(pod)["bridge"] == BridgePod("cloud-0/recorder-0", given.RECORDER, "10.0.0.7")
    assert read_shown_pod(given.pod())["bridge"] is None
