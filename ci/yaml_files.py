"""YAML files that people write for commands here, read with errors that name the file and the fix."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from ci.errors import InputError

MERGE = "tag:yaml.org,2002:merge"


class _EachKeyOnce(yaml.SafeLoader):
    """Of two keys of one name YAML's own loader drops the first without a word, with all that stands below it."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        known: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == MERGE:
                continue
            if key.value in known:
                raise yaml.constructor.ConstructorError(
                    None, None, f"{key.value} stands twice in one mapping; keep one of them", key.start_mark
                )
            known.add(key.value)
        return super().construct_mapping(node, deep)


def read(path: Path, fix: str = "") -> Any:
    """What a file says; InputError when it cannot be read, then with the `fix`, or is not YAML."""
    try:
        return yaml.load(path.read_text(encoding="utf-8"), Loader=_EachKeyOnce)  # noqa: S506 - it is a safe one
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}){f'; {fix}' if fix else ''}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not text in UTF-8 ({error.reason} at byte {error.start})") from error
    except yaml.YAMLError as error:
        raise InputError(f"{path}: is not YAML: {' '.join(str(error).split())}") from error
