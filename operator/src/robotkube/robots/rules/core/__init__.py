"""Rules: what is an event, when it begins and when it ends.

specification   documents -> rules, every problem at once, and the same as JSON Schema
conditions      for whom a rule holds, kind by kind
engine          messages, time, answers -> edges
evaluators      one rule at work: its condition and its events
event_tracking  changes -> events (sustained, interval, cooldown)
events          an event's two edges, and event_documents their JSON
windows, plugin_api   the interface of rules of installed packages
"""

from robotkube.robots.rules.core.conditions.external import AnsweredQuestion, RuleAnswer, RuleQuestion
from robotkube.robots.rules.core.engine import RuleEngine
from robotkube.robots.rules.core.events import START, STOP, Cause, Edge, event_identity, task_name
from robotkube.robots.rules.core.messages import FALL, KEEP, RISE, Message
from robotkube.robots.rules.core.specification.descriptions import reason
from robotkube.robots.rules.core.specification.reading import RULES_MAX, read_rules
from robotkube.robots.rules.core.specification.specifications import Always, Cel, Proximity, Python, Rule

__all__ = [
    "FALL",
    "KEEP",
    "RISE",
    "RULES_MAX",
    "START",
    "STOP",
    "Always",
    "AnsweredQuestion",
    "Cause",
    "Cel",
    "Edge",
    "Message",
    "Proximity",
    "Python",
    "Rule",
    "RuleAnswer",
    "RuleEngine",
    "RuleQuestion",
    "event_identity",
    "read_rules",
    "reason",
    "task_name",
]  # fmt: skip
