"""Who asks: the session of a request's cookie, signing in at the provider, and signing out."""

from __future__ import annotations

import logging
import secrets
import time
from collections.abc import Sequence
from typing import Any

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from robotkube.delivery.console.adapters.web.openid_connect import OpenIdConnect, authorization_url
from robotkube.delivery.console.adapters.web.problems import LOGIN, ProblemError
from robotkube.delivery.console.core.asking import Writers, group_for, writable
from robotkube.delivery.console.core.sessions import SESSION_SECONDS, SIGNING_IN_SECONDS, Session, Sessions
from robotkube.delivery.console.core.signing_in import Person, SignIn, place_to_return
from robotkube.errors import InputError, RobotKubeError

NOBODY_SIGNS_IN = "Nobody signs in here, so nobody writes. Ask for tasks by `robotkube task submit`."
NO_WRITER = (
    "None of your groups may ask for tasks here (console.signIn.writers). Ask for them by `robotkube task submit`."
)
NOT_HERE = "Your groups may ask for tasks in {}, not in {}. Who runs the platform lists both in console.signIn.writers."
NOT_LISTED = (
    "Your account is in none of the groups that may read here. Ask whoever runs the platform (console.signIn.groups)."
)
NOT_POSSIBLE = "Nobody can sign in at the moment"
FOREIGN = "Give the word of /api/session in the header X-CSRF-Token."
CSRF_HEADER = "x-csrf-token"

log = logging.getLogger(__name__)


class People:
    """Sessions of one console. Without `settings` everybody reads, and nobody writes; `writers` may ask for tasks."""

    def __init__(
        self, settings: SignIn | None, provider: OpenIdConnect | None = None, writers: Sequence[Writers] = ()
    ) -> None:
        self._settings = settings
        self._writers = tuple(writers) if settings is not None else ()
        self._provider = provider or (OpenIdConnect(settings) if settings else None)
        self._sessions = Sessions(time.monotonic, lambda: secrets.token_urlsafe(32))
        prefix = "__Host-" if settings is not None and settings.encrypted else ""
        self._cookie, self._begun_cookie = f"{prefix}console", f"{prefix}console-signing-in"

    def session(self, request: Request) -> Session | None:
        """The session of a request; None when there is none."""
        return self._sessions.get(request.cookies.get(self._cookie, ""))

    def check_reading(self, request: Request) -> None:
        """Refuse a request of somebody who may not read."""
        if self._settings is None:
            return
        session = self.session(request)
        if session is None:
            raise ProblemError(401, "Not signed in", "Sign in with your account of the provider.")
        if not session.person.is_in(self._settings.groups):
            raise ProblemError(403, "Not in a listed group", NOT_LISTED)

    def writer(self, request: Request) -> Person:
        """Who asks to change something, which his session's word proves to be his own wish. Refused when he may ask
        for tasks nowhere."""
        if self._settings is None:
            raise ProblemError(403, "Nobody writes here", NOBODY_SIGNS_IN)
        self.check_reading(request)
        session = self.session(request)
        if session is None or not session.vouches(request.headers.get(CSRF_HEADER, "")):
            raise ProblemError(403, "Not from this page", FOREIGN)
        if not writable(session.person, self._writers):
            raise ProblemError(403, "You may not ask for tasks", NO_WRITER)
        return session.person

    def asker(self, request: Request) -> str:
        """Who asks a question that is dear to answer: a person whose session's word the request names, without sign-in
        the address that it comes from."""
        self.check_reading(request)
        session = self.session(request)
        if self._settings is None or session is None:
            return request.client.host if request.client else ""
        if not session.vouches(request.headers.get(CSRF_HEADER, "")):
            raise ProblemError(403, "Not from this page", FOREIGN)
        return session.person.name

    def group(self, person: Person, namespace: str) -> str:
        """The group by which somebody asks in a namespace. Refused when he may not."""
        group = group_for(person, self._writers, namespace)
        if not group:
            detail = NOT_HERE.format(", ".join(writable(person, self._writers)), namespace)
            raise ProblemError(403, "Not in this namespace", detail)
        return group

    def may_read(self, request: Request) -> bool:
        """Return whether a request's sender may read."""
        try:
            self.check_reading(request)
        except ProblemError:
            return False
        return True

    def described(self, request: Request) -> dict[str, Any]:
        """The document of /api/session."""
        session = self.session(request) if self._settings is not None else None
        reads = self.may_read(request)
        namespaces = writable(session.person, self._writers) if session and reads else ()
        no_writer = NO_WRITER if self._settings is not None else NOBODY_SIGNS_IN
        return {
            "user": session.person.name if session else None,
            "groups": list(session.person.groups) if session else [],
            "may_read": reads,
            "may_write": bool(namespaces),
            "namespaces": list(namespaces),
            "csrf": session.csrf if session else None,
            "sign_in": LOGIN if self._settings is not None else None,
            "why_not": ""
            if namespaces
            else no_writer
            if reads
            else NOT_LISTED
            if session
            else "You are not signed in.",
        }

    async def login(self, request: Request) -> Response:
        """Send the browser to the provider."""
        settings, provider = self._configured()
        try:
            client_id = provider.client_id()
            addresses = await provider.provider()
        except RobotKubeError as error:
            log.warning("sign-in is not possible reason=%s", error)
            raise ProblemError(503, NOT_POSSIBLE, str(error), 10.0) from error
        key, begun = self._sessions.begin(place_to_return(request.query_params.get("back", "/")))
        url = authorization_url(addresses, settings, client_id, begun.state, begun.verifier)
        answer = RedirectResponse(url, 302, {"Cache-Control": "no-store"})
        self._set(answer, self._begun_cookie, key, SIGNING_IN_SECONDS)
        return answer

    async def callback(self, request: Request) -> Response:
        """Take the provider's answer, and begin a session."""
        _, provider = self._configured()
        query = request.query_params
        begun = self._sessions.finish(request.cookies.get(self._begun_cookie, ""), query.get("state", ""))
        if begun is None:
            raise ProblemError(
                400, "Sign-in was not begun here", "Begin again: it was too long ago, or in another browser."
            )
        if "code" not in query:
            detail = f"The provider says: {query.get('error_description') or query.get('error') or 'nothing'}"[:500]
            raise ProblemError(403, "Not signed in", detail)
        try:
            person = await provider.person(query["code"], begun.verifier)
        except InputError as error:
            log.warning("sign-in refused reason=%s", error)
            raise ProblemError(403, "Not signed in", "The provider does not take the sign-in; begin again.") from error
        except RobotKubeError as error:
            log.warning("sign-in is not possible reason=%s", error)
            raise ProblemError(503, NOT_POSSIBLE, str(error), 10.0) from error
        log.info("signed in user=%s groups=%d", person.name, len(person.groups))
        self._sessions.close(request.cookies.get(self._cookie, ""))
        answer = RedirectResponse(begun.back, 303, {"Cache-Control": "no-store"})
        self._set(answer, self._cookie, self._sessions.open(person), SESSION_SECONDS)
        self._set(answer, self._begun_cookie, "", 0)
        return answer

    async def logout(self, request: Request) -> Response:
        """End the session."""
        session = self.session(request)
        if session is None or not session.vouches(request.headers.get(CSRF_HEADER, "")):
            raise ProblemError(403, "Not from this page", FOREIGN)
        self._sessions.close(request.cookies.get(self._cookie, ""))
        answer = Response(status_code=204)
        self._set(answer, self._cookie, "", 0)
        return answer

    def _configured(self) -> tuple[SignIn, OpenIdConnect]:
        if self._settings is None or self._provider is None:
            raise ProblemError(404, "No sign-in here", "Everybody who reaches this console reads.")
        return self._settings, self._provider

    def _set(self, answer: Response, name: str, value: str, seconds: float) -> None:
        secure = self._settings is not None and self._settings.encrypted
        answer.set_cookie(name, value, max_age=int(seconds), path="/", secure=secure, httponly=True, samesite="lax")
