"""Requests of others, over the wire: refused, or answered with what belongs to the folder."""

from __future__ import annotations

import http.client
import socket
from pathlib import Path

import pytest

from loopcal.companions.app.guard import LARGEST
from tests.app.serving import Served, asked, serving

SHAKE = (
    "GET /_nicegui_ws/socket.io/?EIO=4&transport=websocket HTTP/1.1\r\n"
    "Host: {host}\r\nOrigin: {origin}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
)


def raw(port: int, text: str) -> str:
    """The first line of what the server answers."""
    with socket.create_connection(("127.0.0.1", port), timeout=60) as wire:
        wire.sendall(text.encode())
        return wire.recv(4096).decode("latin-1").partition("\r\n")[0]


def test_a_page_runs_scripts_by_a_nonce_only(served: Served) -> None:
    policy = asked(served.address).headers["content-security-policy"]
    scripts = next(part for part in policy.split(";") if part.strip().startswith("script-src"))
    assert "'nonce-" in scripts
    assert "'unsafe-inline'" not in scripts
    assert "*" not in policy
    assert "http" not in policy


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1", "127.0.0.1:1", "localhost.evil:80"])
@pytest.mark.parametrize(
    "path", ["/", "/file/project.toml", "/page/project-result/report.html", "/_nicegui/x"]
)
def test_other_names_of_this_machine_are_refused(served: Served, host: str, path: str) -> None:
    assert asked(served.address + path, Host=host).status == 403


def test_foreign_pages_are_refused_over_http_and_websocket(served: Served) -> None:
    own = f"127.0.0.1:{served.port}"
    assert asked(served.address, Origin="https://evil.example").status == 403
    assert asked(served.address, Origin="null").status == 403
    for host, origin, code in (
        (own, f"http://{own}", "101"),
        (own, "https://evil.example", "403"),
        (own, "null", "403"),
        ("evil.example", f"http://{own}", "403"),
        (f"evil.example:{served.port}", f"http://evil.example:{served.port}", "403"),
    ):
        assert code in raw(served.port, SHAKE.format(host=host, origin=origin)), (host, origin)


@pytest.mark.parametrize(
    "name",
    [
        "../../../../etc/passwd",
        "%2e%2e/%2e%2e/%2e%2e/etc/passwd",
        "..%2f..%2f..%2fetc%2fpasswd",
        "%2fetc%2fpasswd",
        "/etc/passwd",
        "%00",
        "project.toml%00.csv",
        "out/secret.txt",
        "out",
        "",
        "no-such-file",
        "project-result",
    ],
)
def test_files_outside_the_folder_are_not_served(
    served: Served, hostile: Path, name: str, tmp_path: Path
) -> None:
    (tmp_path / "secret.txt").write_text("secret")
    link = hostile / "out"
    if not link.is_symlink():
        link.symlink_to(tmp_path)
    try:
        wire = http.client.HTTPConnection("127.0.0.1", served.port, timeout=60)
        wire.request("GET", f"/file/{name}")
        answer = wire.getresponse()
        text = answer.read().decode("utf-8", "replace")
        wire.close()
    finally:
        link.unlink()
    assert answer.status == 404, text
    assert "root:" not in text
    assert "secret" not in text.replace("secret.txt", "")


def test_a_file_of_the_folder_is_saved_and_never_shown(served: Served) -> None:
    got = asked(f"{served.address}/file/project.toml")
    assert got.status == 200
    assert got.headers["content-disposition"].startswith("attachment")
    assert got.headers["content-type"] == "application/octet-stream"
    assert got.headers["x-content-type-options"] == "nosniff"
    assert (
        "sandbox"
        in asked(f"{served.address}/page/project-result/report.html").headers[
            "content-security-policy"
        ]
    )


def test_an_upload_of_two_gigabytes_is_refused_before_it_is_read(served: Served) -> None:
    wire = http.client.HTTPConnection("127.0.0.1", served.port, timeout=60)
    wire.putrequest("POST", "/_nicegui/client/x/upload/1")
    wire.putheader("Content-Length", str(2_000_000_000))
    wire.endheaders()
    assert wire.getresponse().status == 413
    wire.close()
    assert LARGEST < 2_000_000_000


def test_other_machines_need_the_token_everywhere(hostile: Path, tmp_path: Path) -> None:
    (tmp_path / "project.toml").write_text("")
    with serving(tmp_path, "--host", "0.0.0.0") as server:
        token = server.address.partition("/?token=")[2]
        own = f"http://127.0.0.1:{server.port}"
        assert token
        for path in (
            "/",
            "/?token=wrong",
            "/?token=",
            "/file/project.toml",
            "/page/project-result/report.html",
        ):
            assert asked(own + path).status == 403, path
        assert asked(f"{own}/", Cookie="loopcal_token=wrong").status == 403
        shake = SHAKE.format(host=f"127.0.0.1:{server.port}", origin=own)
        assert "403" in raw(server.port, shake)
        known = f"Cookie: loopcal_token={token}\r\n\r\n"
        assert "101" in raw(server.port, shake.removesuffix("\r\n") + known)
        entered = asked(f"{own}/?token={token}")
        assert entered.status == 200
        assert "HttpOnly" in entered.headers["set-cookie"]
        assert asked(f"{own}/", Cookie=f"loopcal_token={token}").status == 200
