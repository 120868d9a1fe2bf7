"""What groups of tests stand on."""

from __future__ import annotations

import os

from ci.images.preparation import everything
from ci.machine.preparing import TOOLCHAIN_VARIABLE, for_tests, tool_chain


def prepare(needs: str) -> None:
    """Make what a group of tests `needs`: `nothing`, `tests`, `toolchain` (and tests), `images` (and all the others).

    The folder of the tool chain's programs is in the environment variable ROBOTKUBE_TOOLCHAIN_BIN from then on.
    """
    if needs != "nothing":
        for_tests()
    if needs in ("toolchain", "images"):
        os.environ[TOOLCHAIN_VARIABLE] = str(tool_chain())
    if needs == "images":
        everything()
