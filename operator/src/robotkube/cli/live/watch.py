"""The command `robotkube watch`: what the platform does, as it does it, in lines; on a terminal above a view of the
fleet."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from typing import TYPE_CHECKING, TextIO

from robotkube.cli.live.feed import Feed
from robotkube.cli.live.moments import Moment
from robotkube.cli.platform import Platform
from robotkube.cli.terminal import screen
from robotkube.errors import InputError
from robotkube.foundation.documents.core.times import time_text
from robotkube.foundation.documents.core.yaml_codec import write_mapping

if TYPE_CHECKING:
    from rich.console import RenderableType

WATCH_SECONDS_MAX = 86_400.0
STEP_SECONDS = 0.5


def watching(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("--lines", action="store_true", help="lines alone, also on a terminal")
    parser.add_argument(
        "--seconds", type=float, default=3600.0, help=f"how long, at most {WATCH_SECONDS_MAX:.0f} (default: 3600)"
    )


def watch_platform(options: argparse.Namespace) -> None:
    """Write what stands, and every moment of tasks, plans and pods, until the time is over. UnavailableError: the API
    server does not answer at the beginning."""
    if not 0 < options.seconds <= WATCH_SECONDS_MAX:
        raise InputError(f"--seconds {options.seconds:g}: give seconds above 0, at most {WATCH_SECONDS_MAX:.0f}")
    shown = None if options.lines or options.output != "table" else screen.screen()

    def report(moment: Moment) -> None:
        write_moment(moment, options.output, sys.stdout)

    feed = Feed(Platform(options), report, time.time_ns, with_rates=shown is not None)
    feed.start()
    end = time.monotonic() + options.seconds
    try:
        feed.step(0.0)
        with screen.showing(part(feed, shown)) if shown else nullcontext():
            while (left := end - time.monotonic()) > 0:
                feed.step(min(left, STEP_SECONDS))
    finally:
        feed.stop()


def part(feed: Feed, shown: screen.Screen) -> Callable[[], RenderableType]:
    """What is drawn of a feed's picture on a screen."""
    from robotkube.cli.live.view import view

    return lambda: view(feed.picture, time.time_ns(), shown.console.size.height)


def write_moment(moment: Moment, form: str, stream: TextIO) -> None:
    """Write one moment, at once: a line for people, a JSON document per line, or YAML documents."""
    document = {**moment.document(), "time": time_text(moment.time)}
    if form == "json":
        stream.write(json.dumps(document, sort_keys=True) + "\n")
    elif form == "yaml":
        stream.write(f"---\n{write_mapping(document)}")
    else:
        stream.write(f"{document['time']}  {moment.words}\n")
    stream.flush()
