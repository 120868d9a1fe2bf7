"""The program that writes the file with which the broker's plugin begins; the init container of the broker's pod.

Started by `robotkube-broker-accounts PASSWORDS FILE`. Its settings name the accounts (docs/reference/settings.md). They
and their passwords are made anew, rights that stand in FILE stay; without any an account begins with those that it has
whatever main says, and an agent's is shut until main is seen to let it in. Ends with 0, or 2 when an input is wrong.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from robotkube.delivery.rights.adapters import first_file as adapter
from robotkube.delivery.rights.core.accounts import Accounts, fixed_rights
from robotkube.delivery.rights.core.control import first_file, wanted_roles
from robotkube.delivery.rights.settings import ACCOUNT_KEYS, read_accounts
from robotkube.errors import InputError
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.process import Process, run

GRACE_SECONDS = 5.0


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> Accounts:
    """Read the settings document of the program."""
    return read_accounts(reader, reader.mapping(document, "", ACCOUNT_KEYS))


def write(accounts: Accounts, passwords_file: Path, file: Path) -> int:
    """Write the file; the number of accounts in it."""
    passwords = adapter.read_passwords(passwords_file)
    table = fixed_rights(accounts)
    absent = sorted(set(wanted_roles(table)) - set(passwords))
    if absent:
        raise InputError(f"{passwords_file}: no password for {', '.join(absent)}; add a line for each")
    hashed = {name: adapter.hashed(passwords[name]) for name in wanted_roles(table)}
    agents = [agent.name for agent in accounts.agents]
    adapter.write_file(file, first_file(table, hashed, adapter.read_before(file), agents))
    return len(hashed)


def body(process: Process, arguments: Sequence[str] = (), environment: Mapping[str, str] = os.environ) -> None:
    """Write the file once."""
    if len(arguments) != 2:
        raise InputError("usage: robotkube-broker-accounts PASSWORDS FILE")
    accounts = files.read_settings(files.settings_path(environment), read_configuration)
    count = write(accounts, Path(arguments[0]), Path(arguments[1]))
    process.log("accounts written", accounts=count, file=arguments[1])


def main() -> None:
    """Write the file; exit codes as in `foundation.runtime.process`."""
    run("broker-accounts", lambda process: body(process, sys.argv[1:]), grace_seconds=GRACE_SECONDS)


if __name__ == "__main__":
    main()
