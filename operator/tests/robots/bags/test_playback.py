"""The grid of stamps, the ledger's lines, orders and settings of a player."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.errors import DocumentError, InputError
from robotkube.robots.bags.core import playback
from robotkube.robots.ros.core.common_messages import header_stamp


@given(st.integers(0, 2**31 * 10**9 - 1), st.binary(min_size=8), st.booleans())
def test_a_stamp_is_patched_in_place(stamp: int, rest: bytes, little: bool) -> None:
    data = bytes((0, int(little), 0, 0)) + rest
    patched = playback.restamped(data, stamp)
    assert header_stamp(patched) == stamp
    assert (patched[:4], patched[12:], len(patched)) == (data[:4], data[12:], len(data))


def test_a_message_without_header_is_refused() -> None:
    with pytest.raises(InputError, match="does not begin with std_msgs/Header"):
        playback.restamped(b"\0\1\0\0short", 1)


def test_ledger_lines_are_json_as_the_contract_says() -> None:
    line = playback.ledger_line(3, 17, "ab" * 32)
    assert json.loads(line) == {"sequence": 3, "stamp": 17, "sha256": "ab" * 32}
    assert json.loads(playback.ledger_end(4)) == {"end": True, "count": 4}
    assert playback.ledger_name("/vehicles/vehicle_00/pose") == "__vehicles__vehicle_00__pose.jsonl"


@given(st.integers(0, 5), st.booleans(), st.integers(0, 120))
def test_a_ledger_is_read_up_to_its_last_whole_line(count: int, ended: bool, cut: int) -> None:
    text = "".join(playback.ledger_line(k, k, "0" * 64) for k in range(count)) + (
        playback.ledger_end(count) if ended else ""
    )
    data = text.encode()[: max(0, len(text) - cut)]
    state = playback.read_ledger(data)
    whole = data[: data.rfind(b"\n") + 1]
    assert state.whole_bytes == len(whole)
    assert state.messages == state.next_sequence == whole.count(b'"sequence"')
    assert state.ended == (ended and cut == 0)


def test_a_ledger_with_a_gap_goes_on_after_its_last_number() -> None:
    data = (playback.ledger_line(0, 0, "0" * 64) + playback.ledger_line(5, 5, "0" * 64)).encode()
    state = playback.read_ledger(data)
    assert (state.messages, state.next_sequence) == (2, 6)


def test_orders() -> None:
    assert playback.read_run(None, "ConfigMap a/simulation") is None
    assert playback.read_run({}, "ConfigMap a/simulation") is None
    assert playback.read_run({"run": "r1", "start": "12"}, "ConfigMap a/simulation") == playback.PlaybackRun("r1", 12)
    driven = {"run": "r1", "start": "12", "laps": "20", "lap": "95000000000"}
    assert playback.read_run(driven, "ConfigMap a/simulation") == playback.PlaybackRun("r1", 12, 20, 95_000_000_000)
    with pytest.raises(DocumentError, match="start: 'soon' must be a time in ns"):
        playback.read_run({"run": "r1", "start": "soon"}, "ConfigMap a/simulation")
    with pytest.raises(DocumentError, match=r"ConfigMap a/simulation: run: '../x'"):
        playback.read_run({"run": "../x", "start": "1"}, "ConfigMap a/simulation")
    with pytest.raises(DocumentError, match=r"laps: '0' must be how often"):
        playback.read_run({"run": "r1", "start": "1", "laps": "0"}, "ConfigMap a/simulation")
    with pytest.raises(DocumentError, match=r"lap: '5' must be at least 1000000000 ns"):
        playback.read_run({"run": "r1", "start": "1", "laps": "2", "lap": "5"}, "ConfigMap a/simulation")


def test_settings_name_every_problem() -> None:
    good = {"agent": "vehicle-00", "bag": "/bags/vehicle-00", "ledger": "/bags/ledger"}
    assert playback.read_player_settings(good, "f").bag == "/bags/vehicle-00"
    with pytest.raises(DocumentError) as caught:
        playback.read_player_settings({"agent": "Vehicle", "bag": "/b", "speed": 2}, "f")
    assert len(caught.value.problems) == 3


def test_the_grid_has_no_drift() -> None:
    stamp = 1_795_250_000_000_000_000 + 59_999 * 10_000_000
    assert header_stamp(playback.restamped(b"\0\1\0\0" + bytes(20), stamp)) == stamp


def test_stamps_beyond_a_header_are_refused() -> None:
    with pytest.raises(InputError, match="times of a bag that is played count from the start of the run"):
        playback.restamped(b"\0\1\0\0" + bytes(20), 2 * 1_795_250_000_000_000_000)
