"""Rules: what is an event, when it begins and when it ends.

reading         documents -> specifications, every problem at once     schema      the same as JSON Schema
engine          messages, time, answers -> edges                       evaluating  one rule at work
conditions, proximities, rates, areas, combinations, asking            when something holds, and for whom
occurrences     what holds -> events (sustained, interval, cooldown)   edges       an event's begin and end
plugins         what installed packages may add
"""

from robotkube.domain.rules.asking import Answer, Question, Verdict
from robotkube.domain.rules.edges import START, STOP, Cause, Edge, event_identity, task_name
from robotkube.domain.rules.engine import RuleEngine
from robotkube.domain.rules.messages import FALL, KEEP, RISE, Message
from robotkube.domain.rules.reading import RULES_MAX, read_rules
from robotkube.domain.rules.specifications import Always, Cel, Proximity, Python, Rule
from robotkube.domain.rules.wording import reason

__all__ = [
    "FALL", "KEEP", "RISE", "RULES_MAX", "START", "STOP", "Always", "Answer", "Cause", "Cel", "Edge", "Message",
    "Proximity", "Python", "Question", "Rule", "RuleEngine", "Verdict", "event_identity", "read_rules", "reason",
    "task_name",
]  # fmt: skip
