"""What `robotkube status` says of the Inspections: strangers that run, and places that could not be looked at."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.cli.output import Table
from robotkube.delivery.inspection.core.statuses import CLEAN, SEEN
from robotkube.foundation.documents.core.times import time_ns

STALE_SECONDS = 45  # a look every 10 s, written every 20 s, and the time that kubelets take which do not answer
NAMED_MAX = 5
INSPECTOR = "inspector"
STRANGER_COLUMNS = ("kind", "namespace", "name", "container", "reason", "since")
UNSEEN_COLUMNS = ("place", "problem")
STEP = "kubectl describe inspections in the platform's namespace says what to do"
NOBODY_LOOKS = "nobody compares what runs with what may run (charts/robotkube, inspection.enabled)"

Object = Mapping[str, Any]


@dataclass(frozen=True)
class Seen:
    """Rows for programs and people: `strangers` that run, `unseen` places with why. `looked`: how many places were
    looked at; `more`: strangers beyond those that their Inspections list."""

    strangers: tuple[Object, ...] = ()
    unseen: tuple[Object, ...] = ()
    looked: int = 0
    more: int = 0

    @property
    def tables(self) -> tuple[Table, ...]:
        """Both as tables."""
        return (
            Table("strangers", STRANGER_COLUMNS, self.strangers),
            Table("unseen", UNSEEN_COLUMNS, self.unseen),
        )

    @property
    def problem(self) -> str:
        """What is strange, in a sentence; empty when nothing is."""
        if not self.strangers:
            return ""
        first = ", ".join(_words(stranger) for stranger in self.strangers[:NAMED_MAX])
        rest = len(self.strangers) + self.more - min(len(self.strangers), NAMED_MAX)
        count = len(self.strangers) + self.more
        what = "1 stranger runs" if count == 1 else f"{count} strangers run"
        return f"{what}: {first}{f' and {rest} more' if rest else ''} ({STEP})"

    @property
    def blind(self) -> str:
        """What could not be looked at, in a sentence; empty when everything was."""
        if not self.unseen and not self.looked:
            return NOBODY_LOOKS
        if not self.unseen:
            return ""
        first = ", ".join(f"{one['place']} ({one['problem']})" for one in self.unseen[:NAMED_MAX])
        rest = len(self.unseen) - NAMED_MAX
        return f"not looked at: {first}{f' and {rest} more' if rest > 0 else ''}"

    @property
    def text(self) -> str:
        """Lines for people when nothing is strange."""
        lines = [f"no strangers in {self.looked} places that were looked at\n"] if self.looked else []
        return "".join([*lines, *([f"{self.blind}\n"] if self.blind else [])])


def seen(inspections: Sequence[Object], now_ns: int, inspector: Object | None = None) -> Seen:
    """What these Inspections say at a time. `inspector` is the Deployment of who writes them, empty when there is none,
    None when that is not known."""
    strangers: list[Object] = []
    unseen: list[Object] = [*_away(inspector)] if inspections and inspector is not None else []
    looked = more = 0
    for item in sorted(inspections, key=lambda one: str(one["metadata"]["name"])):
        name = str(item["metadata"]["name"])
        status = item.get("status") or {}
        listed = status.get("strangers") or ()
        strangers += [{"place": name, **one} for one in listed]
        more += int(status.get("strangersTotal") or 0) - len(listed)
        problem = _problem(status, now_ns)
        if problem:
            unseen.append({"place": name, "problem": problem})
        else:
            looked += 1
    return Seen(tuple(strangers), tuple(unseen), looked, more)


def _problem(status: Object, now_ns: int) -> str:
    """Why an Inspection says nothing of now; empty when it does."""
    conditions = {entry["type"]: entry for entry in status.get("conditions") or ()}
    if SEEN not in conditions or CLEAN not in conditions:
        return "nothing looked there yet"
    if conditions[SEEN]["status"] != "True":
        return str(conditions[SEEN]["message"])
    age = (now_ns - time_ns(status["observedTime"])) // 10**9 if "observedTime" in status else STALE_SECONDS + 1
    return f"the last look was {age} s ago: is what looks running?" if age > STALE_SECONDS else ""


def _away(inspector: Object) -> Iterator[Object]:
    """A sentence that who looks is not there, or not ready, so that what the Inspections say may be old, or somebody
    else's."""
    if not inspector:
        yield {"place": INSPECTOR, "problem": "there is no such Deployment: who writes the Inspections?"}
    elif not int((inspector.get("status") or {}).get("availableReplicas") or 0):
        problem = "it is not ready: what the Inspections say may be old, or not what it saw; its log says why"
        yield {"place": INSPECTOR, "problem": problem}


def _words(one: Object) -> str:
    place = "/".join(str(one[key]) for key in ("namespace", "name", "container") if one.get(key))
    return f"{one['kind']} {place} ({one['reason']})"
