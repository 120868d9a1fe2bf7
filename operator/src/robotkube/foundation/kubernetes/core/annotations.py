"""Annotations of TaskDescriptions: facts about a task that are not part of its spec."""

from __future__ import annotations

AGENTS_ANNOTATION = "robotkube.io/agents"
RENEWED_ANNOTATION = "robotkube.io/lease-renewed"
