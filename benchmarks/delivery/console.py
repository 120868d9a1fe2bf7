"""What the console's page costs and gives in a browser (Debian's Chromium): a thousand agents and five thousand
releases, the console over HTTP as its process has it, a synthetic fleet behind.

    python3 -m benchmarks.delivery.console [--seconds 20]

Baselines, in the same run: fifteen agents; and the same page while it polls, as behind a proxy that buffers. Writes
build/bench/console.json: `event_to_pixel_ms` (from an event's beginning until the browser has drawn it), `frames` of
the map a second, `first_paint_ms`, `page_bytes` and `snapshot_bytes` as they come over the wire, `cpu_share` of the
process with one browser, of one core.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

from benchmarks.measuring.comparisons import Comparison, module_environment, quantiles, record
from ci import console, packages
from ci.errors import SetUpError
from ci.folders import PROJECT

RECORD = PROJECT / "build" / "bench" / "console.json"
SECONDS = 20
START_SECONDS_MAX = 30.0
MODULE = "tests.stages.console.console_process"
POLLED = "polled"
FIRST_VIEW_BYTES = 300_000
EVENTS_MIN = 10


@dataclass(frozen=True)
class Size:
    """Of a fleet."""

    agents: int
    releases: int


LARGE, SMALL = Size(1000, 5000), Size(15, 60)


def prepare() -> None:
    """Have the page and a browser; SetUpError when they cannot be had."""
    packages.ensure("browser")
    console.build()


@contextmanager
def serving(size: Size) -> Iterator[tuple[str, dict[str, float]]]:
    """The console's address; after its end what it used."""
    command = [sys.executable, "-m", MODULE, str(console.build())]
    command += ["--agents", str(size.agents), "--releases", str(size.releases)]
    used: dict[str, float] = {}
    with subprocess.Popen(
        command, cwd=PROJECT, env=module_environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            url = process.stdout.readline().strip()
            if not url:
                raise SetUpError(f"{MODULE} ended with {process.wait(START_SECONDS_MAX)} before it served a page")
            yield url, used
            used |= json.loads(process.communicate(timeout=START_SECONDS_MAX)[0])
        finally:
            process.kill()


def measured(size: Size, seconds: int = SECONDS, *way: str) -> dict[str, Any]:
    """What a browser finds on a page that it looks at for so long."""
    with serving(size) as (url, used):
        answers: dict[str, Any] = json.loads(console.browse("figures", url, str(seconds), *way))
    if len(answers["event_ms"]) < min(EVENTS_MIN, seconds // 2):
        raise SetUpError(f"of {seconds} events, one a second, the page showed {len(answers['event_ms'])}")
    return answers | used


def recorded(browsed: dict[str, Any]) -> dict[str, Any]:
    """The measurements as they are recorded."""
    return {
        "event_to_pixel_ms": asdict(quantiles(browsed["event_ms"])),
        "frames": round(browsed["frames"], 1),
        "first_paint_ms": round(browsed["first_paint_ms"]),
        "page_bytes": browsed["page_bytes"],
        "snapshot_bytes": browsed["data_bytes"],
        "cpu_share": browsed["cpu_share"],
    }


def compare(seconds: int = SECONDS) -> list[Comparison]:
    """The ratios; all measurements are recorded."""
    large, small, polled = measured(LARGE, seconds), measured(SMALL, seconds), measured(LARGE, seconds, POLLED)
    record(RECORD, {"large": recorded(large), "small": recorded(small), "polled": recorded(polled)})
    few = f"{SMALL.agents} agents"
    p95, p95_polled = quantiles(large["event_ms"]).p95, quantiles(polled["event_ms"]).p95
    first_view = large["page_bytes"] + large["data_bytes"]
    frame, frame_small = 1000 / large["frames"], 1000 / small["frames"]
    return [
        Comparison("event to pixel, 1,000 agents, p95", "ms", p95, p95_polled, 0.5, "the page polls"),
        # With many agents the page draws every second frame of a screen of 60 Hz at most.
        Comparison("time between frames, 1,000 agents", "ms", frame, frame_small, 2.2, few),
        Comparison("first paint, 1,000 agents", "ms", large["first_paint_ms"], small["first_paint_ms"], 1.5, few),
        Comparison(
            "first view and its data, 1,000 agents", "bytes", first_view, FIRST_VIEW_BYTES, 1.0, "what it may be"
        ),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=SECONDS)
    for one in compare(parser.parse_args().seconds):
        print(one, round(one.ratio, 3))


if __name__ == "__main__":
    main()
