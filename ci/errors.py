"""The one error of the set-up: a sentence for people, and what the command's exit code is.

Exit codes of every command below ci/: 0 done, 1 refused (wrong input), 2 usage, 3 the machine or the cluster cannot.
"""

from __future__ import annotations


class SetUpError(Exception):
    """Something outside the program is wrong; the message says what, where, and what to do."""

    exit_code = 3


class InputError(SetUpError):
    """A file or an argument given by a person is wrong; the message names file, key and fix."""

    exit_code = 1
