"""The collections of a database that a chart under test writes to, read by pymongo."""

from __future__ import annotations

from typing import Any

from pymongo.database import Database

from robotkube.foundation.database.adapters.connection import translated


class PymongoCollections:
    """A whole database, whatever is in it, for an observer of what others write."""

    def __init__(self, database: Database[dict[str, Any]]) -> None:
        self._database = database

    def counts(self) -> dict[str, int]:
        """Collection -> number of its documents; those of the server itself are left out."""
        with translated("counting documents"):
            names = [name for name in self._database.list_collection_names() if not name.startswith("system.")]
            return {name: self._database[name].count_documents({}) for name in names}

    def put(self, collection: str) -> None:
        """Write a document without content."""
        with translated(f"writing to {collection}"):
            self._database[collection].insert_one({})

    def clear(self) -> None:
        """Delete all collections."""
        with translated("clearing"):
            for name in self.counts():
                self._database.drop_collection(name)
