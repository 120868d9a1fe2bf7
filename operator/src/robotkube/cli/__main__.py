"""`python -m robotkube.cli` is the command `robotkube`."""

from __future__ import annotations

import sys

from robotkube.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
