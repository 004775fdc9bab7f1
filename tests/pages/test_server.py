"""The server of pages under requests that no browser sends: raw sockets."""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Generator
from typing import Any
from urllib.parse import urlsplit

import pytest

from support.pages_shared import asked, served
from twistcap.pages import server


@pytest.fixture
def url(monkeypatch: pytest.MonkeyPatch) -> Generator[str]:
    monkeypatch.setattr(server._Handler, "timeout", 0.4)  # pyright: ignore[reportPrivateUsage]
    with served("<p>page", {"/save": answer}) as address:
        yield address


def answer(question: Any) -> Any:
    return {"root": question["n"] ** 0.5, "bad": float("nan") if question["n"] == 5 else 0}


def said(url: str, request: bytes, close: bool = True) -> bytes:
    """What comes back on a socket until it is closed."""
    with socket.create_connection(("127.0.0.1", urlsplit(url).port or 0), timeout=10) as connection:
        connection.sendall(request)
        if close:
            connection.shutdown(socket.SHUT_WR)
        out = b""
        while part := connection.recv(1 << 16):
            out += part
    return out


def post(url: str, body: bytes, *headers: str, path: str = "save") -> bytes:
    lines = [f"POST {urlsplit(url).path}{path} HTTP/1.1", "Host: 127.0.0.1", "Content-Type: application/json", *headers]
    return said(url, "\r\n".join([*lines, "", ""]).encode() + body, close=False)


def test_without_the_token_there_is_nothing(url: str) -> None:
    assert asked(url) == (200, "<p>page")
    root, token = re.sub(r"/[\w-]+/$", "/", url), urlsplit(url).path.strip("/")
    for path in (
        "/",
        "/save",
        "//save",
        f"/{token[:-1]}/",
        f"/{token}x/save",
        f"/?{token}",
        "/%00/",
    ):
        assert asked(root, path)[0] == 404
        assert asked(root, path, '{"n": 4}')[0] == 404


def test_a_question_that_is_too_long_is_answered(url: str) -> None:
    for length in ("99999999", "9" * 400):
        assert b" 413 " in post(url, b"{}", f"Content-Length: {length}").splitlines()[0]
    for length in ("-1", "x", "١٢", "1e3"):
        assert b" 411 " in post(url, b"{}", f"Content-Length: {length}").splitlines()[0]


def test_who_is_silent_is_let_go(url: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert post(url, b'{"n"', "Content-Length: 500") == b""  # the rest never comes
    assert said(url, b"GET / HT", close=False) == b""
    with socket.create_connection(("127.0.0.1", urlsplit(url).port or 0)) as connection:
        connection.sendall(b"POST /")
    assert asked(url) == (200, "<p>page")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "body", ["", "[", "[1]", '{"n": NaN}', "[" * 3000, '{"n": "x"}', "{}", '{"n": 5}', '{"n": 1, "n": 2}', "\x00"]
)
def test_no_question_ends_in_a_traceback(url: str, body: str, capfd: pytest.CaptureFixture[str]) -> None:
    status, text = asked(url, "/save", body)
    assert status == 200 and "error" in text and len(text) < 320
    assert capfd.readouterr().err == ""


def test_no_bytes_end_in_a_traceback(url: str, capfd: pytest.CaptureFixture[str]) -> None:
    whole = f"POST {urlsplit(url).path}save HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 8\r\n\r\n".encode()
    for request in (
        b"\x00\xff" * 40,
        b"GET",
        b"GET / HTTP/9.9\r\n\r\n",
        b"\r\n" * 9,
        b"A" * 70000 + b"\r\n",
        whole[:30],
        whole,
    ):
        said(url, request)
    said(url, b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 200 + b"\r\n")
    many = [threading.Thread(target=said, args=(url, b"POST / HTTP/1.1\r\n")) for _ in range(8)]
    for thread in many:
        thread.start()
    for thread in many:
        thread.join()
    assert asked(url) == (200, "<p>page")
    assert capfd.readouterr().err == ""
