"""The recorder of walks: which files a value passes on its way through the platform, seen in a run of the real code.

The value takes one form after another: a message becomes a change, a change an event. Wherever the next form is made,
or an adapter gives the value or takes it, the functions that are under way at that moment are on the walk. What they
call besides has returned by then and is not: it is looked up.
"""

from __future__ import annotations

import inspect
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from ci.folders import PROJECT

SOURCE = PROJECT / "operator" / "src" / "robotkube"
PLATFORM, STAND_IN, OTHER = "platform", "stand-in", "other"
DEPTH_MAX = 2  # of the containers in which a form is looked for


@dataclass(frozen=True)
class Route:
    """The route of a value: `forms` are the classes of its forms. It ends when one of the class `end` is made, or when
    that function of a stand-in has returned.

    `adapters` say for which adapters a stand-in works: its functions count as those of the same name of the first that
    has them (none: it stands for what lies below the platform's code). `hand_overs` are functions that take the value
    or give it in no form of its own: of stand-ins at ports, and those of the platform that put it into a queue."""

    forms: tuple[type, ...]
    end: type | Callable[..., Any]
    adapters: Mapping[type, tuple[type, ...]] = field(default_factory=dict)
    hand_overs: tuple[Callable[..., Any], ...] = ()


@dataclass
class Station:
    """A file on a walk: the function by which it is entered first, and the forms that are made in it."""

    path: Path
    entered: str
    forms: list[str] = field(default_factory=list)


class WalkRecorder:
    """Records one run. `stations` are the files of the walk in the order in which a reader meets them, `files` all of
    the platform whose code ran meanwhile, `reached` the forms that were made and the hand-overs that were passed,
    `unknown` the functions of stand-ins that gave the value and work for no adapter."""

    def __init__(self, route: Route) -> None:
        self._route = route
        functions = (*route.hand_overs, *(() if isinstance(route.end, type) else (route.end,)))
        self._hand_overs = {code_of(function) for function in functions}
        self._adapters = dict(_adapter_functions(route.adapters))
        self._known: list[object] = []
        self._lock = threading.Lock()
        self.stations: dict[Path, Station] = {}
        self.files: set[Path] = set()
        self.reached: set[str] = set()
        self.unknown: set[str] = set()

    @property
    def ended(self) -> bool:
        """Return whether the value has come to the end of its route."""
        return name_of(self._route.end) in self.reached

    @property
    def missed(self) -> list[str]:
        """The forms and hand-overs of the route that the value did not pass."""
        names = {name_of(form) for form in self._route.forms} | {name_of(over) for over in self._route.hand_overs}
        return sorted((names | {name_of(self._route.end)}) - self.reached)

    @contextmanager
    def recording(self) -> Iterator[None]:
        """Record what this thread does, and those that it starts meanwhile."""
        before, of_threads = sys.getprofile(), threading.getprofile()
        threading.setprofile(self._observe)
        sys.setprofile(self._observe)
        try:
            yield
        finally:
            sys.setprofile(before)
            threading.setprofile(of_threads)

    def _observe(self, frame: FrameType, event: str, result: Any) -> None:
        if event in ("call", "return") and not self.ended:
            with self._lock:
                self._look(frame, event, result)

    def _look(self, frame: FrameType, event: str, result: Any) -> None:
        code, caller = frame.f_code, frame.f_back
        kind = STAND_IN if code in self._adapters else _kind(code)
        called = caller is not None and _kind(caller.f_code) == PLATFORM
        if kind == PLATFORM:
            self.files.add(Path(code.co_filename))
            if code in self._hand_overs:
                self._note(frame)
                self.reached.update([code.co_qualname] if event == "return" else [])
            if event == "return":
                self._give([result], frame)
            elif called:
                self._give(list(frame.f_locals.values()), caller)
        elif kind == STAND_IN and called and caller is not None:
            self._pass_port(code, caller, event, result)
        elif event == "return" and code.co_name == "__init__" and called:  # as dataclasses write it
            self._give([frame.f_locals["self"]], caller)

    def _give(self, values: Sequence[object], frame: FrameType | None) -> None:
        """Note a form that is given for the first time: it was made by the innermost function under way."""
        forms = [] if _is_below_stand_in(frame) else self._new_forms(values)
        if forms and frame is not None:
            innermost = self._note(frame)
            innermost.forms += [name for name in forms if name not in innermost.forms]
            self.reached.update(forms)

    def _pass_port(self, code: CodeType, caller: FrameType, event: str, result: Any) -> None:
        """Note the adapter that a stand-in works for, when the value goes to it or comes from it."""
        forms = self._new_forms([result]) if event == "return" and not _is_below_stand_in(caller) else []
        if not forms and code not in self._hand_overs:
            return
        self._note(caller)
        if code not in self._adapters:
            self.unknown.add(code.co_qualname)
        elif (adapter := self._adapters[code]) is not None:
            self._station(adapter).forms += forms
        self.reached.update(forms, [code.co_qualname] if event == "return" and code in self._hand_overs else [])

    def _new_forms(self, values: Sequence[object]) -> list[str]:
        """The names of the forms among the values that were not seen yet; one that was read back is the same."""
        names = []
        for value in _held(values, DEPTH_MAX):
            if isinstance(value, self._route.forms) and value not in self._known:
                self._known.append(value)
                names.append(type(value).__name__)
        return names

    def _note(self, frame: FrameType) -> Station:
        """Put the functions that are under way on the walk, from the first one; returns the station of the last."""
        codes = [at.f_code for at in _stack(frame) if _kind(at.f_code) == PLATFORM]
        for code in reversed(codes):
            self._station(code)
        return self._station(codes[0])

    def _station(self, code: CodeType) -> Station:
        path = Path(code.co_filename)
        return self.stations.setdefault(path, Station(path, code.co_qualname))


def code_of(function: Callable[..., Any]) -> CodeType:
    """The code of a function."""
    code: CodeType = inspect.unwrap(function).__code__
    return code


def name_of(one: type | Callable[..., Any]) -> str:
    """The name of a form, or of a stand-in's function."""
    return one.__name__ if isinstance(one, type) else code_of(one).co_qualname


def _adapter_functions(adapters: Mapping[type, tuple[type, ...]]) -> Iterator[tuple[CodeType, CodeType | None]]:
    """The functions of stand-ins, each with the adapter's function that it works for."""
    for stand_in, classes in adapters.items():
        for name, function in inspect.getmembers(stand_in, inspect.isfunction):
            same = (getattr(one, name, None) for one in classes)
            real = next((candidate for candidate in same if inspect.isfunction(candidate)), None)
            if real is not None or not classes:
                yield code_of(function), code_of(real) if real is not None else None


def _kind(code: CodeType) -> str:
    return OTHER if code.co_name == "<module>" else _kind_of_file(code.co_filename)


@lru_cache(4096)
def _kind_of_file(name: str) -> str:
    path = Path(name)
    if not path.is_relative_to(SOURCE):
        return OTHER
    return STAND_IN if path.is_relative_to(SOURCE / "testing") else PLATFORM


def _stack(frame: FrameType | None) -> Iterator[FrameType]:
    while frame is not None:
        yield frame
        frame = frame.f_back


def _is_below_stand_in(frame: FrameType | None) -> bool:
    """Return whether a stand-in for tests is under way: what it calls of the platform is its own affair."""
    return any(_kind(at.f_code) == STAND_IN for at in _stack(frame))


def _held(values: Iterable[object], depth: int) -> Iterator[object]:
    for value in values:
        yield value
        if depth and isinstance(value, dict):
            yield from _held(list(value.values()), depth - 1)
        elif depth and isinstance(value, list | tuple | set | frozenset):
            yield from _held(list(value), depth - 1)
