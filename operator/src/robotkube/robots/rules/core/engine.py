"""The rules of a detector at work: messages, time and answers in, edges out. No clock, no thread and no library.

The time of the rules is the messages' own stamp, per topic. Which stamps are believed, and when a topic's time has
jumped, its clock says (`ros.core.source_clocks`), and `message_order` has put in order what comes here. What is older
than the topic's last message is overlooked: it is a sign of life and no more. This machine's clock says only when to
stop waiting for a message.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from robotkube.robots.rules.core.combination_feed import NEVER as NEVER_DUE
from robotkube.robots.rules.core.combination_feed import CombinationFeed, part_names
from robotkube.robots.rules.core.conditions.external import AnsweredQuestion, AskRule, RuleQuestion
from robotkube.robots.rules.core.conditions.levels import earliest
from robotkube.robots.rules.core.conditions.pairs import ApartPairs
from robotkube.robots.rules.core.evaluators import Evaluator
from robotkube.robots.rules.core.events import STOP, Edge
from robotkube.robots.rules.core.messages import NEVER, Message, MessageValues, NoNumberError
from robotkube.robots.rules.core.specification.specifications import Combination, Rule, paths
from robotkube.robots.rules.core.unseen import DISORDERED, NO_NUMBER, UNREADABLE, UnseenMessages

if TYPE_CHECKING:
    from robotkube.robots.ros.core.cdr_readers.readers import FieldReader, Layouts

TOPICS_MAX = 20_000
PROBLEMS_MAX = 1000

SelectValues = Callable[[tuple[Any, ...]], tuple[Any, ...]]

_new = tuple.__new__


@dataclass(slots=True)
class _Route:
    """The evaluators of a topic's messages; without `agent` no rule knows the topic, without evaluators none reads
    it."""

    agent: str
    type: str
    reader: FieldReader | None
    evaluators: list[tuple[Evaluator, SelectValues | None]]
    stamp: int = NEVER


@dataclass
class EngineCounts:
    """Counts of messages that were not evaluated: those not readable as their type by topic, and all by the reason."""

    malformed: dict[str, int] = field(default_factory=dict)
    unseen: UnseenMessages = field(default_factory=UnseenMessages)


def _refuse(question: RuleQuestion) -> None:
    raise ValueError(f"rule {question.rule}: nobody evaluates rules of kinds cel and python here")


class RuleEngine:
    """Evaluates `rules` for the detector of agent `own_agent`, who stands for topics that name no agent.

    `ask` gets the questions of rules that are evaluated elsewhere; it must not block. Their answers go to `answer`.
    `unseen` counts the messages that no rule saw.
    """

    def __init__(
        self,
        rules: Sequence[Rule],
        layouts: Layouts,
        own_agent: str,
        ask: AskRule = _refuse,
        unseen: UnseenMessages | None = None,
    ) -> None:
        self._layouts = layouts
        self._agent = own_agent
        self._ask = ask
        self._evaluators: dict[str, Evaluator] = {}
        self._feed = CombinationFeed()
        self._routes: dict[str, _Route] = {}
        self._unpropagated: list[tuple[Evaluator, Edge]] = []
        self._beginning = True
        self.counts = EngineCounts(unseen=unseen or UnseenMessages())
        self.problems: dict[tuple[str, str], str] = {}
        self._build(rules)

    @property
    def rules(self) -> tuple[Rule, ...]:
        """The rules at work."""
        return tuple(evaluator.rule for evaluator in list(self._evaluators.values()))

    @property
    def active(self) -> tuple[Edge, ...]:
        """The start edges of the events that last, without those of silent rules; any thread may read it."""
        return tuple(
            edge
            for evaluator in list(self._evaluators.values())
            if not evaluator.rule.silent
            for edge in evaluator.events.active
        )

    @property
    def topics_read(self) -> Mapping[str, tuple[str, ...]]:
        """Topic pattern -> the fields that rules read there; none where only the messages' coming counts."""
        fields_by_topic: dict[str, dict[str, None]] = {}
        for rule in self.rules:
            for topic in rule.topics:
                fields_by_topic.setdefault(topic.text, {}).update(dict.fromkeys(paths(rule)))
        return {topic: tuple(fields) for topic, fields in fields_by_topic.items()}

    @property
    def apart(self) -> Mapping[str, ApartPairs]:
        """Rule -> the pairs that it did not compare, since their stamps were too far apart; any thread may read it."""
        pairs = {name: evaluator.condition.apart for name, evaluator in self._evaluators.copy().items()}
        return {name: apart for name, apart in pairs.items() if apart is not None}

    @property
    def ignored(self) -> Mapping[str, int]:
        """Rule -> messages of agents beyond the most that a rule looks at; any thread may read it."""
        return {name: evaluator.ignored for name, evaluator in self._evaluators.copy().items()}

    def observe(self, message: Message) -> list[Edge]:
        """The edges that a message causes. A message that cannot be read is counted and changes nothing."""
        topic, type_name, stamp, received, _ = message
        route = self._routes.get(topic)
        if route is None or route.type != type_name:
            route = self._route(message)
        begun = self._begin(stamp, received) if self._beginning and route.agent else []
        if self._feed.due <= received:
            begun += self.tick(received)
        if not route.evaluators:
            return begun
        if stamp < route.stamp:
            self.counts.unseen.count(topic, DISORDERED)
            self._overlook(route, received, stamp)
            return begun
        route.stamp = stamp
        edges = self._evaluated(route, message)
        return begun + self._propagated(edges, received) if edges or self._feed.due < NEVER_DUE else begun

    def overlook(self, topic: str, received: int) -> None:
        """Note that a message of a topic has come whose stamp is not to be believed: a sign of life."""
        route = self._routes.get(topic)
        if route is not None:
            self._overlook(route, received, None)

    def restart(self, topic: str, stamp: int) -> None:
        """Begin the time of a topic, and of its agent, anew at `stamp`."""
        route = self._routes.get(topic)
        if route is None:
            return
        route.stamp = NEVER
        for evaluator, _ in route.evaluators:
            evaluator.restart(route.agent, stamp)

    def answer(self, answered: AnsweredQuestion) -> list[Edge]:
        """The edges that answers from elsewhere cause; those of rules that are gone cause none."""
        evaluator = self._evaluators.get(answered.question.rule)
        if evaluator is None:
            return []
        return self._propagated(evaluator.answer(answered), answered.question.received)

    def tick(self, now: int) -> list[Edge]:
        """The edges that the time alone causes, up to `now` on this machine's clock (ns since 1970)."""
        edges = self._begin(now, now) if self._beginning else []
        combinations = self._feed.combinations
        elapsed = [edge for e in self._evaluators.values() if e not in combinations for edge in _elapsed(e, now)]
        edges += self._propagated(elapsed, now)
        for evaluator in combinations:
            if not self._feed.waits(evaluator) and (elapsed := _elapsed(evaluator, now)):
                edges += self._propagated(elapsed, now)
        return edges

    def settle(self) -> list[Edge]:
        """The edges of combinations that wait for what their parts may still tell, when nothing comes any more."""
        return self._audible(self._feed.release())

    def due(self) -> int | None:
        """The next moment at which `tick` may give edges; None without one."""
        if self._beginning:
            return 0
        moments = [evaluator.due() for evaluator in self._evaluators.values()]
        return earliest([*moments, self._feed.due if self._feed.due < NEVER_DUE else None])

    def adopt(self, edge: Edge) -> bool:
        """Take over an event that began earlier; False when no rule can have it, or has it already."""
        evaluator = self._evaluators.get(edge.rule)
        if evaluator is None or not evaluator.adopt(edge):
            return False
        self._queue_active_events(evaluator, self._feed.combinations)
        return True

    def replace(self, rules: Sequence[Rule], now: int) -> tuple[list[Edge], list[Edge]]:
        """Replace the rules; returns the start edges of the events that go on, and the stop edges of those that end at
        `now`. Unchanged rules keep their state, and a changed one takes over the events that it can have."""
        before = {name: evaluator.events.active for name, evaluator in self._evaluators.items()}
        silent = {rule.name for rule in self.rules if rule.silent}
        self._build(rules)
        kept = set()
        for name, edges in before.items():
            evaluator = self._evaluators.get(name)
            for edge in edges:
                if evaluator is not None and (edge in evaluator.events.active or self.adopt(edge)):
                    kept.add(edge.id)
        known = [edge for name in before if name not in silent for edge in before[name]]
        gone = [edge for edge in known if edge.id not in kept]
        ended = [replace(edge, edge=STOP, time=now, stamp=now, distance_m=None) for edge in gone]
        return [edge for edge in known if edge.id in kept], ended

    # building --------------------------------------------------------------------------------------------------------

    def _build(self, rules: Sequence[Rule]) -> None:
        by_name = {rule.name: rule for rule in rules}
        before = self._evaluators
        self._evaluators = {}
        for rule in _parts_first(rules, by_name):
            known = before.get(rule.name)
            if known is not None and known.rule == rule and self._same_parts(rule, before):
                self._evaluators[rule.name] = known
            else:
                self._evaluators[rule.name] = Evaluator(rule, by_name, self._agent, self._ask)
        new = [evaluator for name, evaluator in self._evaluators.items() if before.get(name) is not evaluator]
        self._feed.bind(self._evaluators)
        self._unpropagated = []
        for evaluator in self._evaluators.values():
            self._queue_active_events(evaluator, [other for other in new if other in self._feed.combinations])
        self._routes.clear()
        self.problems.clear()
        self._beginning = True

    def _same_parts(self, rule: Rule, before: Mapping[str, Evaluator]) -> bool:
        parts = rule.condition.parts if isinstance(rule.condition, Combination) else ()
        return all(self._evaluators.get(part.rule) is before.get(part.rule) for part in parts)

    def _queue_active_events(self, evaluator: Evaluator, combinations: Iterable[Evaluator]) -> None:
        """Queue the events that last already for combinations that follow them, until all of them are known."""
        for other in combinations:
            if evaluator.rule.name in part_names(other):
                self._unpropagated += [(other, edge) for edge in evaluator.events.active]
        self._beginning = True

    def _begin(self, stamp: int, received: int) -> list[Edge]:
        """The edges of what holds from the first moment on; a combination knows by then what its parts say."""
        self._beginning = False
        unpropagated = self._unpropagated
        self._unpropagated = []
        edges: list[Edge] = []
        for evaluator in self._evaluators.values():  # parts first
            names = part_names(evaluator)
            known = [edge for other, edge in unpropagated if other is evaluator]
            known += [edge for edge in edges if edge.rule in names]
            edges += evaluator.begin(stamp, received, known)
        return self._audible(edges)

    # messages --------------------------------------------------------------------------------------------------------

    def _route(self, message: Message) -> _Route:
        """The route of a topic's messages: the rules that evaluate them, and the fields that are read for these."""
        if len(self._routes) >= TOPICS_MAX:
            self._routes.clear()
        agent = ""
        interested = []
        for evaluator in self._evaluators.values():
            agents = [pattern.agent(message.topic) for pattern in evaluator.rule.topics]
            fits = next((named for named in agents if named is not None), None)
            if fits is None:
                continue
            agent = fits or self._agent
            wanted = not evaluator.rule.agents or agent in evaluator.rule.agents
            if wanted and self._readable(evaluator.rule, message):
                interested.append(evaluator)
        together = tuple(dict.fromkeys(path for evaluator in interested for path in paths(evaluator.rule)))
        reader = self._layouts.reader(message.type, together) if together else None
        evaluators = [(evaluator, _selection(together, paths(evaluator.rule))) for evaluator in interested]
        route = self._routes[message.topic] = _Route(agent, message.type, reader, evaluators)
        return route

    def _readable(self, rule: Rule, message: Message) -> bool:
        if not paths(rule):
            return True
        try:
            self._layouts.reader(message.type, paths(rule))
        except ValueError as error:
            if len(self.problems) < PROBLEMS_MAX:
                self.problems[rule.name, message.topic] = str(error)
            return False
        return True

    @staticmethod
    def _overlook(route: _Route, received: int, stamp: int | None) -> None:
        for evaluator, _ in route.evaluators:
            evaluator.overlook(route.agent, received, stamp)

    def _evaluated(self, route: _Route, message: Message) -> list[Edge]:
        topic, type_name, stamp, received, data = message
        values: tuple[Any, ...] | None = ()
        readable = number = True
        if route.reader is not None:
            try:
                values = route.reader(data)
            except ValueError:
                values = None
                readable = False
        edges: list[Edge] = []
        for evaluator, select in route.evaluators:
            if select is not None and values is None:
                continue
            selected = () if select is None or values is None else select(values)
            # a named tuple without its own constructor, which is a Python function and takes three times as long
            reading = _new(MessageValues, (topic, route.agent, stamp, received, selected, type_name, data))
            try:
                evaluator.observe(reading, edges)
            except NoNumberError:
                number = False
            except ValueError as error:
                readable = False
                if len(self.problems) < PROBLEMS_MAX:
                    self.problems[evaluator.rule.name, topic] = str(error)
        if not readable:
            self.counts.malformed[topic] = self.counts.malformed.get(topic, 0) + 1
            self.counts.unseen.count(topic, UNREADABLE)
        elif not number:
            self.counts.unseen.count(topic, NO_NUMBER)
        return edges

    def _propagated(self, edges: list[Edge], now: int) -> list[Edge]:
        """The edges with those of the combinations that follow them, without those of silent rules."""
        return self._audible(self._feed.pass_on(edges, now)) if edges or self._feed.due < NEVER_DUE else edges

    def _audible(self, edges: Iterable[Edge]) -> list[Edge]:
        return [edge for edge in edges if not self._evaluators[edge.rule].rule.silent]


def _elapsed(evaluator: Evaluator, now: int) -> list[Edge]:
    due = evaluator.due()
    return evaluator.elapse(now) if due is not None and due <= now else []


def _selection(together: Sequence[str], wanted: Sequence[str]) -> SelectValues | None:
    if not wanted:
        return None
    if tuple(wanted) == tuple(together):
        return tuple
    if len(wanted) == 1:
        index = together.index(wanted[0])
        return lambda values: (values[index],)
    return itemgetter(*(together.index(path) for path in wanted))


def _parts_first(rules: Sequence[Rule], by_name: Mapping[str, Rule]) -> list[Rule]:
    """The rules in an order in which a combination comes after its parts; `rules` are free of circles."""
    ordered: dict[str, Rule] = {}

    def add(rule: Rule) -> None:
        if rule.name in ordered:
            return  # parts that are shared are gone through once, or twenty layers of them would take for ever
        for part in rule.condition.parts if isinstance(rule.condition, Combination) else ():
            add(by_name[part.rule])
        ordered[rule.name] = rule

    for rule in rules:
        add(rule)
    return list(ordered.values())
