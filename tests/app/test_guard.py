"""Who may speak to the app, and what a page may do."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from loopcal.companions.app.guard import COOKIE, LARGEST, Guard, Rules


def scope(kind: str = "http", query: str = "", **headers: str) -> dict[str, Any]:
    named = [(k.replace("_", "-").encode(), v.encode()) for k, v in headers.items()]
    return {"type": kind, "query_string": query.encode(), "headers": named}


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost:8765", "[::1]:8765"])
def test_this_machine_may_ask(host: str) -> None:
    assert Rules.of("127.0.0.1", 8765).objection(scope(host=host)) is None


@pytest.mark.parametrize(
    "host", ["evil.example", "127.0.0.1:80", "evil.example:8765", "", "127.0.0.1:8765.evil.example"]
)
def test_a_name_of_another_site_is_refused(host: str) -> None:
    """DNS rebinding: the browser asks this machine under a foreign name."""
    assert Rules.of("127.0.0.1", 8765).objection(scope(host=host)) is not None


@pytest.mark.parametrize("origin", ["https://evil.example", "http://localhost:1", "null"])
@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_a_foreign_page_is_refused(kind: str, origin: str) -> None:
    rules = Rules.of("127.0.0.1", 8765)
    assert rules.objection(scope(kind, host="127.0.0.1:8765", origin=origin)) is not None
    own = scope(kind, host="127.0.0.1:8765", origin="http://127.0.0.1:8765")
    assert rules.objection(own) is None


def test_other_machines_need_the_token() -> None:
    rules = Rules.of("0.0.0.0", 8765)
    assert rules.token is not None
    host = "10.0.0.7:8765"
    assert rules.objection(scope(host=host)) is not None
    assert rules.objection(scope(host=host, query="token=wrong")) is not None
    assert rules.objection(scope(host=host, query=f"token={rules.token}")) is None
    assert rules.objection(scope(host=host, cookie=f"{COOKIE}={rules.token}")) is None
    assert rules.objection(scope(host=host, cookie=f"{COOKIE}=x")) is not None


def test_an_upload_has_a_largest_size() -> None:
    rules = Rules.of("127.0.0.1", 8765)
    for length in (str(LARGEST + 1), "2000000000", "-1", "x"):
        asked = scope(host="127.0.0.1:8765", content_length=length)
        assert rules.objection(asked) is not None


def test_an_upload_of_no_stated_length_ends_where_it_is_too_large(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("loopcal.companions.app.guard.LARGEST", 10)
    seen: list[str] = []

    async def reads(_: Any, receive: Any, send: Any) -> None:
        for _i in range(3):
            seen.append((await receive())["type"])

    async def parts() -> dict[str, Any]:
        return {"type": "http.request", "body": b"12345678", "more_body": True}

    answered(Guard(reads, Rules.of("127.0.0.1", 8765)), scope(host="127.0.0.1:8765"), parts)
    assert seen == ["http.request", "http.disconnect", "http.disconnect"]


async def _nothing() -> dict[str, Any]:
    return {"type": "http.request", "body": b""}


def answered(app: Any, asked: Any, receive: Any = _nothing) -> list[Any]:
    sent: list[Any] = []

    async def send(message: Any) -> None:
        sent.append(message)

    with ThreadPoolExecutor(1) as pool:  # a browser of other tests runs a loop in this thread
        pool.submit(asyncio.run, app(asked, receive, send)).result()
    return sent


def page(text: str, kind: str = "text/html; charset=utf-8") -> Any:
    async def app(_: Any, __: Any, send: Any) -> None:
        headers = [(b"content-type", kind.encode()), (b"content-length", b"%d" % len(text))]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        half = len(text) // 2
        await send({"type": "http.response.body", "body": text[:half].encode(), "more_body": True})
        await send({"type": "http.response.body", "body": text[half:].encode()})

    return app


def test_a_page_runs_only_the_scripts_that_the_server_sent() -> None:
    guard = Guard(page("<p>x</p><script>a()</script><script src=b>"), Rules.of("127.0.0.1", 8765))
    begin, body = answered(guard, scope(host="127.0.0.1:8765"))
    headers = dict(begin["headers"])
    policy = headers[b"content-security-policy"].decode()
    nonce = policy.partition("'nonce-")[2].partition("'")[0]
    assert body["body"].decode().count(f'<script nonce="{nonce}"') == 2
    assert int(headers[b"content-length"]) == len(body["body"])
    assert "'unsafe-inline'" not in policy.partition("script-src")[2].partition(";")[0]
    again = answered(guard, scope(host="127.0.0.1:8765"))[0]
    assert dict(again["headers"])[b"content-security-policy"].decode() != policy


def test_the_token_becomes_a_cookie_that_scripts_cannot_read() -> None:
    rules = Rules.of("0.0.0.0", 8765)
    asked = scope(host="h:8765", query=f"token={rules.token}")
    begin = answered(Guard(page("<p>"), rules), asked)[0]
    cookie = dict(begin["headers"])[b"set-cookie"].decode()
    assert str(rules.token) in cookie
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie


def test_what_is_refused_is_told_and_goes_no_further() -> None:
    async def never(*_: Any) -> None:
        raise AssertionError

    guard = Guard(never, Rules.of("127.0.0.1", 8765))
    begin, body = answered(guard, scope(host="evil.example"))
    assert begin["status"] == 403
    assert body["body"].startswith(b"refused: ")
    closed = answered(guard, scope("websocket", host="evil.example"))
    assert closed == [{"type": "websocket.close", "code": 1008}]
