"""Client ids of which nobody without the account's password knows the whole.

mosquitto binds no client id to an account: whoever names the id of a session gets it, ends the connection of its
owner, and has what waits in it, or lets it be thrown away. So an id is a name, which everybody may know, and a secret
part of 128 bits, which only the owner and the broker know. It stays the same over restarts, so the session lives on,
and becomes another one with another password.

An id stands in no log, metric or complaint: there it is the name.
"""

from __future__ import annotations

import hashlib
import hmac

SECRET_CHARACTERS = 32
HEXADECIMAL = frozenset("0123456789abcdef")


def client_id(name: str, password: str) -> str:
    """The id of the connection `name` of the account with this password."""
    secret = hmac.new(password.encode(), name.encode(), hashlib.sha256).hexdigest()
    return f"{name}-{secret[:SECRET_CHARACTERS]}"


def connection_name(identifier: str) -> str:
    """The name in an id, without the secret part; an id of another form is its own name."""
    name, _, secret = identifier.rpartition("-")
    return name if name and len(secret) == SECRET_CHARACTERS and HEXADECIMAL.issuperset(secret) else identifier
