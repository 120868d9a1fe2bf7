"""The program `robotkube-probe` of the preflight's pods: `serve` says the time until it is ended, `ask` answers the
questions in ROBOTKUBE_PROBE as the message with which its container ends.

Exit code 0 when it has answered, 2 when nobody asked.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path

from robotkube.delivery.preflight.adapters.probe_sockets import answer, serve
from robotkube.delivery.preflight.core.probing.answers import VARIABLE, read_questions
from robotkube.delivery.preflight.core.probing.objects import ASK, SERVE

LAST_WORDS = Path("/dev/termination-log")
USAGE = 2


def run(arguments: Sequence[str], environment: Mapping[str, str], last_words: Path = LAST_WORDS) -> int:
    """Do what the arguments say; the exit code."""
    if list(arguments) == [SERVE]:
        stopping = threading.Event()
        for one in (signal.SIGTERM, signal.SIGINT):  # the first process of a container has no default for them
            signal.signal(one, lambda number, frame: stopping.set())
        serve(stopping)
        return 0
    try:
        if list(arguments) != [ASK]:
            raise ValueError(f"give {SERVE} or {ASK}")
        questions = read_questions(environment.get(VARIABLE, ""))
    except ValueError as error:
        print(f"robotkube-probe: {error}; it is for pods of `robotkube preflight --probe`", file=sys.stderr)
        return USAGE
    last_words.write_text(answer(questions).text)
    return 0


def main() -> None:
    """End with the exit code."""
    sys.exit(run(sys.argv[1:], os.environ))


if __name__ == "__main__":
    main()
