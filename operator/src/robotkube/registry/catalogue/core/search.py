"""Finding entries of a catalogue: by words, by what they provide, need or guarantee, and by their upgrades."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.errors import InputError, RefusalError, did_you_mean
from robotkube.foundation.documents.core.patterns import NAME
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.catalogue.core.guarantees import BOUNDS, UNITS, Guarantee, GuaranteeRequirement, shortfall
from robotkube.registry.catalogue.core.upgrade_graph import upgrades
from robotkube.registry.catalogue.core.versions import version_key

Entry = Mapping[str, Any]
"""A document of `catalogue_documents`."""

_GUARANTEE = re.compile(
    rf"(?P<name>{NAME.pattern})(?:(?P<bound><=|>=)(?P<number>-?\d{{1,15}}(?:\.\d{{1,15}})?) ?(?P<unit>\S+))?", re.ASCII
)


@dataclass(frozen=True)
class Criteria:
    """Criteria of a search, of which all that are given must hold. `provides` and `needs` also match the first parts of
    a capability (`recording`); `guarantee` is a name, or a name with a bound."""

    text: str = ""
    provides: str = ""
    needs: str = ""
    guarantee: str | GuaranteeRequirement = ""
    channel: str = ""
    state: str = ""


def read_guarantee(text: str) -> str | GuaranteeRequirement:
    """`stop-time`, `stop-time<=3s` or `rate>=10 Hz`; InputError when it is none of these."""
    match = _GUARANTEE.fullmatch(text)
    if match is None or (match["bound"] and match["unit"] not in UNITS):
        raise InputError(f"guarantee {text!r}: write name, name<=3s or name>=10Hz; units are {' '.join(UNITS)}")
    if not match["bound"]:
        return match["name"]
    bound = BOUNDS[0] if match["bound"] == "<=" else BOUNDS[1]
    return GuaranteeRequirement(match["name"], bound, float(match["number"]), match["unit"])


def search(entries: Sequence[Entry], criteria: Criteria) -> list[Entry]:
    """The entries that meet every criterion, in their order."""
    return [entry for entry in entries if _meets(entry, criteria)]


def _meets(entry: Entry, criteria: Criteria) -> bool:
    words = f"{entry['name']} {entry.get('description', '')}".lower()
    return (
        criteria.text.lower() in words
        and _has(entry.get("provides", ()), criteria.provides)
        and _has(entry.get("needs", ()), criteria.needs)
        and _gives(entry.get("guarantees", ()), criteria.guarantee)
        and criteria.channel in ("", entry.get("channel"))
        and criteria.state in ("", entry.get("state"))
    )


def _has(words: Sequence[str], wanted: str) -> bool:
    return not wanted or any(word == wanted or word.startswith(f"{wanted}/") for word in words)


def _gives(documents: Sequence[Mapping[str, Any]], wanted: str | GuaranteeRequirement) -> bool:
    if isinstance(wanted, str):
        return not wanted or any(document["name"] == wanted for document in documents)
    return not shortfall(wanted, [_guarantee(document) for document in documents])


def _guarantee(document: Mapping[str, Any]) -> Guarantee:
    bound = next(bound for bound in BOUNDS if bound in document)
    return Guarantee(document["name"], bound, document[bound], document["unit"])


def find(entries: Sequence[Entry], wanted: str) -> list[Entry]:
    """`NAME` (the application, and the newest version of the chart) or `NAME@VERSION`; RefusalError when there is
    none."""
    name, separator, version = wanted.partition("@")
    named = [entry for entry in entries if entry["name"] == name]
    charts = [entry for entry in named if entry["kind"] == "chart"]
    if separator:
        matches = [entry for entry in charts if entry["version"] == version]
    else:
        newest = sorted(charts, key=lambda entry: version_key(entry["version"]))[-1:]
        matches = [entry for entry in named if entry["kind"] != "chart"] + newest
    if not matches:
        raise RefusalError("UnknownEntry", f"the catalogue has no {wanted!r}; {_instead(entries, named, name)}")
    return matches


def _instead(entries: Sequence[Entry], named: Sequence[Entry], name: str) -> str:
    """What somebody who asked for an entry that is not there can write instead; `named`: those of the name before @."""
    versions = ", ".join(entry["version"] for entry in named if entry["kind"] == "chart")
    if versions:
        return f"versions of {name}: {versions}"
    if named:
        return f"{name} is an application, and those have no versions: write {name}"
    known = sorted({entry["name"] for entry in entries})
    return f"{did_you_mean(name, known)}there are {', '.join(known) or 'nothing'}"


def upgrade_rows(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    """One row per chart version: what it replaces and what may take its place."""
    charts: dict[str, list[Entry]] = {}
    for entry in entries:
        if entry["kind"] == "chart":
            charts.setdefault(entry["name"], []).append(entry)
    return [row for name in sorted(charts) for row in _rows(charts[name])]


def _rows(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    versions = [
        ChartVersion(e["name"], e["version"], "", "", replaces=e.get("replaces", ""), skips=tuple(e.get("skips", ())))
        for e in entries
    ]
    successors = upgrades(versions)
    return [
        {
            "chart": entry["name"],
            "version": entry["version"],
            "channel": entry["channel"],
            "state": entry["state"],
            "replaces": entry.get("replaces", ""),
            "skips": list(entry.get("skips", ())),
            "upgrades_to": list(successors[entry["version"]]),
        }
        for entry in sorted(entries, key=lambda entry: version_key(entry["version"]))
    ]


def dot(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows of `upgrade_rows` as a graph in Graphviz' language; an arrow leads to the newer version."""
    lines = ["digraph upgrades {", "  rankdir=LR;", "  node [shape=box];"]
    for row in rows:
        node = f"{row['chart']} {row['version']}"
        lines.append(f'  "{node}" [label="{node}\\n{row["channel"]}, {row["state"]}"];')
        lines += [
            f'  "{node}" -> "{row["chart"]} {new}"' + (" [style=dashed];" if _skipped(rows, row, new) else ";")
            for new in row["upgrades_to"]
        ]
    return "\n".join([*lines, "}", ""])


def _skipped(rows: Sequence[Mapping[str, Any]], row: Mapping[str, Any], new: str) -> bool:
    target = next(r for r in rows if r["chart"] == row["chart"] and r["version"] == new)
    return bool(target["replaces"] != row["version"])
