"""`python -m robotkube.cli` is the command `robotkube`."""

from __future__ import annotations

import signal
import sys

signal.signal(signal.SIGINT, signal.SIG_DFL)  # an interrupt of the imports below ends it without a traceback

from robotkube.cli.main import main  # noqa: E402 - after the line above

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.exit(main())
