"""The cluster in memory under a manager that runs on a thread of its own."""

from __future__ import annotations

from typing import Any

from robotkube.testing.clusters import MemoryTasks


class Meanwhile:
    """A value of a task; while it is read, another task comes and this one goes, as on another thread."""

    def __init__(self, tasks: MemoryTasks) -> None:
        self._tasks = tasks

    def __deepcopy__(self, memory: dict[int, Any]) -> str:
        self._tasks.create("cloud-0", "second", {})
        self._tasks.withdraw("cloud-0", "first")
        self._tasks.create("cloud-0", "third", {})
        return "read"


def test_tasks_may_come_and_go_while_they_are_read() -> None:
    tasks = MemoryTasks()
    tasks.create("cloud-0", "first", {})
    tasks.objects["cloud-0/first"]["spec"]["x"] = Meanwhile(tasks)
    assert [task["metadata"]["name"] for task in tasks.tasks()] == ["first"]
    assert [task["metadata"]["name"] for task in tasks.tasks()] == ["second", "third"]
