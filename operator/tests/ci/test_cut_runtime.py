"""The runtime of the tests' Docker engine: what a container asks for is cut down to what the machine gives."""

from __future__ import annotations

import json
import resource
from pathlib import Path
from typing import Any

from tests.stages.kind.cut_runtime import RAISING, change, held, value

FEW = frozenset({"CAP_CHOWN", "CAP_SYS_ADMIN"})


def process() -> dict[str, Any]:
    files = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    return {
        "args": ["init"],
        "capabilities": {"bounding": ["CAP_CHOWN", RAISING, "CAP_SYS_ADMIN"], "ambient": None},
        "rlimits": [{"type": "RLIMIT_NOFILE", "hard": 2 * files, "soft": 2 * files}],
        "oomScoreAdj": -999,
    }


def test_capabilities_are_read_by_their_numbers() -> None:
    assert held("Name:\tpython\nCapEff:\t0000000000000000\nCapBnd:\t0000000000200001\n") == FEW
    assert RAISING in held("CapBnd:\t000001ffffffffff\n")


def test_what_cannot_be_had_is_cut_from_containers_and_from_processes_in_them(tmp_path: Path) -> None:
    container, other = tmp_path / "config.json", tmp_path / "process"
    container.write_text(json.dumps({"hostname": "node", "process": process()}))
    other.write_text(json.dumps(process()))
    for file in (container, other):
        change(file, FEW, score=0)
    files = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    left = {
        "args": ["init"],
        "capabilities": {"bounding": ["CAP_CHOWN", "CAP_SYS_ADMIN"], "ambient": []},
        "rlimits": [{"type": "RLIMIT_NOFILE", "hard": files, "soft": files}],
    }
    assert json.loads(other.read_text()) == left
    assert json.loads(container.read_text()) == {"hostname": "node", "process": left}


def test_nothing_is_cut_where_all_can_be_had(tmp_path: Path) -> None:
    file = tmp_path / "process"
    file.write_text(json.dumps(process()))
    change(file, FEW | {RAISING}, score=0)
    whole = process()
    whole["capabilities"]["ambient"] = []
    assert json.loads(file.read_text()) == whole


def test_options_are_found_with_and_without_their_sign() -> None:
    arguments = ["--root", "/run", "create", "--bundle", "/one", "--pid-file=/two", "name"]
    assert (value(arguments, "--bundle", "-b"), value(arguments, "--pid-file"), value(arguments, "--process")) == (
        "/one",
        "/two",
        "",
    )
