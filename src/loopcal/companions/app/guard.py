"""Who may speak to the app: this machine, from the app's own page; with a token from elsewhere.

A browser sends the name it was asked for (Host) and the page that asks (Origin). A page of
another site that reaches this machine by a name of its own (DNS rebinding) differs in the one, a
foreign page in the other.
"""

from __future__ import annotations

import re
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

COOKIE = "loopcal_token"
LARGEST = 500_000_000
"""Bytes of one upload."""
# NiceGUI needs 'unsafe-eval'; no text of a file is ever compiled (docs/decisions/0095).
_POLICY = (
    "default-src 'self'; script-src 'self' 'nonce-{nonce}' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "connect-src 'self'; worker-src 'self' blob:; frame-ancestors 'none'; base-uri 'self'; "
    "object-src 'none'; form-action 'self'"
)


@dataclass(frozen=True)
class Objection:
    """Why a request is refused, and the status that says so."""

    words: str
    status: int = 403


@dataclass(frozen=True)
class Rules:
    """hosts: names with port under which the app may be asked; token: None where none is needed."""

    hosts: frozenset[str]
    token: str | None = None

    @classmethod
    def of(cls, host: str, port: int) -> Rules:
        """For a server bound to a host: of this machine alone, or of others with a token."""
        local_hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]")}
        if host in ("127.0.0.1", "localhost", "::1"):
            return cls(frozenset(local_hosts))
        named = set() if host in ("0.0.0.0", "::") else {f"{host}:{port}"}
        # 24 bytes, 192 bits: no number of guesses reaches it.
        return cls(frozenset(local_hosts | named), secrets.token_urlsafe(24))

    def objection(self, scope: Scope) -> Objection | None:
        """Why a request is refused; None where it is not."""
        headers = {name.lower(): value for name, value in scope.get("headers", ())}
        host = headers.get(b"host", b"").decode("latin-1").lower()
        # With a token other machines may ask by any name: then the token protects.
        if self.token is None and host not in self.hosts:
            return Objection(f"this app answers to {sorted(self.hosts)[0]} only")
        origin = headers.get(b"origin", b"").decode("latin-1").lower()
        if origin and origin.partition("://")[2] != host:
            return Objection("another page may not use this app")
        if self.token is not None and not self.has_token(scope, headers):
            return Objection("the token is missing: open the address that `loopcal app` printed")
        length = headers.get(b"content-length", b"0")
        if not length.isdigit() or int(length) > LARGEST:
            return Objection(f"an upload has at most {LARGEST // 10**6} MB", 413)
        return None

    def has_token(self, scope: Scope, headers: dict[bytes, bytes]) -> bool:
        """Whether the token stands in the address or in the cookie that it left."""
        assert self.token is not None
        return any(
            # In constant time: how long an answer takes shows nothing of the token.
            secrets.compare_digest(token.encode(), self.token.encode())
            for token in (*_asked(scope), *_kept(headers))
        )


def _asked(scope: Scope) -> list[str]:
    return parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [])


def _kept(headers: dict[bytes, bytes]) -> list[str]:
    try:
        cookie = SimpleCookie(headers.get(b"cookie", b"").decode("latin-1"))
    except CookieError:
        return []
    return [cookie[COOKIE].value] if COOKIE in cookie else []


class Guard:
    """Refuses what `Rules` refuse, and gives every page its content policy."""

    def __init__(self, inner: Application, rules: Rules) -> None:
        self.inner, self.rules = inner, rules

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """An ASGI application."""
        if scope["type"] not in ("http", "websocket"):
            await self.inner(scope, receive, send)
            return
        objection = self.rules.objection(scope)
        if objection is not None:
            await _refuse(scope, receive, send, objection)
        elif scope["type"] == "websocket":
            await self.inner(scope, receive, send)
        else:
            page = _Page(send, self.rules.token if _asked(scope) else None)
            await self.inner(scope, _capped(receive), page)


def _capped(receive: Receive) -> Receive:
    """An upload without a stated length ends where it becomes too large."""
    had = 0

    async def next_part() -> Message:
        nonlocal had
        message = await receive()
        had += len(message.get("body", b""))
        return {"type": "http.disconnect"} if had > LARGEST else message

    return next_part


async def _refuse(scope: Scope, receive: Receive, send: Send, why: Objection) -> None:
    if scope["type"] == "websocket":
        # ASGI hands over the request to connect ahead of any answer; 1008 is a policy violation
        # (RFC 6455, 7.4.1).
        await receive()
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8")]
    headers += [(b"connection", b"close"), *_COMMON]
    await send({"type": "http.response.start", "status": why.status, "headers": headers})
    await send({"type": "http.response.body", "body": f"refused: {why.words}\n".encode()})


class _Page:
    """Sends an answer on: to a page it adds the policy, and its nonce to each script of it."""

    def __init__(self, send: Send, token: str | None) -> None:
        self.send, self.token = send, token
        self.begin: Message | None = None
        self.body = b""

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = dict(message["headers"])
            if headers.get(b"content-type", b"").startswith(b"text/html"):
                self.begin = message
                return
            message = {**message, "headers": [*message["headers"], *_COMMON]}
        elif self.begin is not None:
            self.body += message.get("body", b"")
            if message.get("more_body"):
                return
            await self.page(self.begin)
            return
        await self.send(message)

    async def page(self, begin: Message) -> None:
        """Send the page that is whole now."""
        nonce = secrets.token_urlsafe(16)
        body = re.sub(rb"<script\b", b'<script nonce="' + nonce.encode() + b'"', self.body)
        replaced_headers = (b"content-length", b"content-security-policy")
        headers = [
            (name, value)
            for name, value in begin["headers"]
            if name.lower() not in replaced_headers
        ]
        stated_policy = dict(begin["headers"]).get(b"content-security-policy")
        # A page that loopcal wrote comes with a stricter policy (`sending.shown`).
        policy = stated_policy or _POLICY.format(nonce=nonce).encode()
        headers += [(b"content-length", b"%d" % len(body)), (b"content-security-policy", policy)]
        if self.token is not None:
            kept = f"{COOKIE}={self.token}; Path=/; HttpOnly; SameSite=Strict"
            headers.append((b"set-cookie", kept.encode()))
        await self.send({**begin, "headers": [*headers, *_COMMON]})
        await self.send({"type": "http.response.body", "body": body})


_COMMON = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
)
