"""Records of a start: they survive a kill, and only one process at a time starts or stops clusters."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from ci.cluster.embedded.host import records
from ci.cluster.embedded.host.processes import Process, start_ticks
from ci.cluster.embedded.host.records import ClusterFolders, Record, one_at_a_time
from ci.errors import InputError, SetUpError
from ci.folders import PROJECT
from ci.images import image_lock

HOLD = """from ci.cluster.embedded.host.records import one_at_a_time
with one_at_a_time(): print('held', flush=True); input()
"""


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def test_a_record_is_read_back_and_half_a_one_is_none() -> None:
    path = ClusterFolders("test").record
    Record("specification", sysctls={"a.b": "1"}).write(path)
    assert Record.read(path).sysctls == {"a.b": "1"}
    path.write_text('{"specif', encoding="utf-8")
    assert Record.read(path) == Record()


def test_a_process_with_the_same_pid_but_another_start_is_not_the_recorded_one() -> None:
    ticks = start_ticks(os.getpid())
    assert ticks is not None
    assert Process("own", os.getpid(), ticks, (), "").alive()
    assert not Process("own", os.getpid(), ticks - 1, (), "").alive()


def test_one_process_at_a_time_and_a_killed_one_frees_the_lock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(records, "LOCK_TIMEOUT_SECONDS", 0.3)
    with subprocess.Popen(
        [sys.executable, "-c", HOLD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=PROJECT
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(SetUpError, match="starting or stopping a cluster"), one_at_a_time():
            pass
        other.kill()
        other.wait(30)
    with one_at_a_time():
        pass


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        ("{}", "pause: is missing"),
        ('{"pause": {"reference": "a/b"}}', "pause: must have reference and archive"),
        ('{"pause": {"reference": "a/b:1", "archive": "x"}}', "pause.reference: 'a/b:1' must be"),
        ('{"pause": {"reference": "a/b@sha256:1", "archive": "x"}}', "pause.archive: "),
    ],
)
def test_a_wrong_lock_file_is_refused_with_file_and_key(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "images.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        image_lock.read_lock(path)
    assert str(refused.value).startswith(f"{path}: {message}")


def test_an_image_that_was_cut_from_another_names_that_archive(tmp_path: Path) -> None:
    pause = {"reference": "a/pause@sha256:1", "archive": "own.tar", "ground": "below.tar"}
    (tmp_path / "images.json").write_text(json.dumps({"pause": pause}), encoding="utf-8")
    (tmp_path / "own.tar").write_bytes(b"")
    with pytest.raises(InputError, match=r"pause.ground: .*below.tar does not exist; build the images again"):
        image_lock.read_lock(tmp_path / "images.json")
    (tmp_path / "below.tar").write_bytes(b"")
    [image] = image_lock.read_lock(tmp_path / "images.json")
    assert (image.archive, image.ground) == (tmp_path / "own.tar", tmp_path / "below.tar")
