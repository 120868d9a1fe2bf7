"""What is in a container image: the files that its layers leave, and what package managers say is installed.

Rules of the OCI image specification: a layer's whiteouts hide what lower layers have and nothing of its own, an opaque
folder hides all that lower layers have in it, an entry replaces what had its name, a path leads through symbolic links.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from robotkube.errors import InputError

FILE, FOLDER, SYMBOLIC_LINK, HARD_LINK, OTHER = "file", "folder", "symbolic link", "hard link", "other"
WHITEOUT, OPAQUE = ".wh.", ".wh..wh..opq"
LINKS_FOLLOWED_MAX = 40  # as Linux does
DPKG_STATUS = "var/lib/dpkg/status"
DPKG_FILE = re.compile(r"var/lib/dpkg/(status|status\.d/[^/]+(?<!\.md5sums))")  # the second without dpkg itself
WHEEL = re.compile(r"(?:.*/)?([^/]+)\.dist-info/METADATA")
EGG = re.compile(r"(?:.*/)?([^/]+)\.egg-info(/PKG-INFO)?")
STATED_LINE = re.compile(r"(Package|Status|Version|Source|Name):[ \t]*(.*)")
SOURCE = re.compile(r"(\S+)(?: \((\S+)\))?")

Package = tuple[str, str]
"""Name and version."""


@dataclass(frozen=True)
class Entry:
    """An entry of a layer: `path` without a leading slash, `target` of links, `sha256` of ELF files (`is_elf`) and of
    files that were asked for, `text` of files in which package managers state what is installed (`stated_text`)."""

    path: str
    kind: str
    target: str = ""
    sha256: str = ""
    is_elf: bool = False
    text: str = ""


@dataclass(frozen=True)
class LayerContents:
    """A layer's entries in their order, and the paths and folders whose contents in lower layers it hides."""

    entries: tuple[Entry, ...] = ()
    hidden: tuple[str, ...] = ()
    emptied: tuple[str, ...] = ()


@dataclass(frozen=True)
class ImageContents:
    """Files by path (with a leading slash), and packages. `sources` are source packages of those of Debian, `eggs`
    Python packages that were not installed as wheels."""

    files: Mapping[str, Entry] = field(default_factory=dict)
    debian: frozenset[Package] = frozenset()
    sources: frozenset[Package] = frozenset()
    wheels: frozenset[Package] = frozenset()
    eggs: frozenset[Package] = frozenset()

    @property
    def elf(self) -> dict[str, str]:
        """Path -> SHA-256 of every ELF file."""
        return {path: entry.sha256 for path, entry in self.files.items() if entry.is_elf}


def contents_of(layers: Iterable[LayerContents]) -> ImageContents:
    """The contents of an image of these layers, lowest first. InputError when links go round in circles or a list of
    packages cannot be read."""
    tree = _Tree()
    for layer in layers:
        tree.apply(layer)
    files = dict(tree.files())
    debian: set[Package] = set()
    sources: set[Package] = set()
    wheels: set[Package] = set()
    eggs: set[Package] = set()
    for path, entry in files.items():
        if DPKG_FILE.fullmatch(path[1:]):
            _read_dpkg(_text(path, entry), debian, sources)
        elif match := WHEEL.fullmatch(path):
            wheels.add(_python_package(match[1], _text(path, entry)))
        elif match := EGG.fullmatch(path):
            eggs.add(_python_package(match[1], _text(path, entry)))
    return ImageContents(files, *map(frozenset, (debian, sources, wheels, eggs)))


def states_packages(path: str) -> bool:
    """Return whether a file of that path (without a leading slash) states packages."""
    return any(pattern.fullmatch(path) for pattern in (DPKG_FILE, WHEEL, EGG))


def stated_text(path: str, data: bytes) -> str:
    """The lines of such a file that say what is installed; of metadata only the head. A file that says nothing gives
    one empty line."""
    text = data.decode("utf-8", errors="replace").replace("\r\n", "\n")
    if not DPKG_FILE.fullmatch(path):
        text = text.partition("\n\n")[0]
    return "\n".join(line for line in text.split("\n") if not line or STATED_LINE.fullmatch(line)) + "\n"


def python_name(name: str) -> str:
    """The name of a Python package in its normal form."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _text(path: str, entry: Entry) -> str:
    if not entry.text:
        raise InputError(f"{path}: is another name of a file that states no packages; build it as a file of its own")
    return entry.text


def _stated(stanza: str) -> dict[str, str]:
    matches = filter(None, map(STATED_LINE.fullmatch, stanza.split("\n")))
    return {match[1]: match[2].strip() for match in matches}


def _read_dpkg(text: str, debian: set[Package], sources: set[Package]) -> None:
    """Add the packages that are installed; where dpkg itself is not there, a stanza has no status."""
    for stanza in text.split("\n\n"):
        stated = _stated(stanza)
        if "Package" not in stated or not stated.get("Status", "installed").endswith("installed"):
            continue
        package = stated["Package"], stated.get("Version", "")
        source = SOURCE.fullmatch(stated.get("Source", "")) or SOURCE.fullmatch(package[0])
        debian.add(package)
        if source:
            sources.add((source[1], source[2] or package[1]))


def _python_package(folder: str, text: str) -> Package:
    name, _, version = folder.partition("-")
    stated = _stated(text)
    return python_name(stated.get("Name", name)), stated.get("Version", version)


class _Tree:
    """Folders as dictionaries, so that a whole one goes at once."""

    def __init__(self) -> None:
        self._root: dict[str, object] = {}

    def apply(self, layer: LayerContents) -> None:
        """Hide first, then add: whiteouts never concern the layer they are in."""
        for path in layer.emptied:
            folder = self._folder(path, make=False)
            if folder is not None:
                folder.clear()
        for path in layer.hidden:
            parent, _, name = path.rpartition("/")
            folder = self._folder(parent, make=False)
            if folder is not None:
                folder.pop(name, None)
        for entry in layer.entries:
            self._put(entry)

    def _put(self, entry: Entry) -> None:
        parent, _, name = entry.path.rpartition("/")
        folder = self._folder(parent, make=True)
        assert folder is not None
        if entry.kind == FOLDER:
            if not isinstance(folder.get(name), dict):
                folder[name] = {}
        elif entry.kind == HARD_LINK:
            folder[name] = self._linked(entry)
        else:
            folder[name] = entry

    def _linked(self, entry: Entry) -> Entry:
        parent, _, name = entry.target.rpartition("/")
        target = (self._folder(parent, make=False) or {}).get(name)
        if not isinstance(target, Entry):
            raise InputError(f"/{entry.path}: is a hard link to /{entry.target}, which is not there")
        return target

    def _folder(self, path: str, make: bool) -> dict[str, object] | None:
        """The folder at a path, through symbolic links; what is no folder gives way when one is made."""
        left = path.split("/")[::-1]
        folders = [self._root]
        followed = 0
        while left:
            part = left.pop()
            if part in ("", "."):
                continue
            if part == "..":
                del folders[max(len(folders) - 1, 1) :]
                continue
            child = folders[-1].get(part)
            if isinstance(child, Entry) and child.kind == SYMBOLIC_LINK:
                followed += 1
                if followed > LINKS_FOLLOWED_MAX:
                    raise InputError(f"/{path}: more than {LINKS_FOLLOWED_MAX} symbolic links lead on from it")
                folders = [self._root] if child.target.startswith("/") else folders
                left += child.target.split("/")[::-1]
                continue
            if not isinstance(child, dict):
                if not make:
                    return None
                child = folders[-1][part] = {}
            folders.append(child)
        return folders[-1]

    def files(self) -> Iterator[tuple[str, Entry]]:
        """Path (with a leading slash) and entry of every regular file, sorted within its folder."""
        waiting: list[tuple[str, object]] = [("", self._root)]
        while waiting:
            path, node = waiting.pop()
            if isinstance(node, dict):
                waiting += [(f"{path}/{name}", node[name]) for name in sorted(node, reverse=True)]
            elif isinstance(node, Entry) and node.kind == FILE:
                yield path, node
