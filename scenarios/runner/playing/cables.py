"""The cables of agents during a run: conditions are given to them, probed, holes are opened, and all is taken away."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence

from ci.cluster_contract.network_conditions import Measured, NetworkConditions, Traffic
from ci.cluster_contract.provider import NetworkEmulator
from ci.errors import SetUpError
from scenarios.definition import Scenario
from scenarios.generator.coverage import CoverageHole, coverage_holes
from scenarios.runner.inputs import NANOSECONDS, HoleDone, NetworkOfRun


class UntouchedCables:
    """What there is in place of an emulator where machines and cables are others': a scenario that asks for nothing of
    them runs."""

    def check(self, wanted: Mapping[str, NetworkConditions]) -> None:
        """See NetworkEmulator.check."""
        if wanted:
            raise SetUpError(f"the cables of {', '.join(wanted)} are not this cluster's: they keep their conditions")

    def apply(self, wanted: Mapping[str, NetworkConditions]) -> Mapping[str, tuple[str, ...]]:
        """See NetworkEmulator.apply."""
        self.check(wanted)
        return {}

    def probe(self) -> Mapping[str, Measured]:
        """See NetworkEmulator.probe."""
        return {}

    def cut(self, agent: str, seconds: float) -> None:
        """See NetworkEmulator.cut."""
        raise SetUpError(f"the cable of {agent} is not this cluster's")

    def traffic(self, agent: str) -> Mapping[str, Traffic]:
        """See NetworkEmulator.traffic."""
        return {}

    def relay_dropped(self) -> int:
        """See NetworkEmulator.relay_dropped."""
        return 0

    def clear(self) -> None:
        """See NetworkEmulator.clear."""


class Cables:
    """The cables of one run. `warnings` say what went wrong with holes."""

    def __init__(self, scenario: Scenario, emulator: NetworkEmulator, progress: Callable[[str], None]) -> None:
        self.warnings: list[str] = []
        self._wanted = scenario.network
        self._conditions = {agent: cable.conditions for agent, cable in self._wanted.items()}
        self._holes = coverage_holes(scenario)
        self._emulator = emulator
        self._progress = progress
        self._acts: Mapping[str, Sequence[str]] = {}
        self._measured: Mapping[str, Measured] = {}
        self._opened: dict[CoverageHole, int] = {}
        self._end = threading.Event()
        self._thread: threading.Thread | None = None

    def check(self) -> None:
        """SetUpError when the cluster cannot do what the scenario asks of its cables."""
        self._emulator.check(self._conditions)

    def reset(self) -> None:
        """Take all conditions away, also those of a run that was killed."""
        self._emulator.clear()

    def begin(self) -> None:
        """Give the cables their conditions, and measure what came of it."""
        if not self._wanted:
            return
        self._acts = self._emulator.apply(self._conditions)
        self._progress(f"network: the cables of {', '.join(self._wanted)} have their conditions; they are measured")
        self._measured = self._emulator.probe()
        for line in lines(self._of_run({})):
            self._progress(line)

    def play(self, started: int) -> None:
        """Open the holes, each so long after `started` (ns since 1970) as it says."""
        if self._holes:
            self._thread = threading.Thread(target=self._open, args=(started,), name="holes in coverage", daemon=True)
            self._thread.start()

    def finish(self) -> tuple[NetworkOfRun, ...]:
        """Take the conditions away; what the cables were like and what they carried."""
        self._end.set()
        if self._thread is not None:
            self._thread.join()
        try:
            return self._of_run({agent: self._emulator.traffic(agent) for agent in self._wanted})
        finally:
            self._emulator.clear()

    def _open(self, started: int) -> None:
        for hole in self._holes:
            due = started / NANOSECONDS + hole.at_seconds
            if self._end.wait(max(0.0, due - time.time())):
                return
            try:
                self._emulator.cut(hole.agent, hole.seconds)
            except Exception as error:  # of any kind: the run goes on, and its expectations say what is missing
                self.warnings.append(f"the hole of {hole.agent} at {hole.at_seconds:g} s was not opened: {error}")
                continue
            self._opened[hole] = time.time_ns() - started
            self._progress(f"network: {hole.agent} is in a hole of coverage for {hole.seconds:g} s")

    def _of_run(self, traffic: Mapping[str, Mapping[str, Traffic]]) -> tuple[NetworkOfRun, ...]:
        dropped = self._emulator.relay_dropped() if traffic else 0
        return tuple(
            NetworkOfRun(
                agent=agent,
                asked=cable.asked,
                acts=tuple(self._acts[agent]),
                measured=self._measured.get(agent),
                traffic=traffic.get(agent, {}),
                holes=tuple(self._hole(hole) for hole in self._holes if hole.agent == agent),
                relay_dropped=dropped,
            )
            for agent, cable in self._wanted.items()
        )

    def _hole(self, hole: CoverageHole) -> HoleDone:
        opened = self._opened.get(hole)
        return HoleDone(hole.at_seconds, hole.seconds, None if opened is None else opened / NANOSECONDS)


def lines(cables: Sequence[NetworkOfRun]) -> list[str]:
    """Each cable in a sentence for the terminal: what was asked for, what was measured, where it acts."""
    return [line for cable in cables for line in _lines(cable)]


def _lines(cable: NetworkOfRun) -> list[str]:
    asked = ", ".join(f"{key} {value:g}" for key, value in cable.asked.items()) or "holes alone"
    summary = f"network of {cable.agent}: asked {asked}; measured {measured_words(cable.measured)}"
    carried = [
        f"  {direction}: {one.packets} packets, {one.lost} lost, {one.in_holes} in holes, queue full for "
        f"{one.queue_full}"
        for direction, one in cable.traffic.items()
    ]
    opened = [f"  hole asked at {hole.at_seconds:g} s for {hole.seconds:g} s: {_begun(hole)}" for hole in cable.holes]
    return [summary, *carried, *(opened if cable.traffic else ()), *(f"  {text}" for text in cable.acts)]


def _begun(hole: HoleDone) -> str:
    return "not opened" if hole.began_seconds is None else f"began at {hole.began_seconds:.3f} s"


def measured_words(measured: Measured | None) -> str:
    """What a probe measured, in words."""
    if measured is None:
        return "nothing"
    trip = measured.round_trip_ms
    words = [f"round trip {trip[1]:.1f} ms ({trip[0]:.1f} to {trip[2]:.1f})" if trip else "no round trip"]
    rates = (("up", measured.up_mbit), ("down", measured.down_mbit))
    words += [f"{rate:.1f} Mbit/s {direction}" for direction, rate in rates if rate is not None]
    return ", ".join([*words, f"{measured.lost} of {measured.sent} packets lost"])
