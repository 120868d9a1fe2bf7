"""The YAML of a bag: metadata.yaml of a rosbag2 folder, and QoS profiles as all versions state them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robotkube.errors import InputError
from robotkube.robots.bags.core.playback import BagTopic

METADATA = "metadata.yaml"
UNKNOWN = "unknown"
COMPRESSIONS = ("", "zstd")
METADATA_BYTES_MAX = 16 * 1024 * 1024
QOS_BYTES_MAX = 64 * 1024
FILES_MAX = 10_000
DEPTH_DEFAULT = 10
DEPTH_MAX = 1_000_000
_RELIABILITIES = {"1": "reliable", "2": "best_effort"}
_DURABILITIES = {"1": "transient_local", "2": "volatile"}


@dataclass(frozen=True)
class Metadata:
    """The parts of metadata.yaml that say how to read the files. `compression`: format of `mode` (file, message,
    UNKNOWN or empty); `forms`: topic -> how its messages are serialised, as far as it says."""

    storage: str
    files: tuple[Path, ...]
    mode: str = ""
    compression: str = ""
    forms: Mapping[str, str] = field(default_factory=dict)


def read_metadata(folder: Path) -> Metadata:
    """metadata.yaml of the folder; InputError says what is wrong with it."""
    path = folder / METADATA
    information = _load(_text(path), path)
    try:
        information = information["rosbag2_bagfile_information"]
        storage = str(information["storage_identifier"])
        names = list(information["relative_file_paths"])
        mode = str(information.get("compression_mode") or "").lower()
        compression = str(information.get("compression_format") or "").lower()
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: is not the metadata of a rosbag2 bag: {error!r}") from error
    if not names or len(names) > FILES_MAX:
        raise InputError(f"{path}: relative_file_paths names {len(names)} files; 1 to {FILES_MAX} are read")
    if mode == "message" and compression not in COMPRESSIONS:
        raise InputError(
            f"{path}: compression_format: {compression[:40]!r} is not zstd; convert it: `ros2 bag convert`"
        )
    files = tuple(_inside(folder, str(name), path) for name in names)
    forms = _forms(information.get("topics_with_message_count"))
    return Metadata(storage, files, mode if mode == "message" else "", compression, forms)


def _forms(topics: Any) -> dict[str, str]:
    """Topic -> its serialization_format, of what is written as rosbag2 writes it."""
    listed = topics if isinstance(topics, list) else []
    entries = [entry.get("topic_metadata") for entry in listed if isinstance(entry, dict)]
    described = [entry for entry in entries if isinstance(entry, dict) and entry.get("serialization_format")]
    return {str(entry.get("name")): str(entry["serialization_format"])[:40] for entry in described}


def qos_profile(value: Any) -> dict[str, Any]:
    """The first offered QoS profile, of YAML text or of what stands in it; nothing when it says none."""
    if isinstance(value, str):
        value = _load_quietly(value) if len(value) <= QOS_BYTES_MAX else None
    return value[0] if isinstance(value, list) and value and isinstance(value[0], dict) else {}


def topic(name: str, type_name: str, offered: Any) -> BagTopic:
    """A topic with its QoS profile; rosbag2 writes policies as words (version 9) or numbers (before)."""
    profile = qos_profile(offered)
    reliability = str(profile.get("reliability") or "reliable")
    durability = str(profile.get("durability") or "volatile")
    depth = profile.get("depth")
    return BagTopic(
        name=name,
        type=type_name,
        reliability=_RELIABILITIES.get(reliability, reliability),
        durability=_DURABILITIES.get(durability, durability),
        depth=depth if isinstance(depth, int) and 0 < depth <= DEPTH_MAX else DEPTH_DEFAULT,
    )


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > METADATA_BYTES_MAX:
            raise InputError(f"{path}: larger than {METADATA_BYTES_MAX} bytes")
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error}); name a rosbag2 folder or a file of a bag") from error


def _load(text: str, path: Path) -> Any:
    import yaml

    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError, TypeError) as error:
        reason = " ".join(str(error).split())[:300]
        raise InputError(f"{path}: is not readable as YAML: {reason}") from error


def _load_quietly(text: str) -> Any:
    import yaml

    try:
        return yaml.safe_load(text) if text else None
    except (yaml.YAMLError, ValueError, RecursionError, TypeError):
        return None


def _inside(folder: Path, name: str, where: Path) -> Path:
    """The file in the folder; early versions wrote the folder's own name in front."""
    for candidate in (folder / name, folder / Path(name).name):
        try:
            if candidate.resolve().is_relative_to(folder.resolve()) and candidate.is_file():
                return candidate
        except (OSError, ValueError):
            continue
    raise InputError(f"{where}: relative_file_paths: {name[:200]!r} is not there; put it beside {METADATA}")


def data_files(folder: Path, endings: Sequence[str]) -> list[Path]:
    """Files of a bag whose metadata.yaml is not there, in the order of their names; of one that lies there packed and
    unpacked, the unpacked one. Nothing when the folder cannot be read."""
    try:
        paths = sorted(path for path in folder.iterdir() if path.name.endswith(tuple(endings)) and path.is_file())
    except OSError:
        return []
    return [path for path in paths if path.with_suffix("") not in paths]
