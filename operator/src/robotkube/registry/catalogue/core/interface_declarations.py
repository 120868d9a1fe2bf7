"""The form of a chart version's interfaces and of the test values its suites install it with.

Only the form is checked here; what the templates give is the business of the interface suite.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robotkube.foundation.documents.core.entry_reader import read_one_of
from robotkube.foundation.documents.core.patterns import NAME, ROS_TYPE
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import join
from robotkube.registry.catalogue.core.entries import read_for_each

MEDIA = ("ros", "mqtt", "database")
DIRECTIONS = ("in", "out")
RELIABILITIES = ("reliable", "best_effort")
DURABILITIES = ("volatile", "transient_local")
ENCODINGS = ("rkf1", "text")
QOS_MAX = 2
SETS_MIN = 2
SETS_MAX = 8

_RESERVED = frozenset({"values"})
_KEYS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "ros": (("type", "qos"), ()),
    "mqtt": (("qos",), ("type", "encoding")),
    "database": ((), ()),
}


def read_interfaces(reader: Reader, value: Any, path: str) -> tuple[Mapping[str, Any], ...]:
    """The interfaces as they are written; names distinct, `causes` names an interface of direction out."""
    items = reader.sequence(value, path)
    interfaces = tuple(_interface(reader, item, f"{path}[{index}]") for index, item in enumerate(items))
    names = [item.get("name") for item in interfaces]
    outputs = [item.get("name") for item in interfaces if item.get("direction") == "out"]
    for index, item in enumerate(interfaces):
        if item.get("name") in names[:index]:
            reader.problems.append(f"{path}[{index}].name: {item.get('name')!r} stands twice; keep one of them")
        if "causes" in item and item["causes"] not in outputs:
            reader.problems.append(f"{path}[{index}].causes: {item['causes']!r:.40} is no interface of direction out")
    return interfaces


def _interface(reader: Reader, item: Any, path: str) -> Mapping[str, Any]:
    medium = item.get("medium") if isinstance(item, Mapping) else None
    needed, possible = _KEYS.get(medium, ((), ())) if isinstance(medium, str) else ((), ())
    known = ["forEach", "causes", *possible] if medium in MEDIA else ["forEach", "causes", "type", "qos", "encoding"]
    interface = reader.mapping(item, path, ["name", "medium", "direction", "topic", *needed], known)
    if interface:
        reader.word(interface.get("name"), f"{path}.name", NAME)
        read_one_of(reader, medium, f"{path}.medium", MEDIA)
        read_one_of(reader, interface.get("direction"), f"{path}.direction", DIRECTIONS)
        read_for_each(reader, interface.get("forEach"), f"{path}.forEach", _RESERVED)
        if not reader.prose(interface.get("topic", ""), f"{path}.topic") and "topic" in interface:
            reader.problems.append(f"{path}.topic: must not be empty")
        if not is_template(interface.get("type")):
            reader.text(interface.get("type"), f"{path}.type", ROS_TYPE)
        if "encoding" in interface and not is_template(interface["encoding"]):
            read_one_of(reader, interface["encoding"], f"{path}.encoding", ENCODINGS)
        if "causes" in interface and interface.get("direction") == "out":
            reader.problems.append(f"{path}.causes: only an interface of direction in causes something; remove it")
        _qos(reader, interface.get("qos"), f"{path}.qos", str(medium))
    return interface


def is_template(value: Any) -> bool:
    """Return whether the interface suite fills this for a set of values; what it gives is judged there."""
    return isinstance(value, str) and "{{" in value


def _qos(reader: Reader, value: Any, path: str, medium: str) -> None:
    if value is None or medium not in ("ros", "mqtt"):
        return
    keys = ["reliability", "durability"] if medium == "ros" else ["qos", "retain"]
    qos = reader.mapping(value, path, keys)
    given = {key: qos[key] for key in keys if key in qos and not is_template(qos[key])}
    for key, words in (("reliability", RELIABILITIES), ("durability", DURABILITIES)):
        if key in given:
            read_one_of(reader, given[key], f"{path}.{key}", words)
    if "qos" in given and (isinstance(given["qos"], bool) or given["qos"] not in range(QOS_MAX + 1)):
        reader.problems.append(f"{path}.qos: must be 0, 1 or 2")
    if "retain" in given and not isinstance(given["retain"], bool):
        reader.problems.append(f"{path}.retain: must be true or false")


def read_suites(reader: Reader, value: Any, path: str) -> Mapping[str, Any]:
    """`{sets: [{name, values, prepare?, configMaps?}, ...]}`, at least two sets; nothing when `value` is None."""
    if value is None:
        return {}
    suites = reader.mapping(value, path, ["sets"])
    sets = reader.sequence(suites.get("sets"), f"{path}.sets")
    if not SETS_MIN <= len(sets) <= SETS_MAX:
        reader.problems.append(f"{path}.sets: needs {SETS_MIN} to {SETS_MAX} sets of test values, has {len(sets)}")
    names = [_set(reader, item, f"{path}.sets[{index}]") for index, item in enumerate(sets)]
    twice = sorted({name for name in names if name and names.count(name) > 1})
    reader.problems += [f"{path}.sets: name {name!r} stands twice; rename one of them" for name in twice]
    return suites


def _set(reader: Reader, value: Any, path: str) -> str:
    test_set = reader.mapping(value, path, ["name", "values"], ["prepare", "configMaps"])
    if not isinstance(test_set.get("values", {}), Mapping):
        reader.problems.append(f"{path}.values: must be a mapping")
    if "prepare" in test_set:
        prepare = reader.mapping(test_set["prepare"], f"{path}.prepare", ["image", "command"])
        reader.word(prepare.get("image"), f"{path}.prepare.image", NAME)
        command = reader.sequence(prepare.get("command"), f"{path}.prepare.command")
        if not command or not all(isinstance(word, str) for word in command):
            reader.problems.append(f"{path}.prepare.command: must be a list of texts, at least one")
    _config_maps(reader, test_set.get("configMaps", {}), f"{path}.configMaps")
    return reader.word(test_set.get("name"), f"{path}.name", NAME) if test_set else ""


def _config_maps(reader: Reader, value: Any, path: str) -> None:
    if not isinstance(value, Mapping):
        reader.problems.append(f"{path}: must be a mapping of names to data")
        return
    for name, data in value.items():
        reader.text(name, path, NAME)
        if not isinstance(data, Mapping) or not all(isinstance(text, str) for text in data.values()):
            reader.problems.append(f"{join(path, name)}: must be a mapping of keys to texts")
