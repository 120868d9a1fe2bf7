"""Messages of installed types by their Python classes: the default message, and the check of serialised bytes.

It imports the packages' Python messages (and with some numpy), which `rclpy_node` does without: only for processes that
observe interfaces.
"""

from __future__ import annotations

import importlib
from typing import Any

from robotkube.errors import InputError

PADDING_BYTES_MAX = 3


def message_class(type_name: str) -> Any:
    """The Python class of a type such as geometry_msgs/msg/PoseStamped; InputError when it is not installed."""
    package, _, name = type_name.replace("/msg/", "/").partition("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"type {type_name}: is not installed in this image ({error})") from error


def default_message(type_name: str) -> bytes:
    """The serialised message of a type with all fields at their defaults."""
    from rclpy.serialization import serialize_message

    return bytes(serialize_message(message_class(type_name)()))


def type_mismatch(type_name: str, data: bytes) -> str:
    """The reason why `data` is no serialised message of the type, in words; empty when it is one.

    It is one when it stays as long after it was read and written."""
    from rclpy.serialization import deserialize_message, serialize_message

    try:
        again = serialize_message(deserialize_message(data, message_class(type_name)))
    except Exception:  # the bindings raise their own errors and the middleware's
        return f"{len(data)} bytes cannot be read as one"
    if abs(len(again) - len(data)) > PADDING_BYTES_MAX:
        return f"a message has {len(data)} bytes, read as one {len(again)}"
    return ""
