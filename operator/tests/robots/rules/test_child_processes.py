"""Rules in processes of their own: the real ones, and who is suspended for what by the policy."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from robotkube.robots.detector.adapters.expression_checks import CachedExpressionCheck
from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from robotkube.robots.rules.adapters.child_processes import ChildProcess
from robotkube.robots.rules.core import RISE, START, STOP, Edge, Rule, RuleAnswer, RuleQuestion
from robotkube.robots.rules.core.plugin_api import BUFFERS_MAX, Arrival, Holding, PluginHost
from robotkube.robots.rules.core.windows import Window
from robotkube.robots.rules.host import check_expressions, start_rule
from robotkube.robots.rules.loops import workers
from robotkube.robots.rules.loops.workers import QUESTIONS_MAX, RuleWorkers
from robotkube.robots.rules.ports import Reply
from tests.stages.detector.in_memory import DetectorStage, MemoryTasks
from tests.stages.detector.rules import (
    DEFINITIONS,
    NOW,
    NUMBER,
    NUMBERS,
    POSES,
    SECOND,
    TOPICS,
    RuleStage,
    read,
    seconds,
)
from tests.stages.paths import DOCS
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

EXAMPLE = DOCS / "examples" / "closing-speed"
FORMULA = {
    "name": "fast", "kind": "cel", "topic": NUMBERS, "fields": {"v": "data"}, "expression": "v > 2.0 && agent != 'x'",
    "until": "v < 1.0",
}  # fmt: skip
WRONG_RULES = '''
"""Rules that do what no rule should."""
import time

class Wrong:
    def __init__(self, settings):
        self.kind = settings["kind"]
        if self.kind == "refuses":
            raise ValueError("settings.kind is not to my taste")

    def evaluate(self, arrival, window):
        print("what a rule prints is no reply")
        if self.kind == "loops":
            while True:
                pass
        if self.kind == "sleeps":
            time.sleep(3600)
        if self.kind == "raises":
            raise RuntimeError("no")
        if self.kind == "ends":
            import os
            os._exit(7)
        if self.kind == "eats":
            list(range(10**9))
        if self.kind == "lies":
            return ["nonsense"]
        if self.kind == "mumbles":
            from robotkube.robots.rules.core.events import Cause
            from robotkube.robots.rules.core.plugin_api import Holding
            return [Holding((arrival.agent,), True, {}, (Cause("/t", 1, {"x": b"no JSON"}),))]
        if self.kind == "nests":
            from robotkube.robots.rules.core.events import Cause
            from robotkube.robots.rules.core.plugin_api import Holding
            deep = []
            for _ in range(900):
                deep = [deep]
            return [Holding((arrival.agent,), True, {}, (Cause("/t", 1, {"x": deep}),))]
        return []
'''


class Stage(RuleStage):
    """An engine with its workers; a replay, so that nothing is dropped."""

    def __init__(self, *documents: dict[str, Any]) -> None:
        self.workers = RuleWorkers(self.start, time.monotonic, lossless=True)
        super().__init__(*documents, ask=self.workers.ask)
        self.workers.apply(self.engine.rules)

    @staticmethod
    def start(rule: Rule) -> ChildProcess:
        return start_rule(rule, TOPICS, DEFINITIONS.__getitem__)

    def settled(self) -> list[Edge]:
        return [edge for verdict in self.workers.settle() for edge in self.engine.answer(verdict)]


@pytest.fixture
def make_stage() -> Iterator[Callable[..., Stage]]:
    stages: list[Stage] = []

    def make(*documents: dict[str, Any]) -> Stage:
        stages.append(Stage(*documents))
        return stages[-1]

    yield make
    for stage in stages:
        stage.workers.stop()


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example and the wrong rules, installed as pip does it."""
    root = tmp_path_factory.mktemp("plugins")
    wrong = root / "wrong"
    (wrong / "src" / "wrong_rules").mkdir(parents=True)
    (wrong / "src" / "wrong_rules" / "__init__.py").write_text(WRONG_RULES)
    text = (EXAMPLE / "pyproject.toml").read_text()
    text = text.replace('name = "closing-speed"', 'name = "wrong-rules"')
    (wrong / "pyproject.toml").write_text(
        text.replace('closing-speed = "closing_speed:make"', 'wrong = "wrong_rules:Wrong"')
    )
    example = root / "example"
    shutil.copytree(EXAMPLE, example)
    target = root / "site"
    options = ["--quiet", "--no-deps", "--no-index", "--no-build-isolation", "--target", str(target)]
    command = [sys.executable, "-m", "pip", "install", *options, str(example), str(wrong)]
    subprocess.run(command, check=True, timeout=120)
    return target


@pytest.fixture
def plugins(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(installed), os.environ["PYTHONPATH"]]))


def test_an_expression_begins_and_ends_events(make_stage: Callable[..., Stage]) -> None:
    stage = make_stage(FORMULA)
    for at, value in enumerate([1.0, 3.0, 1.5, 0.5]):
        stage.send("vehicle-00", value, at)
    edges = stage.settled()
    assert [(edge, at) for edge, _, at in seconds(edges)] == [(START, 1.0), (STOP, 3.0)]
    assert edges[0].causes[0].values == {"v": 3.0, "agent": "vehicle-00"}
    assert edges[0].detail == {"v": 3.0}


def test_an_expression_that_fails_is_suspended_and_the_others_go_on(make_stage: Callable[..., Stage]) -> None:
    stage = make_stage(FORMULA, {**FORMULA, "name": "wrong", "expression": "v.nothing > 1.0"})
    for at in range(5):
        stage.send("vehicle-00", 3.0, at)
    assert [edge.rule for edge in stage.settled()] == ["fast"]
    states = stage.workers.document()
    assert (states["fast"]["state"], states["wrong"]["state"]) == ("running", "suspended")
    assert "v.nothing > 1.0" in states["wrong"]["problem"]


def test_expressions_are_checked_before_they_are_used() -> None:
    good, bad = check_expressions([("a.x > 1.0", ("a.x", "b.x")), ("a >", ("a",))])
    assert good == ""
    assert bad.startswith("cannot be read: ")


NAMES, PAIRS = ("charge", "heat", "agent"), ("a.x", "a.agent", "b.x", "b.agent")


@pytest.mark.parametrize(
    ("expression", "names", "problem"),
    [
        ("charge < 0.3 && heat > 50.0 && agent != 'x'", NAMES, ""),
        ("charge < 0.3 && het > 50.0", NAMES, "het is none of the names in fields (agent, charge, heat)"),
        ("charge < 0.3 || math.abs(heat) > 1.0", NAMES, "math is none of the names"),
        ("charge.exists(i, i > 0.5) && charge.map(j, j * 2.0).all(k, k > 1.0)", NAMES, ""),
        ("charge.exists(i, j > 0.5)", NAMES, "j is none of the names"),
        ("size(charge) > 2 && type(heat) == int", NAMES, ""),
        ("charge.startsWith('a') || heat.matches('b')", NAMES, ""),
        ("abs(charge) > 0.5", NAMES, "cannot be evaluated: RuntimeError: Undefined variable or function: 'abs'"),
        ("charge + 1.0", NAMES, "is float, not true or false; compare it with something"),
        ("agent", NAMES, "is str, not true or false"),
        ("charge", NAMES, ""),
        ("charge + 1 > 2", NAMES, ""),
        ("a.x - b.x < 3.0 && a.agent != b.agent", PAIRS, ""),
        ("a.q - b.x < 3.0", PAIRS, "cannot be evaluated: KeyError: 'q'"),
        ("x < 3.0", PAIRS, "x is none of the names in fields (a.agent, a.x, b.agent, b.x)"),
        ("[1,2,3,4,5,6,7,8,9].all(a, " * 9 + "a > 0" + ")" * 9, NAMES,
         "takes too long to be evaluated; make it simpler"),
    ],
)  # fmt: skip
def test_what_an_expression_cannot_know_is_named(expression: str, names: tuple[str, ...], problem: str) -> None:
    [actual] = check_expressions([(expression, names)])
    assert actual.startswith(problem) if problem else not actual


def test_a_number_that_is_none_leaves_everything_as_it_was(make_stage: Callable[..., Stage]) -> None:
    stage = make_stage(FORMULA)
    for at, value in enumerate([3.0, float("nan"), 1.5, float("nan"), 0.5]):
        stage.send("vehicle-00", value, at)
    assert [(edge, at) for edge, _, at in seconds(stage.settled())] == [(START, 0.0), (STOP, 4.0)]
    assert stage.workers.document()["fast"]["suspensions"] == 0


@pytest.mark.usefixtures("plugins")
def test_the_example_package_finds_vehicles_that_approach_fast(make_stage: Callable[..., Stage]) -> None:
    stage = make_stage({
        "name": "approach", "kind": "python", "plugin": "closing-speed", "topics": [POSES], "scope": "pair",
        "settings": {"topic": POSES, "start_mps": 10, "stop_mps": 5, "span_seconds": 0.4},
    })  # fmt: skip
    places = [100 - 20 * step / 10 if step < 20 else 60.0 for step in range(40)]
    for step, x in enumerate(places):
        stage.send("vehicle-00", (0.0, 0.0, 0.0), step / 10)
        stage.send("vehicle-01", (x, 0.0, 0.0), step / 10)
    start, stop = stage.settled()
    assert (start.edge, stop.edge, start.agents) == (START, STOP, ("vehicle-00", "vehicle-01"))
    assert start.detail["closing_mps"] == pytest.approx(20)
    assert start.stamp - NOW == pytest.approx(0.4 * SECOND, abs=0.11 * SECOND)
    assert start.stamp < stop.stamp <= NOW + 3 * SECOND


@pytest.mark.usefixtures("plugins")
def test_the_example_package_says_which_settings_are_missing(make_stage: Callable[..., Stage]) -> None:
    """As the how-to asks of every package."""
    stage = make_stage({
        "name": "approach", "kind": "python", "plugin": "closing-speed", "topics": [POSES], "scope": "pair",
        "settings": {"stop_mps": 5},
    })  # fmt: skip
    stage.send("vehicle-00", (0.0, 0.0, 0.0), 1)
    assert stage.settled() == []
    assert "ValueError: settings: topic, start_mps missing; give" in stage.workers.document()["approach"]["problem"]


def test_agents_that_come_and_go_do_not_end_a_rule() -> None:
    """A window has so many topics; who has been silent longest makes room."""

    class Counting:
        def evaluate(self, arrival: Arrival, window: Window) -> list[Holding]:
            topics = window.topics(POSES)
            return [Holding((arrival.agent,), True, {"topics": float(len(topics)), "v1": float("v1" in topics)})]

    def ask(number: int, at: int) -> dict[str, float]:
        topic = f"/vehicles/v{number}/pose"
        return dict(host.answer(RuleQuestion("r", (f"v{number}",), topic, at, at, type=TOPICS[POSES]))[0].detail)

    host = PluginHost(Counting(), TOPICS, Layouts(DEFINITIONS.__getitem__), 5)
    assert [ask(number, number) for number in range(BUFFERS_MAX)][-1] == {"topics": BUFFERS_MAX, "v1": 1}
    assert ask(0, BUFFERS_MAX) == {"topics": BUFFERS_MAX, "v1": 1}
    assert ask(BUFFERS_MAX, BUFFERS_MAX + 1) == {"topics": BUFFERS_MAX, "v1": 0}


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize(
    ("kind", "problem"),
    [
        ("refuses", "cannot be loaded: ValueError: settings.kind is not to my taste"),
        ("loops", "took more than its budget of 0.1 s"),
        ("sleeps", "it has not answered for 5 s"),
        ("raises", "RuntimeError: no"),
        ("ends", "exit code 7"),
        ("eats", "MemoryError"),
        ("lies", "AttributeError"),
        ("mumbles", "TypeError: Object of type bytes is not JSON serializable"),
        ("nests", "its process said what is no reply: nested deeper than 100 levels; write it flatter"),
    ],
)
def test_a_rule_that_does_wrong_is_suspended_by_name(
    kind: str, problem: str, make_stage: Callable[..., Stage], monkeypatch: pytest.MonkeyPatch
) -> None:
    if kind != "sleeps":  # nobody else is taken for stuck, however slow the machine
        monkeypatch.setattr(workers, "STUCK_SECONDS_MIN", 600.0)
    budget = 5 if kind == "eats" else 0.1
    document = {
        "name": "wrong", "kind": "python", "plugin": "wrong", "topics": [NUMBERS], "settings": {"kind": kind},
        "budget_seconds": budget,
    }  # fmt: skip
    stage = make_stage(document, {**FORMULA, "budget_seconds": 10})
    for at in range(3):
        stage.send("vehicle-00", 3.0, at)
    edges: list[Edge] = stage.settled()
    until(lambda: edges.extend(stage.settled()) or stage.workers.document()["wrong"]["suspensions"] > 0, seconds=40)
    state = stage.workers.document()["wrong"]
    assert problem in state["problem"]
    assert state["dropped"] == 3
    assert [edge.rule for edge in edges] == ["fast"], "the other rule goes on"


class Pretended:
    """A process that replies when it is told to."""

    def __init__(self) -> None:
        self.ready = True
        self.failure = ""
        self.stopped = False
        self.asked: list[RuleQuestion] = []
        self.waiting: list[Reply] = []

    def ask(self, question: RuleQuestion) -> None:
        self.asked.append(question)

    def replies(self) -> Sequence[Reply]:
        waiting, self.waiting = self.waiting, []
        return waiting

    def wait(self, seconds: float) -> None: ...

    def stop(self) -> None:
        self.stopped = True


class Policy:
    """Workers over pretended processes and a clock that stands still."""

    def __init__(self) -> None:
        self.now = 0.0
        self.processes = list[Pretended]()
        self.workers = RuleWorkers(self._start, lambda: self.now)
        self.workers.apply(read(FORMULA))

    def _start(self, rule: Rule) -> Pretended:
        self.processes.append(Pretended())
        return self.processes[-1]

    def ask(self, count: int = 1, data: bytes = b"") -> None:
        for number in range(count):
            self.workers.ask(RuleQuestion("fast", ("vehicle-00",), "/t", number, number, data=data))

    @property
    def state(self) -> dict[str, Any]:
        document: dict[str, Any] = self.workers.document()["fast"]
        return document


def test_questions_wait_within_bounds_and_what_is_dropped_is_counted() -> None:
    policy = Policy()
    policy.ask(QUESTIONS_MAX + 5)
    assert (policy.state["waiting"], policy.state["dropped"]) == (QUESTIONS_MAX, 5)
    policy.processes[0].waiting = [Reply([RuleAnswer(("vehicle-00",), RISE)])] * 10
    verdicts = policy.workers.collect()
    assert [verdict.question.stamp for verdict in verdicts] == list(range(10))
    assert policy.state["waiting"] == QUESTIONS_MAX - 10
    large = Policy()
    large.ask(5, bytes(10_000_000))
    assert (large.state["waiting"], large.state["dropped"]) == (3, 2)


def test_pauses_double_up_to_a_bound_and_begin_anew_after_a_good_minute() -> None:
    policy = Policy()
    pauses = []
    for _ in range(9):
        policy.processes[-1].failure = "it fell over"
        policy.workers.collect()
        assert policy.processes[-1].stopped
        pauses.append(policy.state["resumes_in_seconds"])
        policy.now += pauses[-1] - 0.01
        policy.workers.collect()
        assert policy.state["state"] == "suspended"
        policy.now += 0.02
        policy.workers.collect()
        assert policy.state["state"] == "running"
    assert pauses == [1, 2, 4, 8, 16, 32, 60, 60, 60]
    policy.now += 61
    policy.workers.collect()
    assert policy.state["problem"] == ""
    policy.processes[-1].failure = "again"
    policy.workers.collect()
    assert policy.state["resumes_in_seconds"] == 1


def test_who_does_not_answer_is_ended_and_what_waited_is_counted() -> None:
    policy = Policy()
    policy.ask(3)
    policy.now = 4.9
    policy.workers.collect()
    assert not policy.processes[0].stopped
    policy.now = 5.1
    policy.workers.collect()
    assert policy.processes[0].stopped
    assert (policy.state["dropped"], policy.state["problem"]) == (3, "it has not answered for 5 s")
    policy.ask(2)
    assert policy.state["dropped"] == 5


def test_what_a_process_said_last_comes_before_its_end() -> None:
    """Also when both come just while it is looked after."""
    policy = Policy()
    policy.ask()
    [process] = policy.processes
    look = process.replies

    def replies() -> Sequence[Reply]:
        seen = look()
        if not process.failure:
            process.waiting = [Reply((), "RuntimeError: no")]
            process.failure = "its process ended with exit code 0"
        return seen

    process.replies = replies  # type: ignore[method-assign]
    policy.workers.collect()
    policy.workers.collect()
    assert (policy.state["problem"], policy.state["dropped"]) == ("RuntimeError: no", 1)


def test_changed_rules_get_new_processes_and_others_keep_theirs() -> None:
    policy = Policy()
    policy.workers.apply(read(FORMULA, {**FORMULA, "name": "second"}))
    assert len(policy.processes) == 2
    policy.workers.apply(read({**FORMULA, "expression": "v > 3.0"}))
    assert [process.stopped for process in policy.processes] == [True, True, False]
    policy.workers.stop()
    assert policy.processes[-1].stopped


def test_expressions_stay_loaded_while_the_detector_rests_and_know_nothing_of_before() -> None:
    stage = DetectorStage(MemoryTasks(), lambda: RuleWorkers(Stage.start, time.monotonic))
    topic = "/vehicles/vehicle_00/value"

    def loaded() -> bool:
        stage.detector.turn()
        return bool(stage.status.document()["rules"]["workers"]["fast"]["state"] == "running")

    def edges() -> list[str]:
        stage.detector.turn()
        return [edge for edge, _ in stage.edges()]

    settings = {
        "name": "cloud-0/d",
        "topics": [{"name": topic, "type": NUMBER}],
        "rules": [{**FORMULA, "topic": topic}],
    }
    stage.apply({**settings, "state": "inactive"})
    for wanted in (["start"], ["start", "stop", "start"]):
        until(loaded)
        stage.detector.change_state("active")
        assert loaded(), "nothing has to be started"
        stage.say(topic, 3.0)
        until(lambda wanted=wanted: edges() == wanted)
        stage.detector.change_state("inactive")
        assert edges() == [*wanted, "stop"]
    stage.detector.stop()


def test_only_expressions_that_are_new_are_checked() -> None:
    asked: list[Sequence[str]] = []

    a, b, c = ("a", ("x",)), ("b!", ("x",)), ("c", ("x",))

    def check(texts: Sequence[tuple[str, tuple[str, ...]]]) -> Sequence[str]:
        asked.append([text for text, _ in texts])
        return [f"{text} is wrong" if "!" in text else "" for text, _ in texts]

    known = CachedExpressionCheck(check)
    assert known([a, b, a]) == ["", "b! is wrong", ""]
    assert known([b, a]) == ["b! is wrong", ""]
    assert known([a, c]) == ["", ""]
    assert known([b]) == ["b! is wrong"]
    assert asked == [["a", "b!"], ["c"], ["b!"]], "what is not used any more is forgotten"
