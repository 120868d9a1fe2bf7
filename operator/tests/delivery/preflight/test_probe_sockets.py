"""What a pod of the probe does, on this machine: the time that it serves, and what it finds of a neighbour."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from robotkube.delivery.preflight import probe
from robotkube.delivery.preflight.adapters.probe_sockets import answer, serve
from robotkube.delivery.preflight.core.probing.answers import VARIABLE, ProbeQuestions, read_questions
from robotkube.delivery.preflight.core.probing.clocks import ClockExchange, ahead, behind_the_middle

HERE = "127.0.0.1"


def free_ports() -> tuple[int, int]:
    with contextlib.ExitStack() as stack:
        numbers = [stack.enter_context(socket.create_server((HERE, 0))).getsockname()[1] for _ in range(2)]
    return numbers[0], numbers[1]


@pytest.fixture
def served() -> Iterator[tuple[int, int]]:
    """The two ports of a pod that serves."""
    ports = free_ports()
    stopping = threading.Event()
    thread = threading.Thread(target=serve, args=(stopping, ports))
    thread.start()
    while any(answering(port) is False for port in ports):
        time.sleep(0.01)
    yield ports
    stopping.set()
    thread.join()


def answering(port: int) -> bool:
    try:
        socket.create_connection((HERE, port), 1).close()
    except OSError:
        return False
    return True


def no_sleep(seconds: float) -> None:
    """Retries follow at once."""


def test_a_pod_finds_out_everything(served: tuple[int, int], tmp_path: Path) -> None:
    questions = ProbeQuestions(HERE, HERE, ("localhost",), HERE, served[0])
    answers = answer(questions, served, no_sleep, {"pods": str(tmp_path)})
    assert (answers.names, answers.clock_words, answers.open_words, answers.broker_words) == (
        {"localhost": ""},
        "",
        "",
        "",
    )
    assert abs(answers.clock_ahead) <= answers.clock_within + 0.001 < 1
    assert answers.closed, "nobody enforces a policy between processes of one machine"
    assert 0 < answers.disks["pods"].free <= answers.disks["pods"].total


def test_a_pod_says_what_it_does_not_reach(tmp_path: Path) -> None:
    ports = free_ports()
    questions = ProbeQuestions(HERE, HERE, ("nowhere.invalid",), HERE, ports[0])
    answers = answer(questions, ports, no_sleep, {"pods": str(tmp_path)})
    assert "Connection refused" in answers.clock_words
    assert "Connection refused" in answers.open_words
    assert "Connection refused" in answers.broker_words
    assert not answers.closed
    assert answers.names["nowhere.invalid"]


def test_the_program_writes_its_answer_as_the_last_words_of_its_container(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    questions = ProbeQuestions("a", "b", ("c",), "d", 1)
    asked = []
    monkeypatch.setattr(probe, "answer", lambda one: asked.append(one) or one)
    assert probe.run(["ask"], {VARIABLE: questions.text}, tmp_path / "words") == 0
    assert asked == [ProbeQuestions("a", "b", ["c"], "d", 1)]
    assert json.loads((tmp_path / "words").read_text())["clock"] == "a"


@pytest.mark.parametrize(("arguments", "text"), [([], ""), (["ask"], ""), (["ask"], "{}"), (["run"], "{}")])
def test_the_program_refuses_what_nobody_asked(
    arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert probe.run(arguments, {VARIABLE: text}) == 2
    assert "it is for pods of `robotkube preflight --probe`" in capsys.readouterr().err


def test_the_quickest_exchange_says_most() -> None:
    slow, quick = ClockExchange(10.0, 15.4, 11.0), ClockExchange(20.0, 25.005, 20.01)
    assert ahead([slow, quick]) == (pytest.approx(5.0), pytest.approx(0.005))


def test_the_middle_of_clocks() -> None:
    assert behind_the_middle({"a": 0.0, "b": 0.1, "c": 7.0}) == {"a": -0.1, "b": 0.0, "c": 6.9}
    assert behind_the_middle({}) == {}


def test_questions_are_read_as_they_were_written() -> None:
    questions = ProbeQuestions("10.0.0.1", "10.0.0.2", ["a.example"], "broker", 8883)
    assert read_questions(questions.text) == questions
