"""Reading what bridges carry into the model, one bridge after the other, so that a thousand of them cost what twenty a
second do."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robotkube.delivery.console.core import table as kinds
from robotkube.delivery.console.core.links import LinkRates, read_metrics, unknown_links
from robotkube.delivery.console.loops.model import ReadModel
from robotkube.delivery.console.ports import BridgePod, Pages
from robotkube.errors import RobotKubeError

ROUND_SECONDS = 5.0  # at least, between two readings of one bridge
REST_SECONDS = 0.05  # between two bridges
SOURCE = "bridges"
ADVICE = "Rates of their links are not known. Look at the pods of the bridges."
NOT_READY = "The bridge's pod is not ready."


class LinkReader:
    """Reads the metrics of bridges. `bridges` are those that are there now."""

    def __init__(self, model: ReadModel, pages: Pages, bridges: Callable[[], Sequence[BridgePod]]) -> None:
        self._model = model
        self._pages = pages
        self._bridges = bridges
        self._rates: dict[str, LinkRates] = {}  # by pod: another one counts anew
        self._shown: dict[str, Mapping[str, Any]] = {}  # documents by release

    def step(self, rest: Callable[[], object] = lambda: None) -> bool:
        """Read all of them, with a rest behind each; False when one did not answer."""
        bridges = self._bridges()
        problems = []
        for bridge in bridges:
            problem = self._read(bridge)
            problems += [f"{bridge.pod}: {problem}"] if problem and bridge.host else []
            rest()
        self._forget(bridges)
        self._model.put_source(SOURCE, "; ".join(problems[:3]), ADVICE, (kinds.LINKS,))
        return not problems

    def _read(self, bridge: BridgePod) -> str:
        """Read one; why that failed, else empty."""
        problem = "" if bridge.host else NOT_READY
        if not problem:
            try:
                documents = self._documents(bridge)
            except (RobotKubeError, ValueError, ArithmeticError) as error:
                problem = str(error)
        if problem:
            documents = unknown_links(self._shown.get(bridge.release, {}), problem)
        self._shown[bridge.release] = documents
        self._model.replace(kinds.LINKS, documents, f"{bridge.release}/")
        return problem

    def _documents(self, bridge: BridgePod) -> dict[str, Any]:
        reading = read_metrics(self._pages.text(f"http://{bridge.host}:8081/metrics"), self._model.now_ms())
        sentences = self._pages.sentences(f"http://{bridge.host}:8081/not_carried") if reading.refused else ()
        return self._rates.setdefault(bridge.pod, LinkRates()).documents(bridge.release, reading, sentences)

    def _forget(self, bridges: Sequence[BridgePod]) -> None:
        for pod in self._rates.keys() - {bridge.pod for bridge in bridges}:
            del self._rates[pod]
        for release in self._shown.keys() - {bridge.release for bridge in bridges}:
            del self._shown[release]
            self._model.replace(kinds.LINKS, {}, f"{release}/")

    def run(self, stopping: threading.Event) -> None:
        """Read until `stopping` is set."""
        while not stopping.wait(ROUND_SECONDS):
            self.step(lambda: stopping.wait(REST_SECONDS))
